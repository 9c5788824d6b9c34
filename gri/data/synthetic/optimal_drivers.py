"""Scenes whose drivers are optimal: each plays its best response to the true reward and to what the others then do.

No policy is trained for them. Newton steps (`gri.planning.ilqr`) start from a driver who keeps its distance, and go
round the vehicles a few times. Drivers so foresee each other, the leader included, as the likelihood of grounded
training also takes them to do (`gri.planning.laplace_likelihood`).
"""

from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.dynamics import dynamics_named
from gri.core.graph import InteractionGraph, incoming
from gri.core.scenes import Scenes
from gri.data.ranges.highway_merge import (
    LENGTH,
    HighwayMergeRange,
    Situation,
    SituationShare,
    leader_drive,
    sample_history,
    sample_takeovers,
)
from gri.data.synthetic.expert import true_reward
from gri.planning.ilqr import Task, climb_by_steps
from gri.progress import Progress, no_progress

SWEEPS, ITERATIONS = 2, 12
CAR_WIDTH = 2.0  # [m]
SPARE = 1.3  # scenes begun per scene kept, as some starts end badly


def make_highway_scenes(
    scenes: HighwayMergeRange,
    graphs: Literal["one", "mixed"],
    count: int,
    seed: int,
    progress: Progress = no_progress,
) -> Scenes:
    """Scenes in random order, with their histories; without those in which the optimum has a contact or, merging behind
    the leader, ends ahead of it.
    """
    generator = torch.Generator().manual_seed(seed)
    shares = scenes.mixed_graphs if graphs == "mixed" else scenes.one_graph
    parts = []
    for done, share in enumerate(shares):
        progress("scenes", done, len(shares), 0.0)
        wanted = round(share.share * count) if done else count - sum(round(s.share * count) for s in shares[1:])
        parts.append(_of_graph(scenes, share, wanted, generator))
    progress("scenes", len(shares), len(shares), 0.0)
    together = Scenes(*(torch.cat(values) for values in zip(*(vars(p).values() for p in parts), strict=True)))
    return together[torch.randperm(count, generator=generator)]


def _of_graph(scenes: HighwayMergeRange, share: SituationShare, wanted: int, generator: torch.Generator) -> Scenes:
    kept: list[Scenes] = []
    while (missing := wanted - sum(len(part) for part in kept)) > 0:
        start = sample_takeovers(scenes, share.situation, int(SPARE * missing) + 8, generator)
        leader = leader_drive(scenes, start[:, 2], generator)
        start = torch.cat([start[:, :2], leader[:, :1]], 1)
        history = sample_history(scenes, share.situation, start, generator)
        edges = {(edge.sender, edge.receiver): edge.type for edge in share.edges}
        graph = InteractionGraph.of_edges(edges, scenes.vocabulary).map[0]
        found = drive_optimally(scenes, start, leader, graph)
        behind = found.state[:, 2, -1, 0] > found.state[:, 0, -1, 0]
        good = (~in_contact(found.state) & behind) | (share.situation is Situation.PASSING)
        kept.append(Scenes(found.state, found.action, found.graph, history)[good.nonzero()[:missing, 0]])
    return Scenes(*(torch.cat(values) for values in zip(*(vars(p).values() for p in kept), strict=True)))


def in_contact(state: Float[Tensor, "S N T D"]) -> Bool[Tensor, " S"]:
    """Whether vehicle 0 ever has the others' length and width in common with them."""
    apart = state[:, [2, 0]] - state[:, [0, 1]]  # to the leader, and from who lags
    touching = (apart[..., 0] < LENGTH) & (apart[..., 0] > -LENGTH) & (apart[..., 1].abs() < CAR_WIDTH)
    return touching.any(-1).any(-1)


@torch.no_grad()
def drive_optimally(
    scenes: HighwayMergeRange,
    start: Float[Tensor, "S 3 6"],
    leader: Float[Tensor, "S T 6"],
    graph: Int[Tensor, " E"],
) -> Scenes:
    """Both drivers on their best response under one graph."""
    dynamics, reward = dynamics_named(scenes.dynamics), true_reward(scenes).in_double()
    start, leader, graphs = start.double(), leader.double(), graph.expand(len(start), -1)
    roles = [incoming(graphs, j, 3) for j in range(2)]

    def task(j: int, state: Tensor) -> Task:
        others, kinds = roles[j]
        given = state[:, others, :-1]
        return Task(start[:, j], given, tuple(kinds[0].tolist()), reward, dynamics, scenes.dt, scenes.never_reverse)

    action = keep_distance(scenes, start, leader, graph)
    state = torch.stack([*(task(j, start[:, :, None]).simulate(action[:, j]) for j in range(2)), leader], 1)
    for _ in range(SWEEPS):
        for j in range(2):
            action[:, j] = climb_by_steps(task(j, state), action[:, j], ITERATIONS)
            state[:, j] = task(j, state).simulate(action[:, j])
    return Scenes(state.float(), action.float(), graphs)


def keep_distance(
    scenes: HighwayMergeRange,
    start: Float[Tensor, "S 3 6"],
    leader: Float[Tensor, "S T 6"],
    graph: Int[Tensor, " E"],
) -> Float[Tensor, "S 2 T-1 2"]:
    """The first guess: a linear controller of headway and speed behind whoever a vehicle follows or yields to.

    From a guess that has passed the leader, no small step leads back behind it.
    """
    dynamics, constants = dynamics_named(scenes.dynamics), scenes.reward.constants.following
    ahead = [[i for i, kind in zip(*_first(graph, j), strict=True) if scenes.vocabulary[kind] in ("follow", "yield")]
             for j in range(2)]  # fmt: skip
    now, actions = start, []
    for t in range(leader.shape[1] - 1):
        now = torch.cat([now[:, :2], leader[:, t : t + 1]], 1)
        action = torch.zeros(len(start), 2, 2, dtype=start.dtype)
        for j, senders in enumerate(ahead):
            x, v, a = now[:, j, 0], now[:, j, 2], now[:, j, 4]
            wanted = torch.zeros_like(a)
            for i in senders:
                missing = now[:, i, 0] - x - constants.standstill - constants.time_headway * v
                wanted = (0.8 * (now[:, i, 2] - v) + 0.12 * missing).clamp(-4.0, 1.5)
            action[:, j, 0] = ((wanted - a) / 0.6).clamp(-6.0, 6.0)
        actions.append(action)
        now = torch.cat([dynamics.step(now[:, :2], action, scenes.dt), now[:, 2:]], 1)
    return torch.stack(actions, 2)


def _first(graph: Int[Tensor, " E"], j: int) -> tuple[list[int], list[int]]:
    """Senders to vehicle j, and the types of their edges."""
    others, kinds = incoming(graph[None], j, 3)
    return others, kinds[0].tolist()
