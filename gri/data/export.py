"""Synthetic scenes in a scene file, beside which those of SUMO and of recorded traffic can be trained on."""

from importlib.metadata import version
from pathlib import Path

import msgspec
import numpy as np

from gri.core.dynamics import dynamics_named
from gri.core.graph import pairs
from gri.core.scenes import Scenes
from gri.data.scene_file.schema import Header, SceneBlock, writing
from gri.data.store import DataConfig, Splits
from gri.errors import InputError


def write_synthetic(path: Path, config: DataConfig, splits: Splits) -> None:
    """Write the first steps of each scene, as many as recorded scenes of that kind have.

    Errors: `InputError` where no recorded scenes are like them.
    """
    like = config.tested_on
    if config.recorded is not None or like is None:
        raise InputError(
            f"scenes of range {config.range} go into no scene file; those of us101 and highway_merge do, beside SUMO's"
        )
    header = Header(
        dt=like.dt,
        vehicles=splits.train.state.shape[1],
        provenance={"made by": f"gri-cosim {version('gri-cosim')}", "synthetic": msgspec.to_builtins(config)},
    )
    first = 0
    with writing(path, header) as write:
        for split, scenes in vars(splits).items():
            write(_block(config, scenes, split, first))
            first += len(scenes)


def _block(config: DataConfig, scenes: Scenes, split: str, first: int) -> SceneBlock:
    """Scenes are counted through from `first`, and so are their vehicles: nobody is in two of them."""
    like = config.tested_on
    assert like is not None
    state = scenes.state[:, :, : like.steps].numpy()
    count, n = state.shape[:2]
    number = np.arange(first, first + count)
    names = np.array([str(kind) for kind in like.vocabulary], object)
    assert scenes.graph.shape[1] == len(pairs(n))
    return SceneBlock(
        kind=like.kinds[0],
        source=np.full(count, f"synthetic {config.range}", object),
        recording=np.full(count, f"seed {config.seed}", object),
        split=np.full(count, split, object),
        start=np.zeros(count),
        vehicle=number[:, None] * n + np.arange(n),
        features={name: state[..., k] for k, name in enumerate(dynamics_named(like.dynamics).state)},
        edges=names[scenes.graph.numpy()],
        size={"length": np.full((count, n), like.length or 0.0)},
    )
