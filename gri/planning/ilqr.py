"""The optimum of one vehicle's return by Newton steps in time linear in the horizon (iterative LQR).

Around the present trajectory the return is the sum of quadratics of `gri.planning.riccati_likelihood`, with the
curvature of squares by Gauss-Newton. The backward recursion gives the step u + k + K·(x' − x), which is shortened until
the return rises (Tassa et al., "Synthesis and stabilization of complex behaviors through online trajectory
optimization", 2012). Where no length helps, Q_uu is damped and the next step is smaller. All scenes move at once and
independently of each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jacrev, vmap

from gri.core.dynamics import Dynamics
from gri.planning.riccati_likelihood import derivatives
from gri.rewards.structured import StructuredReward


@dataclass(frozen=True)
class Task:
    """One scene per row: where the vehicle starts, what the others do, and the types of their edges to it."""

    start: Float[Tensor, "B D"]
    others: Float[Tensor, "B S T D"]
    """At the T instants at which an action is taken."""
    kinds: Sequence[int]
    """Index of the type of the edge from each of the others; 0 = none."""
    reward: StructuredReward
    dynamics: Dynamics
    dt: float
    never_reverse: bool = False
    """The vehicle stops at v = 0, where the dynamics say how."""

    def __getitem__(self, scenes: Tensor) -> "Task":
        return replace(self, start=self.start[scenes], others=self.others[scenes])

    def step(self, state: Float[Tensor, "*batch D"], action: Float[Tensor, "*batch A"]) -> Float[Tensor, "*batch D"]:
        """The vehicle's next state."""
        moved = self.dynamics.step(state, action, self.dt)
        stop = self.dynamics.stop if self.never_reverse else None
        return moved if stop is None else stop(state, moved)

    def simulate(self, action: Float[Tensor, "B T A"]) -> Float[Tensor, "B T+1 D"]:
        states = [self.start]
        for u in action.unbind(1):
            states.append(self.step(states[-1], u))
        return torch.stack(states, 1)

    def features(self, state: Float[Tensor, "*batch T D"], action: Float[Tensor, "*batch T A"]) -> Tensor:
        """All features the vehicle pays for; the last axis is that of `weights`."""
        parts = [self.reward.node_features(state, action)]
        for other, kind in zip(self.others.unbind(1), self.kinds, strict=True):
            if kind:
                name = self.reward.vocabulary[kind]
                parts.append(self.reward.edge_features(name, other.expand_as(state), state))
        return torch.cat(parts, -1)

    @property
    def weights(self) -> Float[Tensor, " M"]:
        kinds = [self.reward.vocabulary[kind] for kind in self.kinds if kind]
        return torch.cat([self.reward.weights("node"), *(self.reward.weights(kind) for kind in kinds)])

    def value(self, state: Float[Tensor, "*batch T D"], action: Float[Tensor, "*batch T A"]) -> Float[Tensor, "*batch"]:
        """The return."""
        return -(self.features(state, action) @ self.weights).sum(-1)


@torch.no_grad()
def climb_by_steps(
    task: Task, guess: Float[Tensor, "B T A"], iterations: int = 60, tolerance: float = 1e-4
) -> Float[Tensor, "B T A"]:
    """Actions at a local maximum of the return near the guess; a scene moves on while it gains `tolerance`."""
    action, state = guess.clone(), task.simulate(guess)
    value = task.value(state[:, :-1], action)
    damping = torch.full_like(value, 1e-4)
    moving = torch.arange(len(guess))
    for _ in range(iterations):
        part, now, acted, lift = task[moving], state[moving], action[moving], damping[moving]
        trial_state, trial, trial_value = _search(part, now, acted, *gains(part, now, acted, lift))
        gained = (trial_value - value[moving]).clamp(min=0)
        better = gained > 0
        risen = moving[better]
        action[risen], state[risen], value[risen] = trial[better], trial_state[better], trial_value[better]
        damping[moving] = torch.where(better, lift / 5, lift * 20).clamp(1e-8, 1e6)
        moving = moving[(gained >= tolerance) | (~better & (lift <= 1.0))]
        if not len(moving):
            break
    return action


def gains(
    task: Task,
    state: Float[Tensor, "B T D"],
    action: Float[Tensor, "B T-1 A"],
    damping: Float[Tensor, " B"],
) -> tuple[Float[Tensor, "B T-1 A"], Float[Tensor, "B T-1 A D"]]:
    """k and K of every step, from the backward recursion."""
    size = state.shape[-1]
    point = torch.cat([state[:, :-1], action], -1)
    slope, residual = derivatives(lambda p: task.features(p[..., :size], p[..., size:]), point)
    slopes, curved = task.weights @ slope, 2 * residual.mT @ (task.weights[:, None] * residual)
    step = vmap(vmap(jacrev(task.step, argnums=(0, 1))))
    moves = torch.cat(step(state[:, :-1], action), -1)
    lift = damping[:, None, None] * torch.eye(action.shape[-1], dtype=state.dtype)
    value, linear = torch.zeros_like(curved[:, 0, :size, :size]), torch.zeros_like(slopes[:, 0, :size])
    open_loop, feedback = [], []
    for t in reversed(range(action.shape[1])):
        q2 = curved[:, t] + moves[:, t].mT @ value @ moves[:, t]
        q1 = slopes[:, t] + (linear[:, None] @ moves[:, t])[:, 0]
        right = torch.cat([q1[:, size:, None], q2[:, size:, :size]], -1)
        solved = torch.linalg.solve(q2[:, size:, size:] + lift, right)
        k, gain = -solved[..., 0], -solved[..., 1:]
        # Not the shorter form for exact minimisers: the damped step is none.
        uu, ux = q2[:, size:, size:], q2[:, size:, :size]
        value = q2[:, :size, :size] + gain.mT @ uu @ gain + gain.mT @ ux + ux.mT @ gain
        along = q1[:, size:, None] + uu @ k[..., None]
        linear = q1[:, :size] + (gain.mT @ along + ux.mT @ k[..., None])[..., 0]
        open_loop.append(k)
        feedback.append(gain)
    return torch.stack(open_loop[::-1], 1), torch.stack(feedback[::-1], 1)


_LENGTHS = (1.0, 0.6, 0.3, 0.1, 0.03, 0.01)


def _search(
    task: Task, state: Tensor, action: Tensor, open_loop: Tensor, feedback: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """States, actions and return of the best length of the step."""
    lengths = torch.tensor(_LENGTHS, dtype=state.dtype)[:, None, None]
    now = state[:, 0].expand(len(_LENGTHS), -1, -1)
    states, actions = [now], []
    for t in range(action.shape[1]):
        answer = (feedback[:, t] @ (now - state[:, t])[..., None])[..., 0]
        actions.append(action[:, t] + lengths * open_loop[:, t] + answer)
        now = task.step(now, actions[-1])
        states.append(now)
    trial_state, trial = torch.stack(states, 2), torch.stack(actions, 2)
    value = task.value(trial_state[:, :, :-1], trial)
    best, place = value.max(0)
    scenes = torch.arange(len(action))
    return trial_state[place, scenes], trial[place, scenes], best
