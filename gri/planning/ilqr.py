"""Maximise one vehicle's return by iterative LQR: Newton steps in time linear in the horizon.

Around the present trajectory, the return is the sum of quadratics of `gri.planning.riccati_likelihood` (Gauss-Newton).
The backward recursion gives new actions u + k + K·(x' − x), where x' is the new state. The step k is shortened until
the return rises (Tassa et al., "Synthesis and stabilization of complex behaviors through online trajectory
optimization", 2012). If no length helps, Q_uu is damped more, which makes the next step smaller. All scenes are
optimised at once and independently of each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacrev, vmap

from gri.core.dynamics import Dynamics
from gri.planning.riccati_likelihood import derivatives_of_squares
from gri.rewards.structured import StructuredReward


@dataclass(frozen=True)
class ControlProblem:
    """One scene per row: the initial state of the vehicle, the states of the S others, and their edges to it."""

    start: Float[Tensor, "B D"]
    others: Float[Tensor, "B S T D"]
    """States of the other vehicles at the T instants at which the vehicle takes an action."""
    edge_types: Sequence[int]
    """Index of the type of the edge from each of the others to the vehicle; 0 = none."""
    reward: StructuredReward
    dynamics: Dynamics
    dt: float
    """Time between two actions [s]."""
    never_reverse: bool = False
    """The vehicle stops at v = 0, by the `stop` of the dynamics."""

    def __getitem__(self, scenes: Tensor) -> "ControlProblem":
        """The problem of the selected scenes."""
        return replace(self, start=self.start[scenes], others=self.others[scenes])

    def step(self, state: Float[Tensor, "*batch D"], action: Float[Tensor, "*batch A"]) -> Float[Tensor, "*batch D"]:
        """The next state of the vehicle."""
        moved = self.dynamics.step(state, action, self.dt)
        stop = self.dynamics.stop if self.never_reverse else None
        return moved if stop is None else stop(state, moved)

    def simulate(self, action: Float[Tensor, "B T A"]) -> Float[Tensor, "B T+1 D"]:
        """States of the vehicle under these actions, the initial state included."""
        states = [self.start]
        for u in action.unbind(1):
            states.append(self.step(states[-1], u))
        return torch.stack(states, 1)

    def features(self, state: Float[Tensor, "*batch T D"], action: Float[Tensor, "*batch T A"]) -> Tensor:
        """All features in the vehicle's reward [*batch, T, M], in the order of `weights`."""
        parts = [self.reward.node_features(state, action)]
        for other, kind in zip(self.others.unbind(1), self.edge_types, strict=True):
            if kind:
                name = self.reward.vocabulary[kind]
                parts.append(self.reward.edge_features(name, other.expand_as(state), state))
        return torch.cat(parts, -1)

    @property
    def weights(self) -> Float[Tensor, " M"]:
        """Weights of the features."""
        kinds = [self.reward.vocabulary[kind] for kind in self.edge_types if kind]
        return torch.cat([self.reward.weights("node"), *(self.reward.weights(kind) for kind in kinds)])

    def value(self, state: Float[Tensor, "*batch T D"], action: Float[Tensor, "*batch T A"]) -> Float[Tensor, "*batch"]:
        """The return: the sum of rewards over time."""
        return -(self.features(state, action) @ self.weights).sum(-1)


@torch.no_grad()
def maximise_ilqr(
    problem: ControlProblem, guess: Float[Tensor, "B T A"], iterations: int = 60, tolerance: float = 1e-4
) -> Float[Tensor, "B T A"]:
    """Actions at a local maximum of the return near the guess.

    A scene is optimised until an iteration raises its return by less than `tolerance`.
    """
    action, state = guess.clone(), problem.simulate(guess)
    value = problem.value(state[:, :-1], action)
    damping = torch.full_like(value, 1e-4)
    active = torch.arange(len(guess))
    for _ in range(iterations):
        part, x, u, old_damping = problem[active], state[active], action[active], damping[active]
        trial_state, trial, trial_value = _line_search(part, x, u, *gains(part, x, u, old_damping))
        gained = (trial_value - value[active]).clamp(min=0)
        better = gained > 0
        improved = active[better]
        action[improved], state[improved], value[improved] = trial[better], trial_state[better], trial_value[better]
        damping[active] = torch.where(better, old_damping / 5, old_damping * 20).clamp(1e-8, 1e6)
        active = active[(gained >= tolerance) | (~better & (old_damping <= 1.0))]
        if not len(active):
            break
    return action


