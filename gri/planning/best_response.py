"""The optimum of the true reward: what no policy that obeys it can beat, by more than luck.

The actions of one vehicle over the whole horizon are optimised at once, open loop, with all other vehicles
given. Returns have several local optima (a follower that starts in front has no headway to gain until it has
been passed), so every scene is climbed from several guesses and the best summit is kept.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.planning.ilqr import Task, climb_by_steps
from gri.rewards.structured import StructuredReward

Value = Callable[[Tensor], Tensor]
"""Actions of B scenes as vectors [B, n] -> return [B]; scenes must not depend on each other."""


def climb(value: Value, guess: Float[Tensor, "B n"], iterations: int = 150) -> Float[Tensor, "B n"]:
    """Maximise every scene's return by itself: BFGS with a backtracking line search, all scenes at once.

    A step is taken where it raises the return by at least 10⁻⁴ of what the slope promises (Armijo); the
    inverse Hessian is updated where the curvature along the step has the right sign.
    """
    point = guess.clone()
    inverse = torch.eye(point.shape[1], dtype=point.dtype).repeat(len(point), 1, 1)
    cost, slope = _cost_and_slope(value, point)
    for _ in range(iterations):
        direction = -_product(inverse, slope)
        uphill = (direction * slope).sum(-1) >= 0
        direction = torch.where(uphill[:, None], -slope, direction)
        moved, moved_cost = _line_search(value, point, cost, slope, direction)
        moved_cost, moved_slope = _cost_and_slope(value, moved)
        inverse = _updated(inverse, moved - point, moved_slope - slope)
        if bool(((moved - point).abs().amax(-1) < 1e-6).all()):
            return moved
        point, cost, slope = moved, moved_cost, moved_slope
    return point


def _cost_and_slope(value: Value, point: Tensor) -> tuple[Tensor, Tensor]:
    with torch.enable_grad():
        point = point.detach().requires_grad_(True)
        cost = -value(point)
        (slope,) = torch.autograd.grad(cost.sum(), point)
    return cost.detach(), slope


def _line_search(
    value: Value, point: Tensor, cost: Tensor, slope: Tensor, direction: Tensor, halvings: int = 12
) -> tuple[Tensor, Tensor]:
    """The first of the steps 1, ½, ¼, … that lowers the cost enough; no step where none does."""
    promised = (direction * slope).sum(-1)
    size = torch.ones_like(cost)
    found = torch.zeros(len(cost), dtype=torch.bool)
    best, best_cost = point, cost
    for _ in range(halvings):
        trial = point + size[:, None] * direction
        trial_cost = -value(trial)
        enough = ~found & (trial_cost <= cost + 1e-4 * size * promised)
        best = torch.where(enough[:, None], trial, best)
        best_cost = torch.where(enough, trial_cost, best_cost)
        found = found | enough
        if bool(found.all()):
            break
        size = size / 2
    return best, best_cost


def _updated(inverse: Tensor, step: Tensor, change: Tensor) -> Tensor:
    """BFGS: H ← (I − ρsyᵀ)·H·(I − ρysᵀ) + ρssᵀ with ρ = 1 / yᵀs, where yᵀs > 0."""
    curvature = (step * change).sum(-1)
    usable: Bool[Tensor, " B"] = curvature > 1e-10
    rho = torch.where(usable, 1 / curvature.clamp(min=1e-10), torch.zeros_like(curvature))[:, None, None]
    eye = torch.eye(step.shape[1], dtype=step.dtype)
    left = eye - rho * step[:, :, None] * change[:, None, :]
    return left @ inverse @ left.mT + rho * step[:, :, None] * step[:, None, :]


def _product(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector[..., None])[..., 0]


@dataclass(frozen=True)
class ResponseProblem:
    """One scene per row: where the vehicle starts, and what the vehicles it may mind do meanwhile."""

    start: Float[Tensor, "B D"]
    others: Float[Tensor, "B S T D"]
    kinds: tuple[int, ...]
    """Index of the type of the edge from each of the others; 0 = none."""


def best_response(
    given: ResponseProblem, reward: StructuredReward, dynamics: Dynamics, dt: float, iterations: int = 150
) -> Float[Tensor, "B T D"]:
    """States of the vehicle under the actions with the highest true return, the best of several climbs.

    Where actions are many, only the guess that is best after a few steps climbs to its summit.
    """
    steps, size = given.others.shape[2] - 1, len(dynamics.action)
    others = given.others.double()[:, :, :-1]
    task = Task(given.start.double(), others, given.kinds, reward.in_double(), dynamics, dt)

    def value(actions: Tensor) -> Tensor:
        action = actions.unflatten(-1, (steps, size))
        return task.value(task.simulate(action)[:, :-1], action)

    def try_out(guess: Tensor) -> Tensor:
        if size == 1:
            return climb(value, guess, iterations)
        # With more actions, a matrix over all of them is slow and slow to learn.
        return climb_by_steps(task, guess.unflatten(-1, (steps, size)), iterations=10).flatten(1)

    tried = [try_out(guess) for guess in guesses(len(others), steps, size, dt)]
    values = torch.stack([value(actions) for actions in tried])
    best = torch.stack(tried)[values.argmax(0), torch.arange(len(others))].unflatten(-1, (steps, size))
    best = best if size == 1 else climb_by_steps(task, best)
    return task.simulate(best).float()


def guesses(count: int, steps: int, size: int, dt: float) -> list[Float[Tensor, "B n"]]:
    """Actions to climb from: none, and braking or speeding up within 0.6 s to a held acceleration [m/s²]."""
    made = []
    for acceleration in (0.0, -1.0, -2.0, -4.0, 1.0):
        action = torch.zeros(count, steps, size, dtype=torch.double)
        action[:, :3, 0] = acceleration / (3 * dt)
        made.append(action.flatten(1))
    return made
