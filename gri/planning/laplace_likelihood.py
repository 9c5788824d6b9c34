"""The likelihood of a vehicle's recorded actions under a reward and a graph: Laplace's approximation of MaxEnt IRL.

MaxEnt IRL (Sec. III-B) gives a trajectory the probability exp(R), up to a normaliser over all trajectories. Around the
recorded actions u of one vehicle, R is expanded to second order, with the other vehicles fixed at their records. The
normaliser is then that of a Gaussian (Levine and Koltun, "Continuous inverse optimal control with locally optimal
examples", 2012):

    log p(u | z) = −½ gᵀ(−H)⁻¹g + ½ log|−H| − (n/2)·log 2π,    g = ∂R/∂u,  H = ∂²R/∂u²

R is a weighted sum of features. So g and H are computed once per feature and then combined for any weights and graph.
The curvature of the dynamics is left out of H; the 1-D point mass has none.

With the other vehicles fixed at their records, the vehicle foresees what they will do. Drivers do not. So long scenes
are cut into overlapping windows, each with a likelihood of its own.
"""

from dataclasses import dataclass
from math import log, pi

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacrev, vmap

from gri.networks.model import RelationalModel
from gri.planning.edge_posterior import combinations
from gri.rewards.structured import StructuredReward


@dataclass(frozen=True)
class Expansion:
    """Derivatives of every feature, summed over a window, by the n action values of each of the R driven vehicles.

    There are W windows per scene and M features: those of the vehicle alone, then for every sender in index order those
    of every edge type.
    """

    gradient: Float[Tensor, "B W R M n"]
    hessian: Float[Tensor, "B W R M n n"]

    def __getitem__(self, scenes: Tensor | slice) -> "Expansion":
        """The expansion of the selected scenes."""
        return Expansion(self.gradient[scenes], self.hessian[scenes])

    @classmethod
    def concatenate(cls, parts: list["Expansion"]) -> "Expansion":
        """Join the scenes of several expansions, in order."""
        return cls(torch.cat([p.gradient for p in parts]), torch.cat([p.hessian for p in parts]))


def expand(
    model: RelationalModel,
    reward: StructuredReward,
    state: Float[Tensor, "B N T D"],
    action: Float[Tensor, "B R T-1 A"],
    horizon: int = 19,
    stride: int = 10,
) -> Expansion:
    """Second-order expansion of the features around recorded trajectories, under the dynamics of `model`.

    A window has `horizon` actions, or all actions of a shorter scene. The next window begins `stride` actions later.
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
    """Gradients [B, M, n] and Hessians [B, M, n, n] of the features of vehicle j, summed over time."""
    own = torch.cat([state[:, j, :-1], action], -1)  # Shape: (B, T−1, D+A)
    size = state.shape[-1]

    def node_features(point: Tensor) -> Tensor:
        return reward.node_features(point[:size], point[size:])

    def edge_features(point: Tensor, sender: Tensor) -> Tensor:
        return torch.cat([reward.edge_features(k, sender, point[:size]) for k in reward.terms.edge])

    first, second = [vmap(vmap(jacrev(node_features)))(own)], [vmap(vmap(jacrev(jacrev(node_features))))(own)]
    for sender in (state[:, i, :-1] for i in range(state.shape[1]) if i != j):
        first.append(vmap(vmap(jacrev(edge_features)))(own, sender))
        second.append(vmap(vmap(jacrev(jacrev(edge_features))))(own, sender))
    moves = sensitivities(model, state[:, j, :-1], action)  # Shape: (B, T−1, D+A, n)
    gradient = torch.einsum("btmp,btpn->bmn", torch.cat(first, 2), moves)
    half = torch.einsum("btmpq,btqn->btmpn", torch.cat(second, 2), moves)
    return gradient, torch.einsum("btpk,btmpn->bmkn", moves, half)


def sensitivities(
    model: RelationalModel, state: Float[Tensor, "B T D"], action: Float[Tensor, "B T A"]
) -> Float[Tensor, "B T D+A n"]:
    """∂(x_t, u_t)/∂u of one vehicle, with n = T·A: S_0 = 0, S_{t+1} = (∂f/∂x)·S_t + (∂f/∂u)·E_t.

    f is the step of the model's dynamics, and E_t selects u_t from all n action values.
    """
    b, steps, size = state.shape
    actions = action.shape[-1]
    by_state, by_action = vmap(vmap(jacrev(model.step, argnums=(0, 1))))(state, action)
    moved = state.new_zeros(b, size, steps * actions)
    rows = []
    for t in range(steps):
        pick = torch.eye(steps * actions)[t * actions : (t + 1) * actions].expand(b, -1, -1)
        rows.append(torch.cat([moved, pick], 1))
        moved = by_state[:, t] @ moved + by_action[:, t] @ pick
    return torch.stack(rows, 1)


def log_likelihood(reward: StructuredReward, expansion: Expansion) -> Float[Tensor, "B R C"]:
    """log p(u_j | z_j) [nats] of each driven vehicle under each of the C combinations of its incoming edges.

    Differentiable in the weights and in the rationality α, which multiplies the reward. To make −H positive definite,
    max(0, 0.05·α − λ_min) is added to its diagonal. Windows count as independent.
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
