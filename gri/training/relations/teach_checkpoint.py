"""Give a trained car-following model an encoder that was taught who reacts to whom.

Reward and policy stay as they are. The encoder is replaced by a `PairEncoder`. The score of novelty is fitted to the
histories of the scenes that the model was trained on.
"""

import time
from collections.abc import Mapping
from typing import Any

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.graph import FOLLOWING, pairs
from gri.errors import InputError
from gri.networks.model import RelationalModel
from gri.networks.pair_encoder import LENGTH, PairEncoder, PairEncoderConfig
from gri.networks.rollout import rollout
from gri.progress import Progress, no_progress
from gri.relations.reaction_scenes import OWN, UNSEEN, Reactions, draw_reactions
from gri.training.relations.teach_encoder import TeachingSettings, broken_batch, teach_encoder, teach_policys_reactions
from gri.training.training_state import TrainingState, identity_of

NOVELTY_SCENES = 8000  # drawn scenes that the score of novelty is fitted to, besides a quarter of it from the policy


def teach_model(
    model: RelationalModel,
    known: Float[Tensor, "S N T D"],
    settings: TeachingSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> tuple[RelationalModel, Mapping[str, Any]]:
    """The model with a taught encoder, and how it was taught, for the provenance.

    With `state`, the teaching goes on where that one was stopped.

    Args:
        known: histories of the scenes that the model was trained on, of three vehicles.

    Raises:
        InputError: the model does not drive car following.
    """
    if model.config.vocabulary != FOLLOWING:
        kinds = ", ".join(model.config.vocabulary)
        raise InputError(
            f"got a model with edge types {kinds}, wanted none and follow; merge models learn with --merges"
        )
    started = time.process_time()
    torch.manual_seed(seed)
    config = msgspec.structs.replace(model.config, encoder=None, pair_encoder=PairEncoderConfig())
    taught = RelationalModel(config)
    taught.decoder.load_state_dict(model.decoder.state_dict())
    assert isinstance(taught.encoder, PairEncoder)
    teach_encoder(taught.encoder, settings, seed, progress, state)
    driven = policy_rollouts(taught, known, torch.Generator().manual_seed(seed))
    teach_policys_reactions(taught.encoder, driven, settings, seed + 1, progress, state)
    fit_novelty(taught, known, settings, seed)
    made = {
        "settings": msgspec.to_builtins(settings),
        "seed": seed,
        "cpu_seconds": round(time.process_time() - started + (state.spent[1] if state else 0.0)),
    }
    return taught.requires_grad_(False).eval(), made


def teaching_identity(
    model: RelationalModel, known: Float[Tensor, "S N T D"], settings: TeachingSettings, seed: int
) -> str:
    """What makes a teaching the same one: all arguments of `teach_model` that its result depends on."""
    return identity_of(settings, seed, (*model.state_dict().values(), known))


ROLLOUTS = 12_000


def policy_rollouts(model: RelationalModel, known: Float[Tensor, "S 3 T D"], generator: torch.Generator) -> Reactions:
    """The policy's roll-outs from the first states of known scenes under random graphs, less those with a contact.

    The foremost vehicle moves as in the scene. Each other vehicle follows one of those ahead, or none, with equal odds.
    """
    rows = torch.randint(len(known), (ROLLOUTS,), generator=generator)
    draws = torch.rand((2, ROLLOUTS), generator=generator)
    first, second = (draws[0] * 3).long(), (draws[1] * 2).long()  # 0 follows none, 1 or 2; 1 follows none or 2
    leader = torch.stack([torch.tensor([OWN, 1, 2])[first], torch.tensor([OWN, 2])[second]], 1)
    leader = torch.cat([leader, torch.full((ROLLOUTS, 1), UNSEEN)], 1)
    types = torch.stack([(leader[:, j] == i).long() for i, j in pairs(3)], 1)
    graph = torch.nn.functional.one_hot(types, 2).float()
    with torch.no_grad():
        state = rollout(model, known[rows, :, 0], graph, known[rows, -1]).state
    x, v = state[..., 0], state[..., model.dynamics.speed]
    apart = (x[:, 1:] - x[:, :-1] > LENGTH + 0.3).all(-1).all(-1)
    return Reactions(x[apart], v[apart], leader[apart])


def fit_novelty(model: RelationalModel, known: Float[Tensor, "S 3 T D"], settings: TeachingSettings, seed: int) -> None:
    """Scenes are known that are like those that the encoder was taught with, or like those of the policy; in place."""
    assert model.novelty is not None
    generator, steps = torch.Generator().manual_seed(seed), model.history_steps
    pool = draw_reactions(settings.prior, 2 * NOVELTY_SCENES, settings.steps, model.dt, generator)
    windows = msgspec.structs.replace(settings, window=(steps, steps), vehicles=(3, 3), batch=NOVELTY_SCENES)
    drawn = broken_batch(pool, windows, generator)
    taught = torch.zeros(*drawn.x.shape, known.shape[-1])
    taught[..., 0], taught[..., model.novelty.speed] = drawn.x, drawn.v
    rows = torch.randint(len(known), (NOVELTY_SCENES // 4,), generator=generator)
    model.novelty.fit(torch.cat([taught, known[rows]]), generator)
