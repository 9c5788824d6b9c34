"""Scenes of a configuration: made once by the expert, then read from a file."""

import hashlib
import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import torch

from gri.core.scenes import Scenes
from gri.data.mixture import mixed
from gri.data.ranges.car_following import RANGES, GraphShare
from gri.data.ranges.highway_merge import HIGHWAY_MERGE, HighwayMergeRange
from gri.data.ranges.lane_changing import LANE_CHANGING_SCENES
from gri.data.ranges.recorded import RECORDED, SUMO_CAR_FOLLOWING, SUMO_MERGE, RecordedRange
from gri.data.recorded import recorded_scenes
from gri.data.synthetic.expert import Range, make_scenes, train_expert
from gri.data.synthetic.optimal_drivers import make_highway_scenes
from gri.errors import InputError
from gri.progress import Progress, no_progress

_SYNTHETIC: dict[str, Range] = {**RANGES, "lane_changing": LANE_CHANGING_SCENES, "highway_merge": HIGHWAY_MERGE}


class DataConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which scenes; of synthetic ones also how many, from which seed. Recorded ones come with their splits."""

    range: Literal[
        "paper", "us101", "lane_changing", "highway_merge",
        "ngsim_car_following", "ngsim_lane_changing", "sumo_car_following", "sumo_merge",
    ]  # fmt: skip
    graphs: Literal["one", "mixed"]
    """The paper's one true graph for all scenes, or several of which that one is the most frequent."""
    train: int = 2000
    validation: int = 200
    test: int = 200
    seed: int = 0
    expert_updates: int = 1500
    action_noise: float = 0.0
    """Standard deviation [m/s³] of independent noise on the expert's jerk."""
    files: tuple[str, ...] | msgspec.UnsetType = msgspec.UNSET
    """Scene files of recorded scenes, of traffic and of SUMO as they fit; left out: the one in the scenes folder.

    Synthetic ranges that are like SUMO's scenes (us101, highway_merge) are mixed with the files', split by split.
    """

    @property
    def recorded(self) -> RecordedRange | None:
        """What recorded scenes have in common; None for synthetic ones."""
        return RECORDED.get(self.range)

    @property
    def tested_on(self) -> RecordedRange | None:
        """As what a model of these scenes reads a scene file; None where none fits."""
        return self.recorded or {"us101": SUMO_CAR_FOLLOWING, "highway_merge": SUMO_MERGE}.get(self.range)

    @property
    def scene_range(self) -> Range:
        """What synthetic scenes have in common."""
        return _SYNTHETIC[self.range]

    @property
    def shares(self) -> tuple[GraphShare, ...]:
        return self.scene_range.mixed_graphs if self.graphs == "mixed" else self.scene_range.one_graph


@dataclass(frozen=True)
class Splits:
    """Fixed parts of a data set."""

    train: Scenes
    validation: Scenes
    test: Scenes


def scenes_path(config: DataConfig, folder: Path) -> Path:
    """Where the scenes of a configuration are kept; the name changes with anything synthetic ones depend on.

    Recorded ones are in the file that `gri ngsim scenes` or `cosim scenes` writes.
    """
    if config.recorded is not None:
        return folder / f"{config.range.partition('_')[0]}.parquet"
    alone = msgspec.structs.replace(config, files=msgspec.UNSET)
    content = msgspec.json.encode([alone, config.scene_range, config.shares])
    return folder / f"{config.range}-{config.graphs}-{hashlib.sha256(content).hexdigest()[:10]}.npz"


def scenes_of(config: DataConfig, folder: Path, progress: Progress = no_progress) -> Splits:
    """The scenes of a configuration: from their file if it is there, else from a newly trained expert.

    Synthetic ones are followed by those of the files that the configuration names. Errors: `InputError` where a file is
    not there, or no file is like the range.
    """
    path, files, like = scenes_path(config, folder), [Path(file) for file in config.files or ()], config.tested_on
    if config.recorded is not None:
        return recorded_splits(config.recorded, files or [path])
    if files and like is None:
        raise InputError(f"field data.files: got files beside range {config.range}; us101 and highway_merge take some")
    if like is not None:
        _check_there(like, files)
    scenes = read_scenes(path) if path.is_file() else _made(config, path, progress)
    parts = torch.arange(len(scenes)).split([config.train, config.validation, config.test])
    splits = Splits(*(scenes[part] for part in parts))
    if like is None or not files:
        return splits
    filed = recorded_splits(like, files)
    return Splits(*(mixed(part, vars(filed)[name]) for name, part in vars(splits).items()))


def recorded_splits(scenes: RecordedRange, paths: Sequence[Path]) -> Splits:
    """The splits of scene files. Errors: `InputError` where one is not there, or a split is empty."""
    _check_there(scenes, paths)
    parts = (recorded_scenes(paths, scenes, split)[0] for split in ("train", "validation", "test"))
    return Splits(*parts)


def _check_there(scenes: RecordedRange, paths: Sequence[Path]) -> None:
    for path in paths:
        if not path.is_file():
            command = "cosim scenes SCENARIO" if scenes.name.startswith("sumo") else "gri ngsim scenes FILE..."
            raise InputError(f"{path}: no such scene file; make one with `{command} --out ...`")


def _made(config: DataConfig, path: Path, progress: Progress) -> Scenes:
    scenes, shares = config.scene_range, config.shares
    count = config.train + config.validation + config.test
    if isinstance(scenes, HighwayMergeRange):
        made = make_highway_scenes(scenes, config.graphs, count, config.seed, progress)
    else:
        expert = train_expert(scenes, shares, config.seed, config.expert_updates, progress=progress)
        made = make_scenes(expert, scenes, shares, count, config.seed + 1, config.action_noise)
    write_scenes(path, made)
    return made


def write_scenes(path: Path, scenes: Scenes) -> None:
    """Write scenes as arrays `state`, `action`, `graph` and, if there is one, `history`.

    The file appears whole or not at all.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            np.savez(file, **{name: array.numpy() for name, array in vars(scenes).items() if array is not None})
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def read_scenes(path: Path) -> Scenes:
    """Scenes of a file written by `write_scenes`."""
    try:
        with path.open("rb") as file, np.load(file) as arrays:
            names = [name for name in ("state", "action", "graph", "history") if name != "history" or name in arrays]
            return Scenes(*(torch.from_numpy(arrays[name]) for name in names))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path}: not a scenes file, or damaged ({error}); delete it, it will be made again"
        ) from error
