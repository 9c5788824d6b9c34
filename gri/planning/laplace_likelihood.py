"""How likely were a vehicle's recorded actions under a reward and a graph? Laplace's approximation of MaxEnt
IRL.

MaxEnt IRL calls a trajectory exp(R) likely, up to a normaliser over all trajectories. Around the recorded
actions u of one vehicle, the others held at the record, R is expanded to second order, which makes the
normaliser Gaussian (Levine and Koltun, "Continuous inverse optimal control with locally optimal examples",
2012):

    log p(u | z) = ½ gᵀH⁻¹g + ½ log|−H| − (n/2)·log 2π,    g = ∂R/∂u,  H = ∂²R/∂u²

R is a weighted sum of features, so g and H are computed once per feature and then combined for any weights
and graph. The curvature of the dynamics is left out of H; the 1-D point mass has none.

Holding the others at the record means that the vehicle foresees what they will do. Drivers do not, so long
scenes are cut into overlapping windows, each with a likelihood of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from math import log, pi
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacrev, vmap

from gri.core.graph import EdgeType, pairs, vehicle_count
from gri.core.layers import edge_ends
from gri.networks.model import RelationalModel
from gri.rewards.structured import StructuredReward


@dataclass(frozen=True)
class Expansion:
    """Derivatives of every feature, summed over a window, by each driven vehicle's own n action values.

    W counts the windows of a scene, M the features: those of the vehicle alone, then for every sender in
    index order those of every type.
    """

    gradient: Float[Tensor, "B W R M n"]
    hessian: Float[Tensor, "B W R M n n"]

    def __getitem__(self, scenes: Tensor | slice) -> "Expansion":
        return Expansion(self.gradient[scenes], self.hessian[scenes])

    @classmethod
    def concatenate(cls, parts: list["Expansion"]) -> "Expansion":
        return cls(torch.cat([p.gradient for p in parts]), torch.cat([p.hessian for p in parts]))


def expand(
    model: RelationalModel,
    reward: StructuredReward,
    state: Float[Tensor, "B N T D"],
    action: Float[Tensor, "B R T-1 A"],
    horizon: int = 19,
    stride: int = 10,
) -> Expansion:
    """Second-order expansion of the features around recorded trajectories; `model` lends its dynamics.

    A window is `horizon` actions long, or the whole scene where that is shorter; the next begins `stride`
    later.
    """
    length = min(horizon, action.shape[2])
    starts = range(0, action.shape[2] - length + 1, stride)
    states = torch.cat([state[:, :, s : s + length + 1] for s in starts])
    actions = torch.cat([action[:, :, s : s + length] for s in starts])
    vehicles = [_expand_vehicle(model, reward, states, actions[:, j], j) for j in range(action.shape[1])]
    gradient, hessian = (torch.stack(parts, 1) for parts in zip(*vehicles, strict=True))
    count = (len(starts), len(state))
    return Expansion(gradient.unflatten(0, count).transpose(0, 1), hessian.unflatten(0, count).transpose(0, 1))


def _expand_vehicle(
    model: RelationalModel, reward: StructuredReward, state: Tensor, action: Tensor, j: int
) -> tuple[Tensor, Tensor]:
    own = torch.cat([state[:, j, :-1], action], -1)  # Shape: (B, T−1, D+A)
    size = state.shape[-1]

    def alone(point: Tensor) -> Tensor:
        return reward.node_features(point[:size], point[size:])

    def towards(point: Tensor, sender: Tensor) -> Tensor:
        return torch.cat([reward.edge_features(k, sender, point[:size]) for k in reward.terms.edge])

    senders = [state[:, i, :-1] for i in range(state.shape[1]) if i != j]
    first = [_over(jacrev(alone), own)] + [_over(jacrev(towards), own, sender) for sender in senders]
    second = [_over(jacrev(jacrev(alone)), own)] + [_over(jacrev(jacrev(towards)), own, sender) for sender in senders]
    moves = sensitivities(model, state[:, j, :-1], action)  # Shape: (B, T−1, D+A, n)
    gradient = torch.einsum("btmp,btpn->bmn", torch.cat(first, 2), moves)
    curved = torch.einsum("btmpq,btqn->btmpn", torch.cat(second, 2), moves)
    return gradient, torch.einsum("btpk,btmpn->bmkn", moves, curved)


def _over(function: Callable[..., Any], *arguments: Tensor) -> Any:
    """Apply a function of single points to every scene and instant."""
    return vmap(vmap(function))(*arguments)


def sensitivities(
    model: RelationalModel, state: Float[Tensor, "B T D"], action: Float[Tensor, "B T A"]
) -> Float[Tensor, "B T D+A n"]:
    """∂(x_t, u_t)/∂u of one vehicle: S_0 = 0, S_{t+1} = (∂f/∂x)·S_t + (∂f/∂u)·E_t, with n = T·A."""
    b, steps, size = state.shape
    actions = action.shape[-1]
    by_state, by_action = _over(jacrev(model.step, argnums=(0, 1)), state, action)
    moved = state.new_zeros(b, size, steps * actions)
    rows = []
    for t in range(steps):
        pick = torch.eye(steps * actions)[t * actions : (t + 1) * actions].expand(b, -1, -1)
        rows.append(torch.cat([moved, pick], 1))
        moved = by_state[:, t] @ moved + by_action[:, t] @ pick
    return torch.stack(rows, 1)


def combinations(reward: StructuredReward, senders: int) -> tuple[Float[Tensor, "C M"], Float[Tensor, "C S K"]]:
    """All ways to set the edges that enter one vehicle: feature masks, and the types as one-hot vectors."""
    vocabulary, node = reward.vocabulary, len(reward.terms.node)
    masks, types = [], []
    for kinds in product(range(len(vocabulary)), repeat=senders):
        mask = [1.0] * node
        for kind in kinds:
            for k, terms in reward.terms.edge.items():
                mask += [float(vocabulary[kind] == k)] * len(terms)
        masks.append(mask)
        types.append(list(kinds))
    return torch.tensor(masks), torch.nn.functional.one_hot(torch.tensor(types), len(vocabulary)).float()


def log_likelihood(reward: StructuredReward, expansion: Expansion) -> Float[Tensor, "B R C"]:
    """log p(u_j | z_j) of each driven vehicle under every combination of its incoming edges.

    Differentiable in the weights and the rationality α that multiplies the reward. Where −H is not positive
    definite it is damped by max(0, 0.05·α − λ_min). Windows count as independent.
    """
    edges = torch.cat([reward.weights(k) for k in reward.terms.edge])
    features = expansion.gradient.shape[3]
    senders = (features - len(reward.weights("node"))) // len(edges)
    weights = torch.cat([reward.weights("node"), *[edges] * senders])
    alpha = reward.log_alpha.exp()
    combined = alpha * weights * combinations(reward, senders)[0]  # Shape: (C, M)
    gradient = torch.einsum("cm,bwrmn->bwrcn", combined, expansion.gradient)
    precision = torch.einsum("cm,bwrmkn->bwrckn", combined, expansion.hessian)
    lowest = torch.linalg.eigvalsh(precision.detach())[..., 0]
    damping = (0.05 * alpha.detach() - lowest).clamp(min=0)
    n = gradient.shape[-1]
    factor = torch.linalg.cholesky(precision + damping[..., None, None] * torch.eye(n))
    whitened = torch.linalg.solve_triangular(factor, gradient[..., None], upper=False)[..., 0]
    log_det = 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    return (-0.5 * (whitened**2).sum(-1) + 0.5 * log_det - 0.5 * n * log(2 * pi)).sum(1)


def edge_prior(edge_types: int, none: float) -> Float[Tensor, " K"]:
    """The sparse prior p(z_ij)."""
    return torch.tensor([none] + [(1 - none) / (edge_types - 1)] * (edge_types - 1))


def scene_prior(
    reward: StructuredReward, state: Float[Tensor, "B N T D"], none: float, ahead_only: bool = False
) -> Float[Tensor, "B E K"]:
    """p(z_ij) in every scene: the sparse prior; `ahead_only`: nobody follows a vehicle that ends up behind it."""
    n = state.shape[1]
    prior = edge_prior(len(reward.vocabulary), none).repeat(len(state), n * (n - 1), 1)
    if ahead_only:
        senders, receivers = edge_ends(n)
        behind = state[:, senders, -1, 0] < state[:, receivers, -1, 0]
        k = reward.vocabulary.index(EdgeType.FOLLOW)
        prior[..., k] = prior[..., k].masked_fill(behind, 1e-12)
    return prior / prior.sum(-1, keepdim=True)


def combination_prior(reward: StructuredReward, prior: Float[Tensor, "B E K"], driven: int) -> Float[Tensor, "B R C"]:
    """log p(z_j) of every combination of the edges that enter each driven vehicle.

    Types less probable than `LEAST` are ruled out: over a scene, likelihoods differ by hundreds of nats.
    """
    n = vehicle_count(prior.shape[1])
    incoming = torch.tensor([[pairs(n).index((i, j)) for i in range(n) if i != j] for j in range(driven)])
    logs = torch.where(prior < LEAST, NEVER, prior.log())
    return torch.einsum("brsk,csk->brc", logs[:, incoming], combinations(reward, n - 1)[1])


LEAST = 1e-30
NEVER = -1e5
"""Logarithm of the probability of what is ruled out: finite, and out of reach of any likelihood [nats]."""


def edge_posterior(
    reward: StructuredReward, expansion: Expansion, prior: Float[Tensor, "B E K"]
) -> Float[Tensor, "B E K"]:
    """p(z_ij | u) of every ordered pair."""
    return marginals(reward, log_likelihood(reward, expansion), prior)


def marginals(
    reward: StructuredReward, likelihood: Float[Tensor, "B R C"], prior: Float[Tensor, "B E K"]
) -> Float[Tensor, "B E K"]:
    """Posterior of each edge from the log-likelihoods of all combinations of edges into each driven vehicle.

    Edges into vehicles that are not driven keep the prior.
    """
    driven, n = likelihood.shape[1], vehicle_count(prior.shape[1])
    scores = likelihood + combination_prior(reward, prior, driven)
    marginal = torch.einsum("brc,csk->brsk", scores.softmax(-1), combinations(reward, n - 1)[1])
    posterior = prior.clone()
    for edge, (i, j) in enumerate(pairs(n)):
        if j < driven:
            posterior[:, edge] = marginal[:, j, i if i < j else i - 1]
    return posterior
