"""GRI's rows: the graph by the likelihood of motion under the structured reward, untrained and trained.

Everything is the project's own training on the benchmark's scenes, without their relations: the reward is fitted by
`gri.training.grounded`, and the encoder learns the posterior. The reward has the constants of the US-101 range.
"""

from collections.abc import Sequence
from functools import cache
from math import log

import torch
from jaxtyping import Float
from torch import Tensor

from gri.bench.answers import Infer
from gri.bench.car_following_scenes import DT, WINDOW, KnownScenes, accelerations
from gri.bench.structure import FLAT, share_among_those_ahead
from gri.core.edges import EdgeType, pairs
from gri.core.scale import Scale
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import US101
from gri.networks.encoder import EncoderConfig
from gri.networks.model import ModelConfig, RelationalModel
from gri.planning.edge_posterior import combinations
from gri.planning.riccati_likelihood import expand_steps, log_likelihood_by_steps
from gri.rewards.structured import StructuredReward
from gri.training.grounded.reward_likelihood import fit_reward
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import fit_encoder_and_policy

SCALE = Scale(offset=(0.0, 16.0, 0.0), unit=(30.0, 8.0, 1.0), action=(1.0,))
SETTINGS = GroundedSettings(
    no_edge_prior=1 - FLAT,
    likelihood="stepwise",
    reward_updates=150,
    reward_scenes=600,
    encoder_lead=500,
    encoder_rate=3e-3,
    encoder_updates=0,
    updates=0,
)
POSTERIOR_SCENES = 100  # of each driver model and family; the encoder learns their posterior
_CHUNK = 300  # scenes whose expansions are in memory at once


def point_mass_scenes(known: KnownScenes, count: int | None = None) -> Scenes:
    """The window as the point mass has it: the acceleration of a state acts until the next one, the action is jerk.

    The last frame is left out, as its acceleration is not known. Relations are left out as well.
    """
    state = known.state[:count, :, :WINDOW]
    moved = torch.stack([state[:, :, :-1, 0], state[:, :, :-1, 1], accelerations(state[..., 1])], -1)
    moved[..., 0] -= moved[:, -1:, :1, 0].clone()  # small positions keep the digits of float32
    jerk = (moved[:, :-1, 1:, 2:] - moved[:, :-1, :-1, 2:]) / DT
    nothing = torch.zeros(len(state), len(pairs(state.shape[1])), dtype=torch.long)
    return Scenes(moved.float(), jerk.float(), nothing)


def training_scenes(train: Sequence[KnownScenes], each: int | None = None) -> Scenes:
    """States of all driver models and families together, without relations."""
    parts = [point_mass_scenes(known, each) for known in train]
    return Scenes(*(torch.cat([getattr(part, name) for part in parts]) for name in ("state", "action", "graph")))


def new_model(seed: int) -> RelationalModel:
    """An untrained model of the size of the others, for the range of the benchmark."""
    torch.manual_seed(seed)
    config = ModelConfig(
        dt=DT, history_steps=WINDOW - 1, never_reverse=True, scale=SCALE, encoder=EncoderConfig(hidden=32)
    )
    return RelationalModel(config)


def encoder_answers(model: RelationalModel) -> Infer:
    """P(follow) by the encoder of a model of `new_model`."""
    follow = model.config.vocabulary.index(EdgeType.FOLLOW)
    model.eval()

    @torch.no_grad()
    def infer(known: KnownScenes) -> Float[Tensor, "S E"]:
        return model.infer(point_mass_scenes(known).state).probs[..., follow].double()

    return infer


@cache
def _fitted(train: tuple[KnownScenes, ...], seed: int) -> StructuredReward:
    reward = StructuredReward(US101.reward)
    generator = torch.Generator().manual_seed(seed)
    fit_reward(new_model(seed), reward, training_scenes(train, 50), SETTINGS, generator)
    return reward.requires_grad_(False)


@torch.no_grad()
def _log_likelihoods(reward: StructuredReward, scenes: Scenes) -> Float[Tensor, "S R C"]:
    """Of the driven vehicles' actions under each combination of edges into them."""
    model, parts = new_model(0), []
    for first in range(0, len(scenes), _CHUNK):
        part = scenes[first : first + _CHUNK]
        expansion = expand_steps(model, reward, part.state, part.action).double()
        parts.append(log_likelihood_by_steps(reward, expansion))
    return torch.cat(parts)


def _flat_posterior(reward: StructuredReward, scenes: Scenes) -> Float[Tensor, "S E"]:
    """P(follow) with the flat prior: any set of edges may enter a vehicle. The foremost one keeps the prior."""
    likelihood = _log_likelihoods(reward, scenes)
    n = scenes.state.shape[1]
    types = combinations(reward, n - 1)[1][..., 1].double()  # Shape: (C, senders)
    prior = (types * log(FLAT) + (1 - types) * log(1 - FLAT)).sum(-1)
    marginal = ((likelihood + prior).softmax(-1) @ types).clamp(max=1.0)  # sums may exceed 1 by a rounding error
    found = torch.full((len(scenes), len(pairs(n))), FLAT, dtype=torch.float64)
    for edge, (i, j) in enumerate(pairs(n)):
        if j < n - 1:
            found[:, edge] = marginal[:, j, i if i < j else i - 1]
    return found


def _one_leader_posterior(reward: StructuredReward, scenes: Scenes) -> Float[Tensor, "S E"]:
    """P(follow) with the structured prior, from the likelihoods of single edges."""
    likelihood = _log_likelihoods(reward, scenes)
    n = scenes.state.shape[1]
    types = combinations(reward, n - 1)[1][..., 1]
    nobody = int((types.sum(-1) == 0).nonzero())
    ratio = torch.zeros(len(scenes), len(pairs(n)), dtype=torch.float64)
    for edge, (i, j) in enumerate(pairs(n)):
        if j < n - 1:
            sender = i if i < j else i - 1
            single = int(((types.sum(-1) == 1) & (types[:, sender] == 1)).nonzero())
            ratio[:, edge] = likelihood[:, j, single] - likelihood[:, j, nobody]
    return share_among_those_ahead(ratio)


def untrained_reward(structured: bool) -> Infer:
    """The posterior under ψ = 0: every weight is 2, and the rationality 1."""
    posterior = _one_leader_posterior if structured else _flat_posterior
    reward = StructuredReward(US101.reward).requires_grad_(False)
    return lambda known: posterior(reward, point_mass_scenes(known))


def fitted_reward(train: Sequence[KnownScenes], seed: int, structured: bool) -> Infer:
    """The posterior under the reward that the training scenes' motion makes most likely; their relations are unseen.

    The fit sums over all graphs with the flat prior, as grounded training does.
    """
    posterior, reward = _one_leader_posterior if structured else _flat_posterior, _fitted(tuple(train), seed)
    return lambda known: posterior(reward, point_mass_scenes(known))


@cache
def _taught_encoder(train: tuple[KnownScenes, ...], seed: int) -> RelationalModel:
    model, reward = new_model(seed), _fitted(train, seed)
    scenes = training_scenes(train, POSTERIOR_SCENES)
    follow = _flat_posterior(reward, scenes).float()
    posterior = torch.stack([1 - follow, follow], -1)
    generator = torch.Generator().manual_seed(seed)
    fit_encoder_and_policy(model, reward, scenes, posterior, SETTINGS, generator)
    return model


def taught_encoder(train: Sequence[KnownScenes], seed: int) -> Infer:
    """GRI's encoder, which learns the posterior under the fitted reward with the flat prior."""
    return encoder_answers(_taught_encoder(tuple(train), seed))
