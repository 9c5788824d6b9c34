"""Scenes of scene files for training and testing, in the models' coordinates."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import dynamics_named
from gri.core.scenes import Scenes
from gri.data.ngsim.sampled_lateral_motion import SOURCE_SUFFIX
from gri.data.ranges.recorded import RecordedRange
from gri.data.scene_file.reading import Recorded, joined, read, scene_counts
from gri.errors import InputError


def recorded_scenes(path: Path | Sequence[Path], scenes: RecordedRange, split: str | None) -> tuple[Scenes, Recorded]:
    """The scenes of one or several files, and the remaining content of the files for these scenes.

    Only scenes of the kinds of `scenes` are read, and only those of `split` if that is given. x [m] is relative to the
    start of vehicle 0. y [m], if the dynamics have it, is relative to the leader's mean lateral position, so the target
    lane is at 0. Actions come from the inverse dynamics.

    Errors: `InputError` if a file has no such scenes, has other T or Δt, or has incomplete scenes.
    """
    dynamics = dynamics_named(scenes.dynamics)
    paths = [path] if isinstance(path, Path) else path
    found = joined([part for each in paths for part in _read_file(each, scenes, split)])
    state = in_model_coordinates(found.trajectory.state, found.length, scenes)
    action = dynamics.inverse(state[:, :-1, :-1], state[:, :-1, 1:], found.trajectory.dt)
    return Scenes(state, action, found.graph), found


def in_model_coordinates(
    state: Float[Tensor, "S N T D"], length: Float[Tensor, "S N"], scenes: RecordedRange
) -> Float[Tensor, "S N T D"]:
    """States of a scene file as the models of a range want them: x from the start of vehicle 0, y from the leader."""
    if "y" in dynamics_named(scenes.dynamics).state:
        state = _lateral_from_leader(state)
    if scenes.length is not None:
        state = with_vehicle_length(scenes.length, state, length)
    return _from_start_of_vehicle_0(state)


def has_sampled_lateral_motion(found: Recorded) -> Bool[np.ndarray, " S"]:
    """Whether each scene has sampled lateral motion (`gri.data.ngsim.sampled_lateral_motion`)."""
    return np.array([str(source).endswith(SOURCE_SUFFIX) for source in found.source], bool)


def scenes_to_test(path: Path, scenes: RecordedRange, split: str | None) -> tuple[Scenes, Recorded, int]:
    """Like `recorded_scenes`, without the scenes with sampled lateral motion, and the number of those.

    Scenes with sampled lateral motion are for training only.

    Errors: `InputError` as in `recorded_scenes`, and if no scene remains.
    """
    all_scenes, found = recorded_scenes(path, scenes, split)
    chosen = torch.from_numpy(np.flatnonzero(~has_sampled_lateral_motion(found)))
    if not len(chosen):
        raise InputError(
            f"{path}: got {len(found)} scenes for range {scenes.name}, all with drawn lateral motion, which are for "
            "training only; wanted scenes with recorded lateral motion; give another file"
        )
    return all_scenes[chosen], found[chosen], len(all_scenes) - len(chosen)


def _read_file(path: Path, scenes: RecordedRange, split: str | None) -> list[Recorded]:
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
            raise InputError(
                f"{path}: got scenes of kind {kind} with missing states, wanted complete scenes; make the file again"
            )
        parts.append(part)
    return parts


def kinds_in(path: Path, scenes: RecordedRange, split: str | None) -> tuple[str, ...]:
    """The kinds of `scenes` that the file has in the split; all kinds of `scenes` if it has none.

    In the second case, reading the file raises the error that names the missing kind.
    """
    counts = scene_counts(path)
    found = [kind for kind in scenes.kinds if any(k == kind and split in (None, s) for k, s in counts)]
    return tuple(found) or scenes.kinds


def _lateral_from_leader(state: Float[Tensor, "S N T D"]) -> Float[Tensor, "S N T D"]:
    """The states with y relative to the leader's mean lateral position."""
    shifted = state.clone()
    shifted[..., 1] -= state[:, -1:, :, 1].mean(2, keepdim=True)
    return shifted


def with_vehicle_length(
    length: float, state: Float[Tensor, "S N T D"], lengths: Float[Tensor, "S N"]
) -> Float[Tensor, "S N T D"]:
    """The states with x shifted so that net gaps stay the same when every vehicle is `length` [m] long.

    `lengths` are the recorded vehicle lengths [m]. Vehicles are shifted in their order along the road at step 0.
    """
    shifted, order = state.clone(), state[:, :, 0, 0].argsort(1)
    offsets = (length - lengths.gather(1, order))[:, 1:].cumsum(1)
    offsets = torch.cat([torch.zeros_like(offsets[:, :1]), offsets], 1)
    shifted[..., 0] += torch.zeros_like(lengths).scatter(1, order, offsets)[..., None]
    return shifted


def _from_start_of_vehicle_0(state: Float[Tensor, "S N T D"]) -> Float[Tensor, "S N T D"]:
    """The states with x relative to the start of vehicle 0."""
    shifted = state.clone()
    shifted[..., 0] -= state[:, :1, :1, 0]
    return shifted
