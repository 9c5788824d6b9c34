"""Differentiable roll-outs of a relational model with the leader given (Sec. V-A, VI-C).

The leader is the last vehicle. Its recorded states are fed in step by step. The policy moves the other vehicles.
"""

from dataclasses import dataclass
from math import log, pi

import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.trajectory import Trajectory
from gri.networks import fast_decoder
from gri.networks.decoder import dense
from gri.networks.model import RelationalModel, relative


@dataclass(frozen=True)
class Rollout:
    """T states of all N vehicles, and the T−1 actions of the R = N−1 driven vehicles between them (SI units)."""

    state: Float[Tensor, "B N T D"]
    action: Float[Tensor, "B R T-1 A"]

    def trajectory(self, dt: float) -> Trajectory:
        """The states as a complete trajectory with the sampling time `dt` [s]."""
        return Trajectory.complete(self.state, dt)


def rollout(
    model: RelationalModel,
    start: Float[Tensor, "B N D"],
    graph: Float[Tensor, "B E K"],
    leader: Float[Tensor, "B T D"],
    noise: Float[Tensor, "B R T-1 A"] | None = None,
    detach_senders: bool = False,
) -> Rollout:
    """Drive all vehicles but the last from `start` under the one-hot `graph`, over the T states of `leader`.

    Actions are the means of the policy, or μ + σ·noise (reparameterised) with standard normal `noise`.
    `detach_senders` cuts the gradient through the states that a vehicle sees of others: its action gets no gradient for
    what it makes other vehicles do.
    """
    driven = start.shape[1] - 1
    act = fast_decoder.bind(model.decoder, dense(graph)[:, :, :driven], detach_senders)
    sigma = model.decoder.sigma
    memory = model.memory(start[:, :driven])
    origin = start[:, -1:] * torch.eye(start.shape[-1])[0]  # small positions keep the digits of float32
    start, leader = start - origin, leader - origin
    states, actions = [start], []
    for t in range(leader.shape[1] - 1):
        action, memory = act(states[-1], memory)
        if noise is not None:
            action = action + sigma * noise[:, :, t]
        moved = model.step(states[-1][:, :driven], action)
        states.append(torch.cat([moved, leader[:, t + 1 : t + 2]], 1))
        actions.append(action)
    return Rollout(torch.stack(states, 2) + origin[:, :, None], torch.stack(actions, 2))


def log_density(normal: Float[Tensor, "*batch A"], sigma: Float[Tensor, " A"]) -> Float[Tensor, "*batch"]:
    """log N(μ + σ·normal; μ, σ²), summed over the action features."""
    return (-0.5 * normal**2 - torch.log(sigma) - 0.5 * log(2 * pi)).sum(-1)


def log_prob_of(
    model: RelationalModel,
    state: Float[Tensor, "B N T D"],
    action: Float[Tensor, "B R T-1 A"],
    graph: Float[Tensor, "B E K"],
) -> Float[Tensor, "B R T-1"]:
    """log π(a_t | x_t, z) of recorded actions at the recorded states; SI units, summed over action features."""
    sigma = model.decoder.sigma
    means = mean_actions(model, state, graph, driven=action.shape[1])
    return log_density((action - means) / sigma, sigma)


def mean_actions(
    model: RelationalModel, state: Float[Tensor, "B N T D"], graph: Float[Tensor, "B E K"], driven: int
) -> Float[Tensor, "B R T-1 A"]:
    """μ(x_t, z) of the driven vehicles at the recorded states but the last; SI units."""
    act = fast_decoder.bind(model.decoder, dense(graph)[:, :, :driven])
    memory = model.memory(state[:, :driven, 0])
    means = []
    for t in range(state.shape[2] - 1):
        mean, memory = act(relative(state[:, :, t]), memory)
        means.append(mean)
    return torch.stack(means, 2)
