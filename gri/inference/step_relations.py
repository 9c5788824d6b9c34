"""The relations of every step of the scenes of a file, as a released model or the posterior of merges infers them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri import resources
from gri.core.dynamics import DUBINS
from gri.core.edges import LANE_CHANGING, Vocabulary, pairs, vehicle_count
from gri.core.trajectory import Trajectory
from gri.data.ranges.recorded import RecordedRange
from gri.data.recorded import in_model_coordinates, kinds_in
from gri.data.scene_file.reading import Recorded, read, scene_counts, scene_numbers
from gri.errors import InputError, guarded_reading
from gri.networks.model import RelationalModel
from gri.progress import Progress, no_progress
from gri.relations.merge_motion import lane_width_of, motion_of
from gri.relations.merge_posterior import relations

AT_ONCE = 20_000  # windows; bounds the memory


@dataclass(frozen=True)
class StepRelations:
    """What is inferred about S scenes of one kind, at W of their steps."""

    kind: str
    scene: Int[np.ndarray, " S"]
    """Numbers of the scenes in their file."""
    step: Int[np.ndarray, " W"]
    """Steps of the scenes, counted from 0."""
    dt: float
    """Time between two steps [s]."""
    probs: Float[np.ndarray, "S W E K"]
    """Probability of each relation of `vocabulary`, for all ordered pairs (`gri.core.edges.pairs`)."""
    vocabulary: Vocabulary
    unknown: Float[np.ndarray, "S W"] | None = None
    """How far the motion is from all that the model was trained on; above 1: not known. None: it cannot tell."""

    @property
    def pairs(self) -> Sequence[tuple[int, int]]:
        """The ordered pairs (sender, receiver) of the edge axis."""
        return pairs(vehicle_count(self.probs.shape[2]))


def by_model(
    model: RelationalModel,
    scenes: RecordedRange,
    path: Path,
    every_s: float = 0.0,
    split: str | None = None,
    progress: Progress = no_progress,
) -> list[StepRelations]:
    """The graph that a model infers from the `history_steps` before each step; one result per kind of scenes.

    Args:
        scenes: says which kinds of scenes the model is for, and in which coordinates it wants them.
        every_s: time between two inferences [s]; 0: every step.

    Raises:
        InputError: the file has no scenes for this model, or scenes with another sampling time, with missing states, or
            shorter than the history.
    """
    found = []
    for kind in kinds_in(path, scenes, split):
        part = read(path, kind, model.dynamics, scenes.vocabulary, split)
        state, dt, steps = part.trajectory.state, part.trajectory.dt, part.trajectory.state.shape[2]
        _check(path, kind, part.trajectory, model.dt, model.history_steps)
        state = in_model_coordinates(state, part.length, scenes)
        at = np.arange(model.history_steps - 1, steps, _stride(every_s, dt))
        graphs = []
        for done, t in enumerate(at):
            progress(f"inferred steps of {kind}", done, len(at), 0.0)
            graphs.append(_inferred(model, state[:, :, t + 1 - model.history_steps : t + 1]))
        unknown = [u for _, u in graphs if u is not None]
        found.append(
            StepRelations(
                kind,
                scene_numbers(path, kind, split),
                at,
                dt,
                np.stack([p for p, _ in graphs], 1),
                model.config.vocabulary,
                np.stack(unknown, 1) if len(unknown) == len(graphs) else None,
            )
        )
    return found


@torch.no_grad()
def _inferred(
    model: RelationalModel, window: Float[Tensor, "S N H D"]
) -> tuple[Float[np.ndarray, "S E K"], Float[np.ndarray, " S"] | None]:
    """The graph of each scene, with x from the leader's last position, where float32 is finest."""
    window = window.clone()
    window[..., 0] -= window[:, -1:, -1:, 0]
    graphs = [model.infer(window[k : k + AT_ONCE]) for k in range(0, len(window), AT_ONCE)]
    unknown = [graph.unknown for graph in graphs if graph.unknown is not None]
    return (
        torch.cat([graph.probs for graph in graphs]).double().numpy(),
        torch.cat(unknown).double().numpy() if unknown else None,
    )


class MergeConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What drivers have in common, as `gri.relations.merge_posterior.learn_constants` found it, and from what."""

    constants: dict[str, float]
    provenance: dict[str, Any]


POSTERIOR = "merge_posterior"


def released_merge_constants() -> dict[str, float]:
    """The constants that come with the project. Errors: `InputError` if their file is damaged."""
    path = resources.PACKAGE / "checkpoints" / f"{POSTERIOR}.json"
    with guarded_reading(path, "constants of merges", "install the package again"):
        return msgspec.json.decode(path.read_bytes(), type=MergeConstants).constants


def by_merge_posterior(
    path: Path,
    constants: Mapping[str, float],
    every_s: float = 0.0,
    online: bool = False,
    kind: str = "merge",
    split: str | None = None,
    progress: Progress = no_progress,
) -> list[StepRelations]:
    """The label-free posterior over the relations of each step of merges (`gri.relations.merge_posterior`).

    Args:
        constants: what all drivers have in common.
        every_s: time between two steps of the result [s]; 0: every step.
        online: see only what is before each step, as in a closed loop. Otherwise the whole scene is evidence.
        kind: scenes in which vehicle 0 may change lanes, 1 is the lag vehicle and the last one is the leader.

    Raises:
        InputError: the file has no such scenes, has missing states or too few steps, or no scene shows the width of a
            lane.
    """
    if not any(k == kind and split in (None, s) for k, s in scene_counts(path)):
        raise InputError(f"{path}: has no scenes of kind {kind}; name the kind of its merges with --kind")
    found: Recorded = read(path, kind, DUBINS, LANE_CHANGING, split)
    steps = found.trajectory.state.shape[2]
    _check(path, kind, found.trajectory, found.trajectory.dt, 3)
    try:
        width = lane_width_of(found.trajectory.state)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    dt = found.trajectory.dt

    def seen(until: int) -> Float[Tensor, "S T E K"]:
        state = found.trajectory.state[:, :, : until + 1]
        motion = motion_of(state, width, dt, found.length, unfinished=online)
        return relations(motion, constants, unfinished=online)

    def last(done: int, until: int) -> Float[Tensor, "S E K"]:
        progress(f"inferred steps of {kind}", done, len(at), 0.0)
        return seen(until)[:, -1]

    at = np.arange(2 if online else 0, steps, _stride(every_s, dt))
    p = torch.stack([last(done, int(t)) for done, t in enumerate(at)], 1) if online else seen(steps)[:, at]
    return [StepRelations(kind, scene_numbers(path, kind, split), at, dt, p.numpy(), LANE_CHANGING)]


def _stride(every_s: float, dt: float) -> int:
    return max(round(every_s / dt), 1)


def _check(path: Path, kind: str, found: Trajectory, dt: float, least: int) -> None:
    """No missing state, the right sampling time, and enough steps."""
    steps = found.state.shape[2]
    if abs(found.dt - dt) > 1e-6 or steps < least:
        raise InputError(
            f"{path}: got {steps} steps of {found.dt:g} s for kind {kind}, wanted at least {least} of {dt:g} s; make"
            " the scenes longer, or sample them anew"
        )
    if missing := int((~found.valid).any(-1).any(-1).sum()):
        raise InputError(
            f"{path}: got missing states in {missing} scenes of kind {kind}, wanted complete scenes; leave them out"
        )
