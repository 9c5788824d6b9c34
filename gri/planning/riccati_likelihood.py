"""The likelihood of `gri.planning.laplace_likelihood` in time linear in the horizon, for vehicles with many actions.

Around the recorded actions, the return is a sum over steps of quadratics in (x_t, u_t). The linearised dynamics
δx_{t+1} = A_t δx_t + B_t δu_t tie them together. So gᵀH⁻¹g and log|−H| need no matrix over all actions: the backward
(Riccati) recursion of the linear-quadratic regulator gives both, by block elimination from the last action to the
first. C_t and c_t are the second and first derivatives of −R at step t:

    Q = C_t + FᵀVF,  q = c_t + Fᵀv,  F = [A_t B_t],
    log|−H| += log|Q_uu|,  gᵀH⁻¹g −= q_uᵀQ_uu⁻¹q_u,
    V ← Q_xx − Q_xu Q_uu⁻¹ Q_ux,  v ← q_x − Q_xu Q_uu⁻¹ q_u.

All features are squares, f = r². Their curvature is taken as 2∇r∇rᵀ (Gauss-Newton). The omitted part 2r∇²r is zero
where r = 0; elsewhere it could make −H indefinite.
"""

from collections.abc import Callable
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
class StepExpansion:
    """Derivatives of every feature at every step by the P = D + A values (x_t, u_t) of each driven vehicle.

    There are M features f = r²: those of the vehicle alone, then for every sender in index order those of every edge
    type. T counts actions here.
    """

    gradient: Float[Tensor, "B R T M P"]
    """∇f."""
    residual: Float[Tensor, "B R T M P"]
    """∇r."""
    moves: Float[Tensor, "B R T D P"]
    """F = [A_t B_t], the derivatives of the next state."""

    def __getitem__(self, scenes: Tensor | slice) -> "StepExpansion":
        """The expansion of the selected scenes."""
        return StepExpansion(self.gradient[scenes], self.residual[scenes], self.moves[scenes])

    def double(self) -> "StepExpansion":
        """The expansion in double precision; the recursion squares gradients, which costs digits."""
        return StepExpansion(self.gradient.double(), self.residual.double(), self.moves.double())

    @classmethod
    def concatenate(cls, parts: list["StepExpansion"]) -> "StepExpansion":
        """Join the scenes of several expansions, in order."""
        return cls(
            torch.cat([p.gradient for p in parts]),
            torch.cat([p.residual for p in parts]),
            torch.cat([p.moves for p in parts]),
        )


def expand_steps(
    model: RelationalModel,
    reward: StructuredReward,
    state: Float[Tensor, "B N T D"],
    action: Float[Tensor, "B R T-1 A"],
    learn: bool = False,
) -> StepExpansion:
    """Expansion of the features around recorded trajectories, under the dynamics of `model`.

    With `learn`, the expansion is differentiable in the parameters of the features (the reference networks).
    """
    vehicles = [_expand_vehicle(reward, state[:, :, :-1], action[:, j], j, learn) for j in range(action.shape[1])]
    gradient, residual = (torch.stack(parts, 1) for parts in zip(*vehicles, strict=True))
    driven = state[:, : action.shape[1], :-1]
    moves = torch.cat(vmap(vmap(vmap(jacrev(model.step, argnums=(0, 1)))))(driven, action), -1)
    return StepExpansion(gradient, residual, moves)


def _expand_vehicle(
    reward: StructuredReward, state: Tensor, action: Tensor, j: int, learn: bool
) -> tuple[Tensor, Tensor]:
    """∇f and ∇r of the features of vehicle j."""
    size = state.shape[-1]

    def node_features(point: Tensor) -> Tensor:
        return reward.node_features(point[..., :size], point[..., size:])

    def edge_features(sender: Tensor) -> Callable[[Tensor], Tensor]:
        return lambda point: torch.cat(
            [reward.edge_features(k, sender, point[..., :size]) for k in reward.terms.edge], -1
        )

    own = torch.cat([state[:, j], action], -1)
    parts = [derivatives_of_squares(node_features, own, learn)]
    parts += [derivatives_of_squares(edge_features(state[:, i]), own, learn) for i in range(state.shape[1]) if i != j]
    return torch.cat([gradient for gradient, _ in parts], 2), torch.cat([residual for _, residual in parts], 2)