def gains(
    problem: ControlProblem,
    state: Float[Tensor, "B T D"],
    action: Float[Tensor, "B T-1 A"],
    damping: Float[Tensor, " B"],
) -> tuple[Float[Tensor, "B T-1 A"], Float[Tensor, "B T-1 A D"]]:
    """The open-loop step k and the feedback gain K at every instant, from the backward recursion.

    `damping` is added to the diagonal of Q_uu, one number per scene.
    """
    size = state.shape[-1]
    point = torch.cat([state[:, :-1], action], -1)
    gradient, residual = derivatives_of_squares(lambda p: problem.features(p[..., :size], p[..., size:]), point)
    slopes, curved = problem.weights @ gradient, 2 * residual.mT @ (problem.weights[:, None] * residual)
    moves = torch.cat(vmap(vmap(jacrev(problem.step, argnums=(0, 1))))(state[:, :-1], action), -1)
    damped = damping[:, None, None] * torch.eye(action.shape[-1], dtype=state.dtype)
    value, linear = torch.zeros_like(curved[:, 0, :size, :size]), torch.zeros_like(slopes[:, 0, :size])
    open_loop, feedback = [], []
    for t in reversed(range(action.shape[1])):
        q2 = curved[:, t] + moves[:, t].mT @ value @ moves[:, t]
        q1 = slopes[:, t] + (linear[:, None] @ moves[:, t])[:, 0]
        right = torch.cat([q1[:, size:, None], q2[:, size:, :size]], -1)
        solved = torch.linalg.solve(q2[:, size:, size:] + damped, right)
        k, gain = -solved[..., 0], -solved[..., 1:]
        # The shorter form V = Q_xx − Q_xu Q_uu⁻¹ Q_ux holds for exact minimisers only; a damped step is not exact.
        uu, ux = q2[:, size:, size:], q2[:, size:, :size]
        value = q2[:, :size, :size] + gain.mT @ uu @ gain + gain.mT @ ux + ux.mT @ gain
        along = q1[:, size:, None] + uu @ k[..., None]
        linear = q1[:, :size] + (gain.mT @ along + ux.mT @ k[..., None])[..., 0]
        open_loop.append(k)
        feedback.append(gain)
    return torch.stack(open_loop[::-1], 1), torch.stack(feedback[::-1], 1)


_STEP_LENGTHS = (1.0, 0.6, 0.3, 0.1, 0.03, 0.01)


def _line_search(
    problem: ControlProblem, state: Tensor, action: Tensor, open_loop: Tensor, feedback: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """States, actions and return under the step length with the highest return, for every scene."""
    lengths = torch.tensor(_STEP_LENGTHS, dtype=state.dtype)[:, None, None]
    now = state[:, 0].expand(len(_STEP_LENGTHS), -1, -1)
    states, actions = [now], []
    for t in range(action.shape[1]):
        correction = (feedback[:, t] @ (now - state[:, t])[..., None])[..., 0]
        actions.append(action[:, t] + lengths * open_loop[:, t] + correction)
        now = problem.step(now, actions[-1])
        states.append(now)
    trial_state, trial = torch.stack(states, 2), torch.stack(actions, 2)
    value = problem.value(trial_state[:, :, :-1], trial)
    best, place = value.max(0)
    scenes = torch.arange(len(action))
    return trial_state[place, scenes], trial[place, scenes], best
