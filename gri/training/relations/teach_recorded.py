"""Teach an encoder who follows whom in recorded traffic: recorded windows against windows broken on purpose.

Recorded windows are few and overlap, so that a network soon knows them by heart. Four things keep it from that:

- It reads little (`PairEncoderConfig.reads` "motion"), and few updates are made.
- There are many strangers: up to `copies` combinations per recorded window, where a test has two.
- Windows are varied (`varied`): all speeds are raised, fluctuations are mirrored, made larger or smaller, noise is
  added. Recorded and broken windows alike, so that a variation says nothing about relations.
- Several members are taught, each by itself. Their log probabilities are averaged.
"""

import time
from collections.abc import Mapping, Sequence
from math import log
from typing import Any

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.graph import FOLLOWING
from gri.errors import InputError
from gri.networks.model import RelationalModel
from gri.networks.pair_encoder import LENGTH, PairEncoder
from gri.progress import Progress, no_progress
from gri.relations.reaction_scenes import Reactions
from gri.training.optimisation import Descent
from gri.training.relations.recorded_windows import ContrastSettings, Variation, WeightedWindows
from gri.training.relations.teach_encoder import explanation_loss, hide_vehicles
from gri.training.training_state import TrainingState, identity_of, no_state

NOVELTY_WINDOWS = 8000  # recorded and broken, that the score of novelty is fitted to


