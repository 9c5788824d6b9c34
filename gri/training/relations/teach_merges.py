"""Give a trained merge model an encoder that was taught the label-free posterior of merges.

The posterior (`gri.relations.merge_posterior`) sees whole scenes. The encoder sees up to 5 s before a step and learns
the posterior's probabilities of that step, by cross-entropy: it learns what can be known by then. No relation of a
scene file is used. Windows begin and end anywhere, so that the length of a history does not give away when lanes are
changed.

Some scenes are broken on purpose (`gri.relations.broken_merges`). There the posterior's probability of relations that
cannot hold is moved to "none". So the encoder cannot recite where vehicles are.

Reward and policy stay as they are.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from gri.core.dynamics import dynamics_named
from gri.core.edges import LANE_CHANGING, pairs
from gri.data.ranges.recorded import RecordedRange
from gri.data.recorded import in_model_coordinates
from gri.data.scene_file.reading import read
from gri.errors import InputError
from gri.networks.encoder import Encoder, EncoderConfig
from gri.networks.model import RelationalModel
from gri.progress import Progress, no_progress
from gri.relations.broken_merges import (
    DEAF_LAG,
    OTHER_LANE,
    Impossible,
    Merges,
    apart,
    kept_in_lane,
    with_constant_speed,
    with_stranger,
)
from gri.relations.merge_motion import lane_width_of, motion_of
from gri.relations.merge_posterior import relations
from gri.training.optimisation import Descent, draw_batch
from gri.training.training_state import TrainingState, identity_of, no_state

NONE = 0  # index into `LANE_CHANGING`
KIND = "merge"


class MergeTeachingSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Scenes and updates of the teaching."""

    encoder: EncoderConfig = EncoderConfig(hidden=48, reads=(0, 1, 2, 3), skip=True, pair_series=True)
    history: tuple[int, int] = (10, 25)
    """Fewest and most states of a history; each batch has windows of one random length."""
    as_they_are: float = 0.7
    """Share of unbroken scenes."""
    stranger: float = 0.12
    """Share of scenes with a stranger as lag vehicle."""
    constant_speed: float = 0.06
    """Share of scenes with a lag vehicle at constant speed."""
    kept_in_lane: float = 0.12
    """Share of scenes in which the merging vehicle does not change lanes."""
    updates: int = 3500
    batch: int = 64
    rate: float = 3e-3


@dataclass(frozen=True)
class TaughtScenes:
    """Scenes as the model sees them, and what to say about each step."""

    state: Float[Tensor, "S 3 T D"]
    target: Float[Tensor, "S T E K"]
    weight: Float[Tensor, " S"]
    """Relative probability of each scene in a batch."""


def merges_with_posterior(
    model: RelationalModel,
    scenes: RecordedRange,
    files: Sequence[Path],
    constants: Mapping[str, float],
    settings: MergeTeachingSettings,
    progress: Progress = no_progress,
) -> TaughtScenes:
    """What the encoder of a model learns from.

    Args:
        scenes: in which coordinates the model wants scenes.
        files: scene files with merges; their relations are not looked at.
        constants: of the posterior.

    Raises:
        InputError: the model does not drive merges, or a file has no merges that it could learn from.
    """
    if model.config.vocabulary != LANE_CHANGING:
        kinds, wanted = ", ".join(model.config.vocabulary), ", ".join(LANE_CHANGING)
        raise InputError(f"got a model with edge types {kinds}, wanted {wanted}; teach a merge model")
    parts = []
    for done, file in enumerate(files):
        progress("posterior of merges", done, len(files), 0.0)
        parts.append(scenes_with_posterior(file, scenes, constants, settings, model.dt))
    return joined(parts)


