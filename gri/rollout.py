"""Differentiable roll-outs of a relational model with the leader given (Sec. V-A, VI-C).

The leader is the last vehicle. Its recorded states are fed in step by step while the others move by the
policy.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from gri.decoder import dense
from gri.model import RelationalModel
from gri.types import Trajectory


@dataclass(frozen=True)
class Rollout:
    """What a policy did: T states and the T−1 actions between them."""

    state: Float[Tensor, "B N T D"]
    action: Float[Tensor, "B N T-1 A"]
    log_prob: Float[Tensor, "B N T-1"]
    """log π(a|x, z) of each action; of the density at its own mean where the actions are means."""

    def trajectory(self, dt: float) -> Trajectory:
        return Trajectory.complete(self.state, dt)


def rollout(
    model: RelationalModel,
    start: Float[Tensor, "B N D"],
    graph: Float[Tensor, "B E K"],
    leader: Float[Tensor, "B T D"],
    noise: Float[Tensor, "B N T-1 A"] | None = None,
) -> Rollout:
    """Drive all vehicles but the last from `start` by one-hot `graph`, as long as `leader` lasts.

    Actions are the policy's means, or μ + σ·noise (reparameterised) where standard normal `noise` is given.
    """
    z, memory, sigma = dense(graph), model.memory(start), model.decoder.sigma
    steps = leader.shape[1] - 1
    states, actions = [start], []
    for t in range(steps):
        action, memory = model.decoder(states[-1], z, memory)
        if noise is not None:
            action = action + sigma * noise[:, :, t]
        moved = model.step(states[-1], action)
        states.append(torch.cat([moved[:, :-1], leader[:, t + 1 : t + 2]], 1))
        actions.append(action)
    normal = noise if noise is not None else torch.zeros_like(torch.stack(actions, 2))
    return Rollout(torch.stack(states, 2), torch.stack(actions, 2), log_density(normal, sigma))


def log_density(normal: Float[Tensor, "*batch A"], sigma: Float[Tensor, " A"]) -> Float[Tensor, "*batch"]:
    """log N(μ + σ·normal; μ, σ²), summed over the action features."""
    return (-0.5 * normal**2 - torch.log(sigma) - 0.9189385332046727).sum(-1)


def log_prob_of(
    model: RelationalModel,
    state: Float[Tensor, "B N T D"],
    action: Float[Tensor, "B N T-1 A"],
    graph: Float[Tensor, "B E K"],
) -> Float[Tensor, "B N T-1"]:
    """log π(a|x, z) of recorded actions at the recorded states."""
    z, memory, means = dense(graph), model.memory(state[:, :, 0]), []
    for t in range(action.shape[2]):
        mean, memory = model.decoder(state[:, :, t], z, memory)
        means.append(mean)
    sigma = model.decoder.sigma
    return log_density((action - torch.stack(means, 2)) / sigma, sigma)
