"""Writing synthetic scenes to a scene file, so that they can be used together with those of SUMO and recordings."""

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
    """Write the scenes of all splits to the scene file `path`, truncated to the T of recorded scenes of their kind.

    Errors: `InputError` if no scene file has scenes of this kind; us101 and highway_merge are possible.
    """
    file_range = config.scene_file_range
    if config.recorded is not None or file_range is None:
        raise InputError(
            f"got scenes of range {config.range}, wanted us101 or highway_merge; others have no place in a scene file"
        )
    header = Header(
        dt=file_range.dt,
        vehicles=splits.train.state.shape[1],
        provenance={"made by": f"gri-cosim {version('gri-cosim')}", "synthetic": msgspec.to_builtins(config)},
    )
    first = 0
    with writing(path, header) as write:
        for split, scenes in vars(splits).items():
            write(_block(config, scenes, split, first))
            first += len(scenes)


def _block(config: DataConfig, scenes: Scenes, split: str, first: int) -> SceneBlock:
    """The scenes of one split. Scene numbers begin at `first`. No two scenes share a vehicle number."""
    file_range = config.scene_file_range
    assert file_range is not None
    state = scenes.state[:, :, : file_range.steps].numpy()
    count, n = state.shape[:2]
    number = np.arange(first, first + count)
    names = np.array([str(kind) for kind in file_range.vocabulary], object)
    assert scenes.graph.shape[1] == len(pairs(n))
    return SceneBlock(
        kind=file_range.kinds[0],
        source=np.full(count, f"synthetic {config.range}", object),
        recording=np.full(count, f"seed {config.seed}", object),
        split=np.full(count, split, object),
        start=np.zeros(count),
        vehicle=number[:, None] * n + np.arange(n),
        features={name: state[..., k] for k, name in enumerate(dynamics_named(file_range.dynamics).state)},
        edges=names[scenes.graph.numpy()],
        size={"length": np.full((count, n), file_range.length or 0.0)},
    )
