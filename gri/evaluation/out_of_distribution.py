"""Out of distribution: one "follow" edge is kept and the follower starts ever closer, then ahead (Sec. VI-E).

Two vehicles remain, numbered 0 (it follows) and 1, and the edge types of the data are forced on the model.
The starting headway Δx = x_1 − x_0 goes from the lower bound of the training scenes into negative values.
The paper does not say who drives vehicle 1, and it matters, so both are run: it keeps its speed as a given
leader, or it is driven by the same policy without a vehicle to heed.

x^T, the state the success rate looks at, is here the state after T actions (T = 20: 4 s).
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
from gri.networks.decoder import dense
from gri.networks.model import RelationalModel, relative
from gri.networks.rollout import rollout
from gri.planning.best_response import ResponseProblem, best_response
from gri.rewards.structured import StructuredReward


class Front(StrEnum):
    """Who drives vehicle 1."""

    CONSTANT_SPEED = "constant_speed"
    POLICY = "policy"


@dataclass(frozen=True)
class Protocol:
    """What is tested."""

    headways: tuple[float, ...] = tuple(float(x) for x in range(4, -9, -1))
    """Δx [m]; the first is the lower bound of the training scenes."""
    kept: tuple[int, int] = (0, 1)
    """Indices, in the training scenes, of the follower and of the vehicle it follows."""
    starts: int = 400
    seed: int = 1000
    final_headway: float = 2.0
    """δ_f [m]."""
    collision_distance: float = 2.0
    """δ_c [m]."""


@dataclass(frozen=True)
class HeadwayScore:
    """One headway of one curve."""

    headway: float
    front: Front
    success: Summary
    collision: Summary
    lateral: Summary
    """Δy [m]: how much farther apart the two are sideways at the end than at the start; 0 in one dimension."""


Drive = Callable[[Tensor, Front], Tensor]
"""(starts [B, 2, D], who drives vehicle 1) -> states [B, 2, T+1, D]."""


def curve(drive: Drive, starts: Float[Tensor, "B 2 D"], protocol: Protocol, dynamics: Dynamics) -> list[HeadwayScore]:
    """All points, for both ways to drive vehicle 1, always from the same starts but for Δx."""
    points = []
    for front in Front:
        for headway in protocol.headways:
            state = drive(at_headway(starts, headway), front)
            points.append(score(state, headway, front, protocol, dynamics))
    return points


def score(
    state: Float[Tensor, "B 2 T D"], headway: float, front: Front, protocol: Protocol, dynamics: Dynamics
) -> HeadwayScore:
    """Success, collision and Δy of one set of trajectories."""
    places = [dynamics.index(name) for name in ("x", "y") if name in dynamics.state]
    distance = (state[:, 1] - state[:, 0])[..., places].norm(dim=-1)
    apart = state.new_zeros(state.shape[0], state.shape[2])
    if "y" in dynamics.state:
        apart = (state[:, 1] - state[:, 0])[..., dynamics.index("y")].abs()
    return HeadwayScore(
        headway=headway,
        front=front,
        success=metrics.proportion(metrics.success(state[:, :, -1], protocol.final_headway)),
        collision=metrics.proportion(distance.amin(-1) <= protocol.collision_distance),
        lateral=metrics.summary(apart[:, -1] - apart[:, 0]),
    )


def remaining_pair(start: Float[Tensor, "B N D"], kept: tuple[int, int]) -> Float[Tensor, "B 2 D"]:
    """The two vehicles that remain; the followed one is renumbered 1."""
    return start[:, list(kept)]


def at_headway(start: Float[Tensor, "B 2 D"], headway: float) -> Float[Tensor, "B 2 D"]:
    """Vehicle 0 moved along the road until x_1 − x_0 is the headway."""
    moved = start.clone()
    moved[:, 0, 0] = start[:, 1, 0] - headway
    return moved


def drive_by_policy(model: RelationalModel, types: Int[Tensor, " 2"], steps: int) -> Drive:
    """Drive by mean actions under a forced graph over the two ordered pairs (0 → 1, 1 → 0)."""

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
    """States when the policy drives all vehicles, the last one as well, for `steps` actions."""
    act, memory = model.decoder.bind(dense(graph)), model.memory(start)
    states = [start]
    for _ in range(steps):
        action, memory = act(relative(states[-1]), memory)
        states.append(model.step(states[-1], action))
    return torch.stack(states, 2)


def drive_optimally(reward: StructuredReward, dynamics: Dynamics, dt: float, steps: int) -> Drive:
    """The open-loop optimum of the true reward; a vehicle 1 that is driven has its own optimum first."""
    follow = reward.vocabulary.index(EdgeType.FOLLOW)

    def drive(start: Tensor, front: Front) -> Tensor:
        ahead = constant_speed(start[:, 1], steps, dynamics, dt)
        if front is Front.POLICY:
            ahead = best_response(ResponseProblem(start[:, 1], ahead[:, None], (0,)), reward, dynamics, dt)
        behind = best_response(ResponseProblem(start[:, 0], ahead[:, None], (follow,)), reward, dynamics, dt)
        return torch.stack([behind, ahead], 1)

    return drive


def follow_edge(vocabulary: Vocabulary) -> Int[Tensor, " 2"]:
    """The graph of the test for models whose types have a meaning: 1 → 0 is "follow", 0 → 1 nothing."""
    return torch.tensor([0, vocabulary.index(EdgeType.FOLLOW)])


def modal_edges(inferred: Int[Tensor, "S E"], kept: tuple[int, int], vehicles: int) -> Int[Tensor, " 2"]:
    """The graph of the test for models whose types mean nothing: what they most often infer for the two pairs."""
    behind, ahead = kept
    order = [pairs(vehicles).index(pair) for pair in ((behind, ahead), (ahead, behind))]
    return torch.stack([inferred[:, edge].mode().values for edge in order])


def area(points: Sequence[HeadwayScore], front: Front) -> float:
    """Area under the success curve over the tested headways, as a share of the largest possible one."""
    return mean_height([(p.headway, p.success.mean) for p in points if p.front is front])


def mean_height(points: Sequence[tuple[float, float]]) -> float:
    """Mean height of a curve over its range, by the trapezoidal rule."""
    ordered = sorted(points)
    total = sum((b[0] - a[0]) * (a[1] + b[1]) / 2 for a, b in pairwise(ordered))
    return total / (ordered[-1][0] - ordered[0][0])
