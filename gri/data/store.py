"""The scenes of a configuration. Synthetic ones are made once and kept in a file; others are read from scene files."""

import hashlib
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import torch

from gri.core.scenes import Scenes
from gri.data.mixture import mix_scenes
from gri.data.ranges.car_following import RANGES, SceneRange
from gri.data.ranges.graph_shares import GraphShare
from gri.data.ranges.highway_merge import HIGHWAY_MERGE, HighwayMergeRange
from gri.data.ranges.lane_changing import LANE_CHANGING_SCENES
from gri.data.ranges.recorded import RECORDED, SUMO_CAR_FOLLOWING, SUMO_MERGE, RecordedRange
from gri.data.recorded import recorded_scenes
from gri.data.synthetic.expert import Range, make_idm_scenes, make_scenes, train_expert
from gri.data.synthetic.idm_drivers import IdmExpert
from gri.data.synthetic.optimal_drivers import make_highway_scenes
from gri.data.synthetic.optimal_followers import (
    OptimalExpert,
    ShiftedStarts,
    make_optimal_scenes,
    make_shifted_scenes,
)
from gri.errors import InputError
from gri.progress import Progress, no_progress
from gri.storage.claims import claimed_place
from gri.storage.verification import check_own_digest, digest_file, write_digest
from gri.storage.whole_files import whole_file

_SYNTHETIC: dict[str, Range] = {**RANGES, "lane_changing": LANE_CHANGING_SCENES, "highway_merge": HIGHWAY_MERGE}


class DataConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which scenes to use; for synthetic ones also their number and seed. Scene files contain their splits."""

    range: Literal[
        "paper", "us101", "lane_changing", "highway_merge",
        "ngsim_car_following", "ngsim_lane_changing", "sumo_car_following", "sumo_merge",
    ]  # fmt: skip
    graphs: Literal["one", "mixed"]
    """`one`: the paper's true graph in all scenes. `mixed`: several graphs, of which that one is the most frequent."""
    train: int = 2000
    validation: int = 200
    test: int = 200
    seed: int = 0
    expert_updates: int = 1500
    action_noise: float = 0.0
    """Standard deviation of independent noise on the expert's jerk [m/s³]."""
    expert: IdmExpert | OptimalExpert | msgspec.UnsetType = msgspec.UNSET
    """Drivers of synthetic car following. Not set: a policy that was trained to maximise the true reward."""
    shifted: ShiftedStarts | msgspec.UnsetType = msgspec.UNSET
    """Demonstrations from shifted starts that are added to the training scenes of synthetic car following."""
    files: tuple[str, ...] | msgspec.UnsetType = msgspec.UNSET
    """Scene files from recorded traffic or SUMO. Without them, the file in the folder of scenes is read.

    With the synthetic ranges us101 and highway_merge, the scenes of the files follow the synthetic ones in each split.
    """

    @property
    def recorded(self) -> RecordedRange | None:
        """The range of the scenes if they come from scene files; None for synthetic ones."""
        return RECORDED.get(self.range)

    @property
    def scene_file_range(self) -> RecordedRange | None:
        """The range by which a model for these scenes reads scene files; None if it can read none."""
        return self.recorded or {"us101": SUMO_CAR_FOLLOWING, "highway_merge": SUMO_MERGE}.get(self.range)

    @property
    def scene_range(self) -> Range:
        """The range of synthetic scenes. Errors: KeyError if the scenes come from scene files."""
        return _SYNTHETIC[self.range]

    @property
    def shares(self) -> tuple[GraphShare, ...]:
        """The true graphs of synthetic scenes, with their shares."""
        return self.scene_range.mixed_graphs if self.graphs == "mixed" else self.scene_range.one_graph


@dataclass(frozen=True)
class Splits:
    """The training, validation and test scenes of a data set."""

    train: Scenes
    validation: Scenes
    test: Scenes


def scenes_path(config: DataConfig, folder: Path) -> Path:
    """The file in `folder` that contains the scenes of a configuration.

    For synthetic scenes, the name contains a hash of everything that they depend on. For others, it is the file that
    `gri ngsim scenes` or `cosim scenes` writes by default.
    """
    if config.recorded is not None:
        return folder / f"{config.range.partition('_')[0]}.parquet"
    synthetic = msgspec.structs.replace(config, files=msgspec.UNSET)
    content = msgspec.json.encode([synthetic, config.scene_range, config.shares])
    return folder / f"{config.range}-{config.graphs}-{hashlib.sha256(content).hexdigest()[:10]}.npz"


def scenes_of(config: DataConfig, folder: Path, progress: Progress = no_progress) -> Splits:
    """The scenes of a configuration, read from their file in `folder`; synthetic ones are made if the file is missing.

    The scenes of the files that the configuration names follow the synthetic ones in each split.

    Errors: `InputError` if a scene file is missing or unreadable, has an empty split, or does not fit the range.
    """
    if config.shifted:
        return _with_shifted(config, config.shifted, folder, progress)
    path, files = scenes_path(config, folder), [Path(file) for file in config.files or ()]
    file_range = config.scene_file_range
    if config.recorded is not None:
        return recorded_splits(config.recorded, files or [path])
    if files and file_range is None:
        raise InputError(
            f"field data.files: got files beside range {config.range}, wanted range us101 or highway_merge, or no files"
        )
    if file_range is not None:
        _check_files_exist(file_range, files)
    scenes = read_scenes(path) if path.is_file() else _make_scenes(config, path, progress)
    parts = torch.arange(len(scenes)).split([config.train, config.validation, config.test])
    splits = Splits(*(scenes[part] for part in parts))
    if file_range is None or not files:
        return splits
    from_files = recorded_splits(file_range, files)
    return Splits(*(mix_scenes(part, vars(from_files)[name]) for name, part in vars(splits).items()))


