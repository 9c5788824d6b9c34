"""Test out of distribution: a pair with a "follow" edge, from ever shorter and then negative headways (Sec. VI-E).

Two vehicles remain: the follower 0, and vehicle 1. The model gets the edge types of the training scenes as a forced
graph. The starting headway Δx = x_1 − x_0 goes from the lower bound of the training scenes to negative values. The
paper does not say how vehicle 1 is driven, which matters. So the test has two variants: vehicle 1 is a leader with
constant speed, or the policy drives it without a vehicle ahead.

The success rate uses x^T, the state after T actions (T = 20: 4 s).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.dynamics import Dynamics, constant_speed
from gri.core.graph import EdgeType, InteractionGraph, Vocabulary, pairs
from gri.evaluation import metrics
from gri.evaluation.metrics import Summary
from gri.networks import fast_decoder
from gri.networks.decoder import dense
from gri.networks.model import RelationalModel, relative
from gri.networks.rollout import rollout
from gri.planning.best_response import ResponseProblem, best_response
from gri.rewards.structured import StructuredReward


class Front(StrEnum):
    """How vehicle 1 is driven."""

    CONSTANT_SPEED = "constant_speed"
    POLICY = "policy"


@dataclass(frozen=True)
class Protocol:
    """Parameters of the test."""

    headways: tuple[float, ...] = tuple(float(x) for x in range(4, -9, -1))
    """Starting headways Δx [m]. The first is the lower bound of the training scenes."""
    kept: tuple[int, int] = (0, 1)
    """Indices in the training scenes of the follower and of the vehicle that it follows."""
    starts: int = 400
    """Number of starts for each headway."""
    seed: int = 1000
    final_headway: float = 2.0
    """δ_f [m]."""
    collision_distance: float = 2.0
    """δ_c [m]."""


@dataclass(frozen=True)
class HeadwayScore:
    """The test's result for one starting headway."""

    headway: float
    """Δx [m]."""
    front: Front
    success: Summary
    """Success rate (`metrics.success`)."""
    collision: Summary
    """Collision rate."""
    lateral: Summary
    """Δy [m]: lateral distance at the end minus that at the start; 0 in one dimension."""


Drive = Callable[[Tensor, Front], Tensor]
"""(starts [B, 2, D], how vehicle 1 is driven) -> states [B, 2, T+1, D]."""


def curve(drive: Drive, starts: Float[Tensor, "B 2 D"], protocol: Protocol, dynamics: Dynamics) -> list[HeadwayScore]:
    """The results for all headways and both variants. The starts differ only in Δx."""
    scores = []
    for front in Front:
        for headway in protocol.headways:
            state = drive(at_headway(starts, headway), front)
            scores.append(score(state, headway, front, protocol, dynamics))
    return scores


def score(
    state: Float[Tensor, "B 2 T D"], headway: float, front: Front, protocol: Protocol, dynamics: Dynamics
) -> HeadwayScore:
    """Success rate, collision rate and Δy of one set of trajectories."""
    places = [dynamics.index(name) for name in ("x", "y") if name in dynamics.state]
    distance = (state[:, 1] - state[:, 0])[..., places].norm(dim=-1)
    lateral = state.new_zeros(state.shape[0], state.shape[2])
    if "y" in dynamics.state:
        lateral = (state[:, 1] - state[:, 0])[..., dynamics.index("y")].abs()
    return HeadwayScore(
        headway=headway,
        front=front,
        success=metrics.proportion(metrics.success(state[:, :, -1], protocol.final_headway)),
        collision=metrics.proportion(distance.amin(-1) <= protocol.collision_distance),
        lateral=metrics.summary(lateral[:, -1] - lateral[:, 0]),
    )


def remaining_pair(start: Float[Tensor, "B N D"], kept: tuple[int, int]) -> Float[Tensor, "B 2 D"]:
    """The starts of the follower (vehicle 0 of the pair) and the vehicle that it follows (vehicle 1)."""
    return start[:, list(kept)]


