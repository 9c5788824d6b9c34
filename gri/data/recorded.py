"""Recorded scenes for training and testing: read from a scene file, in the layout the models work in."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import dynamics_named
from gri.core.scenes import Scenes
from gri.data.ngsim.drawn_lane_changes import MARK
from gri.data.ranges.recorded import RecordedRange
from gri.data.scene_file.reading import Recorded, joined, read, scene_counts
from gri.errors import InputError


def recorded_scenes(path: Path | Sequence[Path], scenes: RecordedRange, split: str | None) -> tuple[Scenes, Recorded]:
    """Scenes of a file, or of several, with their actions, and all else the files say of them.

    y is counted from the mean lateral position of the leader, so that the target lane is at 0, and x from where vehicle
    0 starts. Errors: `InputError` where a file has no such scenes, or of another length or rate.
    """
    dynamics = dynamics_named(scenes.dynamics)
    paths = [path] if isinstance(path, Path) else path
    found = joined([part for each in paths for part in _found(each, scenes, split)])
    state = _in_lane(found.trajectory.state) if "y" in dynamics.state else found.trajectory.state
    if scenes.length is not None:
        state = _as_long_as(scenes.length, state, found.length)
    state = _from_origin(state)
    action = dynamics.inverse(state[:, :-1, :-1], state[:, :-1, 1:], found.trajectory.dt)
    return Scenes(state, action, found.graph), found


def are_drawn(found: Recorded) -> Bool[np.ndarray, " S"]:
    """Which scenes have drawn motion across the road."""
    return np.array([str(source).endswith(MARK) for source in found.source], bool)


def scenes_to_test(path: Path, scenes: RecordedRange, split: str | None) -> tuple[Scenes, Recorded, int]:
    """The scenes of a file without those that have drawn motion, which are for training; and how many these are.

    Errors: `InputError` as in `recorded_scenes`, and where nothing is left.
    """
    every, found = recorded_scenes(path, scenes, split)
    kept = torch.from_numpy(np.flatnonzero(~are_drawn(found)))
    if not len(kept):
        raise InputError(
            f"{path}: got {len(found)} scenes for range {scenes.name}, all with drawn lateral motion, which are for "
            "training; wanted recorded ones, of a file whose lateral positions change"
        )
    return every[kept], found[kept], len(every) - len(kept)


def _found(path: Path, scenes: RecordedRange, split: str | None) -> list[Recorded]:
    dynamics, parts = dynamics_named(scenes.dynamics), []
    for kind in kinds_in(path, scenes, split):
        part = read(path, kind, dynamics, scenes.vocabulary, split)
        steps, dt = part.trajectory.state.shape[2], part.trajectory.dt
        if (steps, round(dt, 6)) != (scenes.steps, scenes.dt):
            raise InputError(
                f"{path}: got {steps} steps of {dt} s, wanted {scenes.steps} of {scenes.dt} s; "
                "make the scenes with the default rules"
            )
        if not bool(part.trajectory.valid.all()):
            raise InputError(f"{path}: some states of kind {kind} do not exist, wanted complete scenes")
        parts.append(part)
    return parts


def kinds_in(path: Path, scenes: RecordedRange, split: str | None) -> tuple[str, ...]:
    """Those of the wanted kinds that the file has in the split; all where it has none, so that reading says so."""
    counts = scene_counts(path)
    found = [kind for kind in scenes.kinds if any(k == kind and split in (None, s) for k, s in counts)]
    return tuple(found) or scenes.kinds


def _in_lane(state: Float[Tensor, "S N T D"]) -> Float[Tensor, "S N T D"]:
    shifted = state.clone()
    shifted[..., 1] -= state[:, -1:, :, 1].mean(2, keepdim=True)
    return shifted


def _as_long_as(
    length: float, state: Float[Tensor, "S N T D"], lengths: Float[Tensor, "S N"]
) -> Float[Tensor, "S N T D"]:
    """x shifted so that every vehicle ahead counts as so long [m], from the rear to the front at step 0."""
    shifted, order = state.clone(), state[:, :, 0, 0].argsort(1)
    offsets = (length - lengths.gather(1, order))[:, 1:].cumsum(1)
    offsets = torch.cat([torch.zeros_like(offsets[:, :1]), offsets], 1)
    shifted[..., 0] += torch.zeros_like(lengths).scatter(1, order, offsets)[..., None]
    return shifted


def _from_origin(state: Float[Tensor, "S N T D"]) -> Float[Tensor, "S N T D"]:
    """x counted from where vehicle 0 starts."""
    shifted = state.clone()
    shifted[..., 0] -= state[:, :1, :1, 0]
    return shifted