def _with_shifted(config: DataConfig, shifted: ShiftedStarts, folder: Path, progress: Progress) -> Splits:
    """The splits without shifted starts, with the demonstrations from shifted starts after the training scenes."""
    scenes = config.scene_range if config.recorded is None else None
    if not isinstance(scenes, SceneRange) or config.expert or config.files:
        raise InputError(
            f"field data.shifted: got it for range {config.range}, wanted range paper or us101 without expert and files"
        )
    splits = scenes_of(msgspec.structs.replace(config, shifted=msgspec.UNSET), folder, progress)
    content = msgspec.json.encode([shifted, scenes, config.shares, config.seed])
    path = folder / f"{config.range}-{config.graphs}-shifted-{hashlib.sha256(content).hexdigest()[:10]}.npz"
    if not path.is_file():
        write_scenes(path, make_shifted_scenes(shifted, scenes, config.shares, config.seed + 2))
    added, train = read_scenes(path), splits.train
    joined = (torch.cat([getattr(train, name), getattr(added, name)]) for name in ("state", "action", "graph"))
    return Splits(Scenes(*joined), splits.validation, splits.test)


def recorded_splits(scenes: RecordedRange, paths: Sequence[Path]) -> Splits:
    """The splits of scene files. Errors: `InputError` if a file is missing or unreadable, or a split is empty."""
    _check_files_exist(scenes, paths)
    parts = (recorded_scenes(paths, scenes, split)[0] for split in ("train", "validation", "test"))
    return Splits(*parts)


def _check_files_exist(scenes: RecordedRange, paths: Sequence[Path]) -> None:
    for path in paths:
        if not path.is_file():
            command = "cosim scenes SCENARIO" if scenes.name.startswith("sumo") else "gri ngsim scenes FILE..."
            raise InputError(f"{path}: no such scene file; make one with `{command} --out ...`")


def _make_scenes(config: DataConfig, path: Path, progress: Progress) -> Scenes:
    scenes, shares = config.scene_range, config.shares
    count = config.train + config.validation + config.test
    if config.expert:
        if not isinstance(scenes, SceneRange):
            raise InputError(
                f"field data.expert: got another expert for range {config.range}, wanted range paper or us101"
            )
        made = _scenes_of_expert(config.expert, config, scenes, count)
    elif isinstance(scenes, HighwayMergeRange):
        made = make_highway_scenes(scenes, config.graphs, count, config.seed, progress)
    else:
        expert = train_expert(scenes, shares, config.seed, config.expert_updates, progress=progress)
        made = make_scenes(expert, scenes, shares, count, config.seed + 1, config.action_noise)
    write_scenes(path, made)
    return made


def _scenes_of_expert(drivers: IdmExpert | OptimalExpert, config: DataConfig, scenes: SceneRange, count: int) -> Scenes:
    match drivers:
        case IdmExpert():
            return make_idm_scenes(drivers, scenes, config.shares, count, config.seed + 1, config.action_noise)
        case OptimalExpert():
            if config.action_noise:
                raise InputError(
                    "field data.action_noise: got noise for optimal drivers, who plan ahead and do not react to it; "
                    "leave it out"
                )
            return make_optimal_scenes(drivers, scenes, config.shares, count, config.seed + 1)


def write_scenes(path: Path, scenes: Scenes) -> None:
    """Write scenes to an .npz file with the arrays `state`, `action`, `graph` and, if they have one, `history`.

    The file is complete or it does not exist; its hash is written beside it. What a killed command left of it is
    removed, unless another command is writing the same file.
    """
    with ExitStack() as claim:
        with suppress(InputError):  # two commands may write the same scenes at once: both files are whole and alike
            claim.enter_context(claimed_place(path))
        digest_file(path).unlink(missing_ok=True)
        with whole_file(path) as part, part.open("wb") as file:
            np.savez(file, **{name: array.numpy() for name, array in vars(scenes).items() if array is not None})
        write_digest(path)


def read_scenes(path: Path) -> Scenes:
    """The scenes of a file written by `write_scenes`. Errors: `InputError` if it is another file, or damaged."""
    check_own_digest(path, "delete it, then it is made again")
    try:
        with path.open("rb") as file, np.load(file) as arrays:
            names = [name for name in ("state", "action", "graph", "history") if name != "history" or name in arrays]
            return Scenes(*(torch.from_numpy(arrays[name]) for name in names))
    except Exception as error:  # of the many that a damaged file leads to
        raise InputError(
            f"{path}: not a file of scenes, or damaged ({error}); delete it, then it is made again"
        ) from error