def at_headway(start: Float[Tensor, "B 2 D"], headway: float) -> Float[Tensor, "B 2 D"]:
    """The starts with vehicle 0 moved along the road, so that x_1 − x_0 is `headway` [m]."""
    moved = start.clone()
    moved[:, 0, 0] = start[:, 1, 0] - headway
    return moved


def drive_by_policy(model: RelationalModel, types: Int[Tensor, " 2"], steps: int) -> Drive:
    """Drive by the model's mean actions for `steps` actions. `types` are the forced types of 0 → 1 and 1 → 0."""

    @torch.no_grad()
    def drive(start: Tensor, front: Front) -> Tensor:
        graph = InteractionGraph.certain(types.expand(len(start), 2), model.config.vocabulary).one_hot
        if front is Front.POLICY:
            return rollout_without_leader(model, start, graph, steps)
        return rollout(model, start, graph, constant_speed(start[:, 1], steps, model.dynamics, model.dt)).state

    return drive


def rollout_without_leader(
    model: RelationalModel, start: Float[Tensor, "B N D"], graph: Float[Tensor, "B E K"], steps: int
) -> Float[Tensor, "B N T D"]:
    """States of a roll-out of `steps` actions in which the policy drives all vehicles, also the last one."""
    act, memory = fast_decoder.bind(model.decoder, dense(graph)), model.memory(start)
    states = [start]
    for _ in range(steps):
        action, memory = act(relative(states[-1]), memory)
        states.append(model.step(states[-1], action))
    return torch.stack(states, 2)


def drive_optimally(reward: StructuredReward, dynamics: Dynamics, dt: float, steps: int) -> Drive:
    """Drive by the open-loop optimum of the true reward for `steps` actions of `dt` [s]: the ceiling of the test.

    With `Front.POLICY`, vehicle 1 first gets its own optimum.
    """
    follow = reward.vocabulary.index(EdgeType.FOLLOW)

    def drive(start: Tensor, front: Front) -> Tensor:
        ahead = constant_speed(start[:, 1], steps, dynamics, dt)
        if front is Front.POLICY:
            ahead = best_response(ResponseProblem(start[:, 1], ahead[:, None], (0,)), reward, dynamics, dt)
        follower = best_response(ResponseProblem(start[:, 0], ahead[:, None], (follow,)), reward, dynamics, dt)
        return torch.stack([follower, ahead], 1)

    return drive


def follow_edge(vocabulary: Vocabulary) -> Int[Tensor, " 2"]:
    """Types of 0 → 1 and 1 → 0 for models whose types have a meaning: "none" and "follow"."""
    return torch.tensor([0, vocabulary.index(EdgeType.FOLLOW)])


def modal_edges(inferred: Int[Tensor, "S E"], kept: tuple[int, int], vehicles: int) -> Int[Tensor, " 2"]:
    """Types of 0 → 1 and 1 → 0 for models whose types have no meaning: the types most often inferred for the pair.

    `kept` are the indices of follower and followed vehicle in the scenes with `vehicles` vehicles.
    """
    follower, leader = kept
    order = [pairs(vehicles).index(pair) for pair in ((follower, leader), (leader, follower))]
    return torch.stack([inferred[:, edge].mode().values for edge in order])


def area(points: Sequence[HeadwayScore], front: Front) -> float:
    """Mean success rate over the range of headways: the area under the curve, relative to the largest possible."""
    return mean_height([(p.headway, p.success.mean) for p in points if p.front is front])


def mean_height(points: Sequence[tuple[float, float]]) -> float:
    """Mean of a curve (x, y) over its range of x, by the trapezoidal rule."""
    ordered = sorted(points)
    total = sum((b[0] - a[0]) * (a[1] + b[1]) / 2 for a, b in pairwise(ordered))
    return total / (ordered[-1][0] - ordered[0][0])
