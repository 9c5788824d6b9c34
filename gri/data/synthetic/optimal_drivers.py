"""Highway merges with optimal drivers: each maximises the true reward, given the trajectories of the others.

No policy is trained. Newton steps (`gri.planning.ilqr`) improve one vehicle's actions after the other, in a few sweeps,
from the actions of a distance controller. So each driver foresees the others and the leader. The likelihood in grounded
training makes the same assumption (`gri.planning.laplace_likelihood`).
"""

from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.dynamics import dynamics_named
from gri.core.graph import InteractionGraph, incoming
from gri.core.scenes import Scenes
from gri.data.ranges.highway_merge import HighwayMergeRange, Situation, SituationShare
from gri.data.ranges.highway_states import sample_history, sample_leader, sample_takeovers
from gri.data.ranges.merge_geometry import VEHICLE_LENGTH
from gri.data.synthetic.expert import true_reward
from gri.planning.ilqr import ControlProblem, maximise_ilqr
from gri.progress import Progress, no_progress

SWEEPS = 2
"""Passes over all driven vehicles."""
ITERATIONS = 12
"""Newton steps per vehicle and sweep."""
CAR_WIDTH = 2.0
"""[m]."""
OVERSAMPLING = 1.3
"""Scenes started for each scene wanted, because some are rejected."""


def make_highway_scenes(
    scenes: HighwayMergeRange,
    graphs: Literal["one", "mixed"],
    count: int,
    seed: int,
    progress: Progress = no_progress,
) -> Scenes:
    """`count` scenes with their histories, in random order.

    Scenes are rejected if vehicles have contact, or if vehicle 0 should merge behind the leader and ends ahead of it.
    """
    generator = torch.Generator().manual_seed(seed)
    shares = scenes.mixed_graphs if graphs == "mixed" else scenes.one_graph
    parts = []
    for done, share in enumerate(shares):
        progress("scenes", done, len(shares), 0.0)
        wanted = round(share.share * count) if done else count - sum(round(s.share * count) for s in shares[1:])
        parts.append(_scenes_with_graph(scenes, share, wanted, generator))
    progress("scenes", len(shares), len(shares), 0.0)
    scenes_in_order = Scenes(*(torch.cat(values) for values in zip(*(vars(p).values() for p in parts), strict=True)))
    return scenes_in_order[torch.randperm(count, generator=generator)]


def _scenes_with_graph(
    scenes: HighwayMergeRange, share: SituationShare, wanted: int, generator: torch.Generator
) -> Scenes:
    accepted: list[Scenes] = []
    while (missing := wanted - sum(len(part) for part in accepted)) > 0:
        start = sample_takeovers(scenes, share.situation, int(OVERSAMPLING * missing) + 8, generator)
        leader = sample_leader(scenes, start[:, 2], generator)
        start = torch.cat([start[:, :2], leader[:, :1]], 1)
        history = sample_history(scenes, share.situation, start, generator)
        edges = {(edge.sender, edge.receiver): edge.type for edge in share.edges}
        graph = InteractionGraph.of_edges(edges, scenes.vocabulary).map[0]
        found = drive_optimally(scenes, start, leader, graph)
        behind = found.state[:, 2, -1, 0] > found.state[:, 0, -1, 0]
        good = (~in_contact(found.state) & behind) | (share.situation is Situation.PASSING)
        accepted.append(Scenes(found.state, found.action, found.graph, history)[good.nonzero()[:missing, 0]])
    return Scenes(*(torch.cat(values) for values in zip(*(vars(p).values() for p in accepted), strict=True)))


def in_contact(state: Float[Tensor, "S N T D"]) -> Bool[Tensor, " S"]:
    """Whether vehicle 0 overlaps with the leader 2 or the lag vehicle 1 at any step."""
    distance = state[:, [2, 0]] - state[:, [0, 1]]
    overlap = (distance[..., 0].abs() < VEHICLE_LENGTH) & (distance[..., 1].abs() < CAR_WIDTH)
    return overlap.any(-1).any(-1)


@torch.no_grad()
def drive_optimally(
    scenes: HighwayMergeRange,
    start: Float[Tensor, "S 3 6"],
    leader: Float[Tensor, "S T 6"],
    graph: Int[Tensor, " E"],
) -> Scenes:
    """Scenes in which vehicles 0 and 1 play their best responses under one graph (indices of edge types).

    `start` and `leader` are states of Dubins' car (x, y, v, heading, a, yaw rate).
    """
    dynamics, reward = dynamics_named(scenes.dynamics), true_reward(scenes).in_double()
    start, leader, graphs = start.double(), leader.double(), graph.expand(len(start), -1)
    roles = [incoming(graphs, j, 3) for j in range(2)]

    def task(j: int, state: Tensor) -> ControlProblem:
        others, kinds = roles[j]
        given = state[:, others, :-1]
        return ControlProblem(
            start[:, j], given, tuple(kinds[0].tolist()), reward, dynamics, scenes.dt, scenes.never_reverse
        )

    action = distance_controller(scenes, start, leader, graph)
    state = torch.stack([*(task(j, start[:, :, None]).simulate(action[:, j]) for j in range(2)), leader], 1)
    for _ in range(SWEEPS):
        for j in range(2):
            action[:, j] = maximise_ilqr(task(j, state), action[:, j], ITERATIONS)
            state[:, j] = task(j, state).simulate(action[:, j])
    return Scenes(state.float(), action.float(), graphs)


def distance_controller(
    scenes: HighwayMergeRange,
    start: Float[Tensor, "S 3 6"],
    leader: Float[Tensor, "S T 6"],
    graph: Int[Tensor, " E"],
) -> Float[Tensor, "S 2 T-1 2"]:
    """Actions of a linear controller of headway and speed, as the first guess.

    Each vehicle keeps its distance to the vehicles that it follows or yields to. From a first guess that has passed the
    leader, small steps cannot lead back behind it.
    """
    dynamics, constants = dynamics_named(scenes.dynamics), scenes.reward.constants.following
    targets = []
    for j in range(2):
        senders, kinds = incoming(graph[None], j, 3)
        types = (scenes.vocabulary[kind] for kind in kinds[0].tolist())
        targets.append([i for i, kind in zip(senders, types, strict=True) if kind in ("follow", "yield")])
    now, actions = start, []
    for t in range(leader.shape[1] - 1):
        now = torch.cat([now[:, :2], leader[:, t : t + 1]], 1)
        action = torch.zeros(len(start), 2, 2, dtype=start.dtype)
        for j, senders in enumerate(targets):
            x, v, a = now[:, j, 0], now[:, j, 2], now[:, j, 4]
            desired = torch.zeros_like(a)
            for i in senders:
                excess = now[:, i, 0] - x - constants.standstill - constants.time_headway * v
                desired = (0.8 * (now[:, i, 2] - v) + 0.12 * excess).clamp(-4.0, 1.5)
            action[:, j, 0] = ((desired - a) / 0.6).clamp(-6.0, 6.0)
        actions.append(action)
        now = torch.cat([dynamics.step(now[:, :2], action, scenes.dt), now[:, 2:]], 1)
    return torch.stack(actions, 2)