def teach_merge_model(
    model: RelationalModel,
    known: TaughtScenes,
    settings: MergeTeachingSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> tuple[RelationalModel, Mapping[str, Any]]:
    """The model with a taught encoder, and how it was taught, for the provenance.

    With `state`, the teaching goes on where that one was stopped.
    """
    started = time.process_time()
    torch.manual_seed(seed)
    taught = RelationalModel(msgspec.structs.replace(model.config, encoder=settings.encoder))
    taught.decoder.load_state_dict(model.decoder.state_dict())
    assert isinstance(taught.encoder, Encoder)
    teach_posterior(taught.encoder, known, settings, seed, progress, state)
    made = {
        "settings": msgspec.to_builtins(settings),
        "seed": seed,
        "scenes": len(known.state),
        "cpu_seconds": round(time.process_time() - started + (state.spent[1] if state else 0.0)),
    }
    return taught.requires_grad_(False).eval(), made


def merge_teaching_identity(
    model: RelationalModel, known: TaughtScenes, settings: MergeTeachingSettings, seed: int
) -> str:
    """What makes a teaching the same one: all arguments of `teach_merge_model` that its result depends on."""
    return identity_of(settings, seed, (*model.state_dict().values(), known.state, known.target, known.weight))


def joined(parts: Sequence[TaughtScenes]) -> TaughtScenes:
    """All scenes of several files; each file has the same weight. Errors: `InputError` for other numbers of steps."""
    steps = sorted({part.state.shape[2] for part in parts})
    if len(steps) > 1:
        raise InputError(f"got merges of {steps[0]} and of {steps[-1]} steps, wanted files with scenes of one length")
    return TaughtScenes(*(torch.cat([getattr(p, name) for p in parts]) for name in ("state", "target", "weight")))


def scenes_with_posterior(
    file: Path, scenes: RecordedRange, constants: Mapping[str, float], settings: MergeTeachingSettings, dt: float
) -> TaughtScenes:
    """The merges of a file, also broken ones, with the posterior of each step. Errors: `InputError`."""
    found = read(file, KIND, dynamics_named(scenes.dynamics), LANE_CHANGING)
    trajectory, fewest = found.trajectory, settings.history[1]
    if abs(trajectory.dt - dt) > 1e-6 or trajectory.state.shape[2] < fewest or not bool(trajectory.valid.all()):
        raise InputError(
            f"{file}: got {trajectory.state.shape[2]} steps of {trajectory.dt:g} s, wanted {fewest} or more complete"
            f" ones of {dt:g} s; make the scenes with `cosim scenes`"
        )
    try:
        width = lane_width_of(trajectory.state)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
    whole = Merges(trajectory.state.double(), found.length.double(), width, dt)
    stranger, constant = with_stranger(whole, _share_a_vehicle(found.vehicle)), with_constant_speed(whole)
    groups: list[tuple[Merges, Impossible, float]] = [
        (whole, (), settings.as_they_are),
        (stranger[apart(stranger)], DEAF_LAG, settings.stranger),
        (constant[apart(constant)], DEAF_LAG, settings.constant_speed),
        (kept_in_lane(whole), OTHER_LANE, settings.kept_in_lane),
    ]
    parts = [
        TaughtScenes(
            in_model_coordinates(merges.state.float(), merges.length.float(), scenes),
            _possible(merges, impossible, constants).float(),
            torch.full((len(merges),), share / len(merges)),
        )
        for merges, impossible, share in groups
        if share and len(merges)
    ]
    return joined(parts)


def _share_a_vehicle(vehicle: Int[np.ndarray, "S 3"]) -> Bool[Tensor, "S S"]:
    """Whether two scenes have a vehicle in common; each scene with itself does."""
    shared = np.zeros((len(vehicle), len(vehicle)), bool)
    for mine in vehicle.T:
        for other in vehicle.T:
            shared |= mine[:, None] == other[None]
    return torch.from_numpy(shared)


def _possible(merges: Merges, impossible: Impossible, constants: Mapping[str, float]) -> Float[Tensor, "S T E K"]:
    """The posterior of each step, with the probability of relations that cannot hold moved to "none"."""
    p = relations(motion_of(merges.state, merges.lane_width, merges.dt, merges.length), constants)
    for pair, kinds in impossible:
        edge = p[:, :, pairs(3).index(pair)]
        edge[..., NONE] += edge[..., list(kinds)].sum(-1)
        edge[..., list(kinds)] = 0.0
    return p


def teach_posterior(
    encoder: Encoder,
    known: TaughtScenes,
    settings: MergeTeachingSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the encoder in place: it learns the posterior of the last step of windows that end anywhere."""
    generator = torch.Generator().manual_seed(seed)
    descent = Descent(encoder.parameters(), settings.rate, settings.updates, clip=1.0)
    for update in (state or no_state()).updates("relations of merges", settings.updates, generator, descent):
        steps, end = _window(known.state.shape[2], settings.history, generator)
        rows = draw_batch(len(known.state), settings.batch, generator, known.weight)
        logits = encoder(known.state[rows, :, end - steps : end])
        loss = nn.functional.cross_entropy(logits.flatten(0, 1), known.target[rows, end - 1].flatten(0, 1))
        descent.step(loss)
        progress("relations of merges", update + 1, settings.updates, float(loss.detach()))


def _window(scene: int, history: tuple[int, int], generator: torch.Generator) -> tuple[int, int]:
    """Length and end of a window that lies in a scene of so many steps."""
    steps = int(torch.randint(history[0], min(history[1], scene) + 1, (), generator=generator))
    return steps, int(torch.randint(steps, scene + 1, (), generator=generator))
