"""The best response of one vehicle under a given reward: no policy under that reward has a higher return.

The actions of one vehicle over the whole horizon are optimised at once (open loop), with the trajectories of all other
vehicles given. The return has several local maxima: a follower that starts ahead of its leader gains no headway before
the leader has passed it. So every scene is optimised from several initial guesses, and the best result is taken.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.planning.ilqr import ControlProblem, maximise_ilqr
from gri.rewards.structured import StructuredReward

Value = Callable[[Tensor], Tensor]
"""Actions of B scenes as vectors [B, n] -> returns [B]; scenes must not depend on each other."""


def maximise_bfgs(value: Value, guess: Float[Tensor, "B n"], iterations: int = 150) -> Float[Tensor, "B n"]:
    """Maximise the return of every scene separately: BFGS with a backtracking line search, all scenes at once.

    A step is taken if it raises the return by at least 10⁻⁴ of the first-order prediction (Armijo). The inverse Hessian
    is updated if the curvature along the step is positive.
    """
    point = guess.clone()
    inverse = torch.eye(point.shape[1], dtype=point.dtype).repeat(len(point), 1, 1)
    cost, gradient = _cost_and_gradient(value, point)
    for _ in range(iterations):
        direction = -(inverse @ gradient[..., None])[..., 0]
        uphill = (direction * gradient).sum(-1) >= 0
        direction = torch.where(uphill[:, None], -gradient, direction)
        next_point = _line_search(value, point, cost, gradient, direction)
        next_cost, next_gradient = _cost_and_gradient(value, next_point)
        inverse = _update_inverse(inverse, next_point - point, next_gradient - gradient)
        if bool(((next_point - point).abs().amax(-1) < 1e-6).all()):
            return next_point
        point, cost, gradient = next_point, next_cost, next_gradient
    return point


def _cost_and_gradient(value: Value, point: Tensor) -> tuple[Tensor, Tensor]:
    with torch.enable_grad():
        point = point.detach().requires_grad_(True)
        cost = -value(point)
        (gradient,) = torch.autograd.grad(cost.sum(), point)
    return cost.detach(), gradient


def _line_search(
    value: Value, point: Tensor, cost: Tensor, gradient: Tensor, direction: Tensor, halvings: int = 12
) -> Tensor:
    """The point after the first of the steps 1, ½, ¼, … that lowers the cost enough; no step if none does."""
    predicted = (direction * gradient).sum(-1)
    size = torch.ones_like(cost)
    found = torch.zeros(len(cost), dtype=torch.bool)
    best = point
    for _ in range(halvings):
        trial = point + size[:, None] * direction
        enough = ~found & (-value(trial) <= cost + 1e-4 * size * predicted)
        best = torch.where(enough[:, None], trial, best)
        found = found | enough
        if bool(found.all()):
            break
        size = size / 2
    return best


def _update_inverse(inverse: Tensor, step: Tensor, change: Tensor) -> Tensor:
    """BFGS: H ← (I − ρsyᵀ)·H·(I − ρysᵀ) + ρssᵀ with ρ = 1 / yᵀs, where yᵀs > 0.

    s is the step, and y the change of the gradient along it.
    """
    curvature = (step * change).sum(-1)
    usable: Bool[Tensor, " B"] = curvature > 1e-10
    rho = torch.where(usable, 1 / curvature.clamp(min=1e-10), torch.zeros_like(curvature))[:, None, None]
    eye = torch.eye(step.shape[1], dtype=step.dtype)
    left = eye - rho * step[:, :, None] * change[:, None, :]
    return left @ inverse @ left.mT + rho * step[:, :, None] * step[:, None, :]


@dataclass(frozen=True)
class ResponseProblem:
    """One scene per row: the initial state of the vehicle, and the trajectories of the S other vehicles."""

    start: Float[Tensor, "B D"]
    others: Float[Tensor, "B S T D"]
    edge_types: tuple[int, ...]
    """Index of the type of the edge from each of the others to the vehicle; 0 = none."""


def best_response(
    problem: ResponseProblem, reward: StructuredReward, dynamics: Dynamics, dt: float, iterations: int = 150
) -> Float[Tensor, "B T D"]:
    """States of the vehicle under the actions with the highest return, the best of several optimisations.

    With one action per step, BFGS optimises every guess. With more, the guess that is best after ten iterations of
    iLQR is optimised further: a matrix over all actions would be slow to compute and slow to converge.
    """
    steps, size = problem.others.shape[2] - 1, len(dynamics.action)
    others = problem.others.double()[:, :, :-1]
    control = ControlProblem(problem.start.double(), others, problem.edge_types, reward.in_double(), dynamics, dt)

    def value(actions: Tensor) -> Tensor:
        action = actions.unflatten(-1, (steps, size))
        return control.value(control.simulate(action)[:, :-1], action)

    def optimise(guess: Tensor) -> Tensor:
        if size == 1:
            return maximise_bfgs(value, guess, iterations)
        return maximise_ilqr(control, guess.unflatten(-1, (steps, size)), iterations=10).flatten(1)

    optimised = [optimise(guess) for guess in initial_actions(len(others), steps, size, dt)]
    values = torch.stack([value(actions) for actions in optimised])
    best = torch.stack(optimised)[values.argmax(0), torch.arange(len(others))].unflatten(-1, (steps, size))
    best = best if size == 1 else maximise_ilqr(control, best)
    return control.simulate(best).float()


def initial_actions(count: int, steps: int, size: int, dt: float) -> list[Float[Tensor, "B n"]]:
    """Initial guesses: constant speed, and a change within three steps to a constant acceleration [m/s²]."""
    made = []
    for acceleration in (0.0, -1.0, -2.0, -4.0, 1.0):
        action = torch.zeros(count, steps, size, dtype=torch.double)
        action[:, :3, 0] = acceleration / (3 * dt)
        made.append(action.flatten(1))
    return made