def teach_recorded_model(
    model: RelationalModel,
    groups: Sequence[Sequence[WeightedWindows]],
    settings: ContrastSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> tuple[RelationalModel, Mapping[str, Any]]:
    """The model with an encoder that was taught on recordings, and how it was taught, for the provenance.

    Reward and policy stay as they are. With `state`, the teaching goes on where that one was stopped.

    Errors: `InputError` if the model does not drive car following.
    """
    if model.config.vocabulary != FOLLOWING:
        kinds = ", ".join(model.config.vocabulary)
        raise InputError(f"got a model with edge types {kinds}, wanted none and follow; give a car-following model")
    started = time.process_time()
    taught = RelationalModel(msgspec.structs.replace(model.config, encoder=None, pair_encoder=settings.encoder))
    taught.decoder.load_state_dict(model.decoder.state_dict())
    assert isinstance(taught.encoder, PairEncoder)
    teach_recorded_encoder(taught.encoder, groups, settings, seed, progress, state)
    _fit_novelty(taught, groups, seed)
    made = {
        "settings": msgspec.to_builtins(settings),
        "seed": seed,
        "recorded_windows": sum(int((part.windows.leader >= 0).any(1).sum()) for group in groups for part in group),
        "cpu_seconds": round(time.process_time() - started + (state.spent[1] if state else 0.0)),
    }
    return taught.requires_grad_(False).eval(), made


def recorded_teaching_identity(
    model: RelationalModel, groups: Sequence[Sequence[WeightedWindows]], settings: ContrastSettings, seed: int
) -> str:
    """What makes a teaching the same one: all arguments of `teach_recorded_model` that its result depends on."""
    parts = [part for group in groups for part in group]
    windows = [tensor for part in parts for tensor in (part.windows.x, part.windows.leader, part.weight)]
    return identity_of(settings, seed, (*model.state_dict().values(), *windows))


def teach_recorded_encoder(
    encoder: PairEncoder,
    groups: Sequence[Sequence[WeightedWindows]],
    settings: ContrastSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train all members of the encoder in place, one after the other.

    Each update has one batch of each group, of a length that is drawn by the shares.
    """
    state = state or no_state()
    alone = msgspec.structs.replace(encoder.config, members=1)
    for number, member in enumerate(encoder.members):
        torch.manual_seed(seed + number)
        generator = torch.Generator().manual_seed(seed + number)
        learner = PairEncoder(alone, encoder.speed, encoder.dt)
        descent = Descent(learner.parameters(), settings.rate, settings.updates, clip=1.0)
        stage = f"member {number + 1} of {settings.encoder.members}"
        for update in state.updates(stage, settings.updates, generator, descent):
            losses = [_loss(learner, group, settings, generator) for group in groups]
            loss = torch.stack(losses).sum()
            descent.step(loss)
            progress(stage, update + 1, settings.updates, float(loss.detach()))
        own = dict(member.named_parameters())
        with torch.no_grad():
            for name, parameter in learner.named_parameters():
                own[name].copy_(parameter)


def _loss(
    encoder: PairEncoder, group: Sequence[WeightedWindows], settings: ContrastSettings, generator: torch.Generator
) -> Float[Tensor, ""]:
    share = torch.tensor([part.share for part in group])
    part = group[int(torch.multinomial(share, 1, generator=generator))]
    rows = torch.multinomial(part.weight, settings.batch, replacement=True, generator=generator)
    windows = part.windows[rows]
    vehicles, total = windows.x.shape[1:]
    shown = int(torch.randint(2, vehicles + 1, (), generator=generator))
    if shown < vehicles:
        windows = hide_vehicles(windows, shown, generator)
    steps = int(torch.randint(round(settings.shortest * total), total + 1, (), generator=generator))
    first = int(torch.randint(total - steps + 1, (), generator=generator))
    cut = slice(first, first + steps)
    windows = Reactions(windows.x[..., cut], windows.v[..., cut], windows.leader)
    return explanation_loss(encoder, varied(windows, settings.variation, encoder.dt, generator), merge_nulls=True)


def varied(windows: Reactions, how: Variation, dt: float, generator: torch.Generator) -> Reactions:
    """Windows with other speeds, positions that fit them, and the same relations.

    Windows in which vehicles would drive backwards or touch stay as they were.
    """
    x, v = windows.x, windows.v
    each = (len(windows), 1, 1)

    def draw(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(each, generator=generator)

    sign = torch.where(torch.rand(each, generator=generator) < how.mirrored, -1.0, 1.0)
    factor = sign * draw(log(how.scale[0]), log(how.scale[1])).exp()
    faster = draw(0.0, how.faster) * (torch.rand(each, generator=generator) < 0.5)
    noise = draw(log(how.noise[0]), log(how.noise[1])).exp() * torch.randn(v.shape, generator=generator)
    mean = v.mean((1, 2), keepdim=True)
    other = mean + faster + factor * (v + noise - mean)
    order = torch.arange(v.shape[1], dtype=v.dtype)[:, None]
    moved = x + _distance(other - v, dt) + how.time_gap * faster * order
    apart = (moved[:, 1:] - moved[:, :-1] > LENGTH + how.least_gap).all(-1).all(-1)
    fine = (apart & (other >= 0).all(-1).all(-1))[:, None, None]
    return Reactions(torch.where(fine, moved, x), torch.where(fine, other, v), windows.leader)


def _distance(speed: Float[Tensor, "S N T"], dt: float) -> Float[Tensor, "S N T"]:
    """Driven since the first state [m]."""
    way = ((speed[..., 1:] + speed[..., :-1]) / 2 * dt).cumsum(-1)
    return torch.nn.functional.pad(way, (1, 0))


def _fit_novelty(model: RelationalModel, groups: Sequence[Sequence[WeightedWindows]], seed: int) -> None:
    """Windows are known that are like those that were shown, recorded or broken, of the largest number of vehicles."""
    assert model.novelty is not None
    generator = torch.Generator().manual_seed(seed)
    part = max((part for group in groups for part in group), key=lambda part: (part.windows.x.shape[1], part.share))
    rows = torch.multinomial(part.weight, NOVELTY_WINDOWS, replacement=True, generator=generator)
    steps = min(model.history_steps, part.windows.x.shape[2])
    seen = part.windows[rows]
    state = torch.zeros(*seen.x.shape[:2], steps, len(model.dynamics.state))
    state[..., 0], state[..., model.dynamics.speed] = seen.x[..., :steps], seen.v[..., :steps]
    model.novelty.fit(state, generator)