def derivatives_of_squares(
    features: Callable[[Tensor], Tensor], point: Float[Tensor, "*batch P"], learn: bool = False
) -> tuple[Float[Tensor, "*batch M P"], Float[Tensor, "*batch M P"]]:
    """∇f and ∇r = ∇f / 2√f of M functions f = r², each evaluated at every point separately.

    Where f = 0, ∇f is 0 for every ∇r. So ∇r is computed at a point that is moved by a small offset in all coordinates.
    With `learn`, both are differentiable in the parameters of the functions.
    """
    gradient = _values_and_gradients(features, point, learn)[1]
    value, gradient_nearby = _values_and_gradients(features, point + _OFFSET, learn)
    root = value.clamp(min=_SMALLEST_LEARNED if learn else _SMALLEST).sqrt()
    return gradient, gradient_nearby / (2 * root)[..., None]


_OFFSET = 1e-3  # in the units of the states and actions
_SMALLEST = 1e-30  # of f under the square root
_SMALLEST_LEARNED = 1e-8  # of f where the root is differentiated again: its derivative must stay finite


@torch.enable_grad()
def _values_and_gradients(
    features: Callable[[Tensor], Tensor], point: Float[Tensor, "*batch P"], learn: bool
) -> tuple[Float[Tensor, "*batch M"], Float[Tensor, "*batch M P"]]:
    point = point.detach().requires_grad_(True)
    values = features(point)
    gradients = [
        torch.autograd.grad(value.sum(), point, retain_graph=True, create_graph=learn)[0] for value in values.unbind(-1)
    ]
    return values if learn else values.detach(), torch.stack(gradients, -2)


def log_likelihood_by_steps(reward: StructuredReward, expansion: StepExpansion) -> Float[Tensor, "B R C"]:
    """log p(u_j | z_j) [nats] of each driven vehicle under each of the C combinations of its incoming edges.

    Differentiable in the weights and in the rationality α, which multiplies the reward. The costs of the actions keep
    Q_uu positive definite. The precision (single or double) is that of the expansion.
    """
    weights = reward.weights("node"), torch.cat([reward.weights(k) for k in reward.terms.edge])
    b, r, steps, features, size = expansion.gradient.shape
    senders = (features - len(weights[0])) // len(weights[1])
    alpha = reward.log_alpha.exp()
    chosen = alpha * torch.cat([weights[0], *[weights[1]] * senders]) * combinations(reward, senders)[0]
    chosen = chosen.to(expansion.gradient.dtype)
    slopes = torch.einsum("cm,brtmp->tbrcp", chosen, expansion.gradient)
    curved = 2 * torch.einsum("cm,brtmp,brtmq->tbrcpq", chosen, expansion.residual, expansion.residual)
    d = expansion.moves.shape[3]
    value, slope = slopes.new_zeros(b, r, len(chosen), d, d), slopes.new_zeros(b, r, len(chosen), d)
    total = slopes.new_zeros(b, r, len(chosen))
    for t in reversed(range(steps)):
        moves = expansion.moves[:, :, t]
        q2 = curved[t] + _quadratic_form(value, moves)
        q1 = slopes[t] + slope @ moves
        inverse, log_det = _inverse(q2[..., d:, d:])
        gain = _product(q2[..., :d, d:], inverse)
        share = _product(q1[..., None, d:], inverse)[..., 0, :]
        total = total - 0.5 * (share * q1[..., d:]).sum(-1) + 0.5 * log_det
        value = q2[..., :d, :d] - _product(gain, q2[..., d:, :d])
        slope = q1[..., :d] - (gain * q1[..., None, d:]).sum(-1)
    return total - 0.5 * steps * (size - d) * log(2 * pi)


def _quadratic_form(value: Float[Tensor, "B R C D D"], moves: Float[Tensor, "B R D P"]) -> Float[Tensor, "B R C P P"]:
    """FᵀVF for all combinations at once: one large matrix product is faster than many tiny ones."""
    half = (value.flatten(2, 3) @ moves).unflatten(2, value.shape[2:4])  # V is symmetric, so this is (FᵀV)ᵀ
    return (half.mT.flatten(2, 3) @ moves).unflatten(2, (value.shape[2], -1))


def _product(left: Float[Tensor, "*batch I K"], right: Float[Tensor, "*batch K J"]) -> Float[Tensor, "*batch I J"]:
    """Matrix product over a short inner axis, as a sum of outer products."""
    parts = [left[..., :, k, None] * right[..., None, k, :] for k in range(left.shape[-1])]
    return torch.stack(parts).sum(0)


def _inverse(matrix: Float[Tensor, "*batch A A"]) -> tuple[Float[Tensor, "*batch A A"], Float[Tensor, "*batch"]]:
    """Inverse and log-determinant of positive definite 1 × 1 or 2 × 2 matrices."""
    if matrix.shape[-1] == 1:
        return 1 / matrix, matrix[..., 0, 0].log()
    a, b, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1]
    determinant = a * d - b * b
    adjugate = torch.stack([torch.stack([d, -b], -1), torch.stack([-b, a], -1)], -2)
    return adjugate / determinant[..., None, None], determinant.log()
