"""Why an action was taken: what the policy would have done without an edge of its graph.

The recorded drive is given to the policy again, step by step. The same decisions come out, which is checked. Then each
edge is set to none, and the difference in acceleration is the effect of the edge [m/s²]. A policy without a graph is
asked instead what it would do without a vehicle, which is moved `FAR` ahead. One that follows whoever is next ahead
does not see the sender of the edge ahead of it either; a vehicle without an edge has such an effect, too.

Begin with `effects_of`.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cosim.show.episode_view import EpisodeView, InferredEdge
from cosim.spec.scenario import CarFollowing, Scenario
from cosim.world.road_frame import model_offsets
from gri.core.dynamics import DUBINS, POINT_MASS_1D
from gri.core.graph import FOLLOWING, LANE_CHANGING, EdgeType, InteractionGraph
from gri.core.nearby import Nearby, NextAhead
from gri.core.policy import Policy, PolicyState
from gri.core.trajectory import Trajectory
from gri.networks.next_ahead import FollowsNextAhead

FAR = 500.0  # [m], how far ahead a vehicle is moved that is to have no effect
LOOK_BACK = 1.0  # [s], for how long an edge is absent in the second comparison
AGREES = 0.02  # [m/s²], the largest difference between a recorded acceleration and the one that is computed again


@dataclass(frozen=True)
class Effect:
    """The effect of one reason on one vehicle at T instants of the drive.

    `reason` is "follow 2" for an edge, "ahead 2" for a vehicle ahead without one, "vehicle 2" for a policy without a
    graph. All accelerations are in m/s².
    """

    receiver: int
    reason: str
    time: Float[np.ndarray, " T"]
    """Since the take-over [s]."""
    acceleration: Float[np.ndarray, " T"]
    """As driven."""
    decision: Float[np.ndarray, " T"]
    """What the reason added to it in the last decision."""
    second: Float[np.ndarray, " T"]
    """What the reason added to it in the last second: the vehicle drives without the reason, the others as recorded."""
    lateral: Float[np.ndarray, " T"]
    """As `second`, of the acceleration across the direction of travel, v·ω; to the left is positive."""
    agrees: Bool[np.ndarray, " T"]
    """Whether the policy gives the recorded acceleration when it decides again."""


@dataclass(frozen=True)
class Outside:
    """The M vehicles near a group at one instant: fronts along the road and centres across it [m], and so on."""

    s: Float[np.ndarray, " M"]
    d: Float[np.ndarray, " M"]
    v: Float[np.ndarray, " M"]
    length: Float[np.ndarray, " M"]
    width: Float[np.ndarray, " M"]

    def next_ahead(self, s: Float[np.ndarray, " N"], d: Float[np.ndarray, " N"]) -> NextAhead:
        """The next one ahead in the path of each of N vehicles at these places, as a policy is told it."""
        from_each = (self.s - s[:, None], self.d - d[:, None], self.v, self.length, self.width)
        ahead, across, v, length, width = (torch.from_numpy(of[None]).float() for of in from_each)
        return NextAhead.of(Nearby(ahead, across, v, length, width, torch.ones_like(v, dtype=torch.bool)))


@dataclass(frozen=True)
class Drive:
    """What a policy saw in its drive: states of T + 1 instants in the frame of the model, and the graph at each."""

    state: Float[Tensor, "T N D"]
    history: Float[Tensor, "N H D"]
    graphs: Sequence[Mapping[tuple[int, int], EdgeType]]
    """The edges at each instant, without pairs of type none; empty for a policy without a graph."""
    outside: Sequence[Outside] = ()
    """The others near at each instant; empty where they are not known."""
    origin: tuple[Float[np.ndarray, " N"], float] | None = None
    """What is added to x and to y of each vehicle, to have its front along and its centre across the road [m]."""


def drive_of(view: EpisodeView, scenario: Scenario) -> Drive:
    """The drive of an episode as its policy saw it; x counts from the leader at the take-over."""
    rows, in_lane = np.flatnonzero(view.during_drive), isinstance(scenario.group, CarFollowing)
    states = _model_states(view, in_lane, scenario.step)
    begin = float(states[rows[0], -1, 0])
    states[..., 0] -= begin
    last = len(rows) if in_lane else len(rows) - 2  # heading and yaw rate are those between successive positions
    graphs = (
        [_edges_at(view.inferred_edges, float(view.time[row])) for row in rows[:last]] if view.inferred_edges else []
    )
    history = states[: rows[0] + 1].transpose(0, 1)
    if view.around is None:
        return Drive(states[rows[:last]], history, graphs)
    now = rows[0]
    shift = view.feature("s")[now] - states[now, :, 0].numpy()
    aside = float(view.feature("d")[now, 0] - (0.0 if in_lane else states[now, 0, 1]))
    return Drive(states[rows[:last]], history, graphs, _outside(view.around, view.time[rows[:last]]), (shift, aside))


def _outside(around: pd.DataFrame, times: Float[np.ndarray, " T"]) -> list[Outside]:
    found = []
    for time in times.tolist():
        now = around[(around["time"] - time).abs() < 1e-6]
        found.append(Outside(*(now[name].to_numpy(float) for name in ("s", "d", "v", "length", "width"))))
    return found


def _model_states(view: EpisodeView, in_lane: bool, dt: float) -> Float[Tensor, "T N D"]:
    """States of all recorded instants in double precision, as `cosim.loop.state_layouts` makes them.

    The heading is that of the path: Dubins' car moves by v·Δt along its heading. Vehicles that SUMO drives have no yaw
    rate.
    """
    s, d, v, a = (view.feature(name) for name in ("s", "d", "v", "a"))
    if in_lane:
        return torch.from_numpy(np.stack([s + model_offsets(view.length[None])[0], v, a], -1))
    moved_s, moved_d = (np.diff(value, axis=0, append=value[-1:]) for value in (s, d))
    heading = np.where(moved_s > 1e-6, np.arctan2(moved_d, np.maximum(moved_s, 1e-6)), 0.0)
    turned = np.diff(heading, axis=0, append=heading[-1:]) / dt
    driven = view.driven.any(0) & view.during_drive[:, None]
    offset, target = model_offsets(view.length[None], order=(1, 0, 2))[0], d[np.argmax(view.during_drive), 2]
    return torch.from_numpy(np.stack([s + offset, d - target, v, heading, a, np.where(driven, turned, 0.0)], -1))


def _edges_at(edges: Sequence[InferredEdge], time: float) -> dict[tuple[int, int], EdgeType]:
    """The edges in use at a time [s]: those of the latest inference."""
    latest = max(edge.time for edge in edges if edge.time <= time + 1e-6)
    now = [edge for edge in edges if edge.time == latest and edge.type != "none"]
    return {(edge.sender, edge.receiver): EdgeType(edge.type) for edge in now}


@torch.inference_mode()
def effects_of(drive: Drive, policy: Policy, driven: Sequence[int]) -> list[Effect]:
    """The effects of all edges into driven vehicles, and of all edges into a vehicle together where it has several.

    For a policy without a graph: the effects of all other vehicles.
    """
    own = _Replay(policy, drive)
    memories = own.memories()
    found = []
    for receiver in driven:
        for reason in _reasons(drive, receiver):
            without = own.without(reason, receiver)
            found.append(_effect(own, without, memories, reason, receiver))
        if isinstance(policy, FollowsNextAhead):
            found += [effect for effect in _ahead(own, memories, receiver) if np.abs(effect.decision).max() >= AGREES]
    return found


def _ahead(own: "_Replay", memories: Sequence[PolicyState], receiver: int) -> Iterator[Effect]:
    """The effects of vehicles that a vehicle sees ahead of it, and to which it has no edge."""
    with_edge = {sender for graph in own.drive.graphs for sender, to in graph if to == receiver}
    for sender in range(own.drive.state.shape[1]):
        if sender != receiver and sender not in with_edge:
            reason = ((sender, "ahead"),)
            yield _effect(own, own.without(reason, receiver), memories, reason, receiver)


@torch.inference_mode()
def effect_since_takeover(drive: Drive, policy: Policy, sender: int, receiver: int, steps: int) -> float:
    """What the edge from the sender did to the mean acceleration [m/s²] of the receiver in the first `steps`.

    The receiver drives without the edge from the take-over on, all others as recorded.
    """
    return float(_effect_of_pairs(drive, policy, {(sender, receiver)}, [receiver], steps)[receiver])


@torch.inference_mode()
def effect_of_vehicle(
    drive: Drive, policy: Policy, sender: int, driven: Sequence[int], steps: int
) -> Float[np.ndarray, " N"]:
    """What a vehicle did to the mean acceleration [m/s²] of each vehicle in the first `steps`, also by way of others.

    All `driven` vehicles drive together without its edges from the take-over on, the others as recorded.
    """
    others = [receiver for receiver in range(drive.state.shape[1]) if receiver != sender]
    return _effect_of_pairs(drive, policy, {(sender, receiver) for receiver in others}, driven, steps)


def _effect_of_pairs(
    drive: Drive, policy: Policy, pairs: Collection[tuple[int, int]], driven: Sequence[int], steps: int
) -> Float[np.ndarray, " N"]:
    """What these pairs (sender, receiver) did to the mean acceleration [m/s²] of each vehicle in the first `steps`.

    The `driven` vehicles drive together without them from the take-over on, the others as recorded.
    """
    own = _Replay(policy, drive).unaware(pairs)
    without = own._graphs([{p: kind for p, kind in g.items() if p not in pairs} for g in drive.graphs])
    memory, state, drivers = own.begin(), drive.state[0], list(driven)
    for t in range(steps):
        after, memory = own.next(replace(memory, graph=without[t]), state, [], t)
        state = drive.state[t + 1].clone()
        state[drivers] = after[drivers]
    v = policy.dynamics.speed
    return ((drive.state[steps, :, v] - state[:, v]) / (steps * policy.dt)).numpy()


Reason = tuple[tuple[int, str], ...]
"""Sender and type of each edge that is taken away; the type "vehicle" takes the sender itself away."""


def _reasons(drive: Drive, receiver: int) -> list[Reason]:
    if not drive.graphs:
        return [((sender, "vehicle"),) for sender in range(drive.state.shape[1]) if sender != receiver]
    edges = dict.fromkeys(
        (sender, str(kind)) for graph in drive.graphs for (sender, to), kind in graph.items() if to == receiver
    )
    together = [tuple(edges)] if len({sender for sender, _ in edges}) > 1 else []
    return [*((edge,) for edge in edges), *together]


@dataclass(frozen=True)
class _Replay:
    """A policy that decides again along a drive."""

    policy: Policy
    drive: Drive

    def begin(self) -> PolicyState:
        """The policy's memory at the take-over."""
        history, wanted = self.drive.history, self.policy.history_steps
        missing = history[:, :1].expand(-1, max(wanted - history.shape[1], 0), -1)  # the graph is recorded anyway
        history = torch.cat([missing, history], 1)[None, :, -wanted:]
        return self.policy.begin(Trajectory.complete(_relative(history), self.policy.dt))

    def memories(self) -> list[PolicyState]:
        """The policy's memory before each decision, with the graph in use."""
        memory, found = self.begin(), []
        for state, graph in zip(self.drive.state, self._graphs(self.drive.graphs), strict=True):
            memory = replace(memory, graph=graph)
            found.append(memory)
            memory = self.policy.act(memory, _relative(state[None]))[1]  # who is near changes no memory
        return found

    def _graphs(self, edges: Sequence[Mapping[tuple[int, int], EdgeType]]) -> list[InteractionGraph | None]:
        """One graph object for instants with the same edges, because policies prepare what depends on the graph."""
        if not edges:
            return [None] * len(self.drive.state)
        graphs: list[InteractionGraph | None] = []
        for same, part in groupby(edges):
            graphs += [InteractionGraph.of_edges(same, self._vocabulary, self.drive.state.shape[1])] * len(list(part))
        return graphs

    @property
    def _vocabulary(self) -> tuple[EdgeType, ...]:
        config = getattr(self.policy, "config", None)
        kinds = FOLLOWING if self.policy.dynamics is POINT_MASS_1D else LANE_CHANGING
        return kinds if config is None else config.vocabulary

    def without(self, reason: Reason, receiver: int) -> list[InteractionGraph | None]:
        """The graphs at each instant without the edges of a reason into a vehicle."""
        absent = {(sender, receiver) for sender, _ in reason}
        return self._graphs([{p: kind for p, kind in graph.items() if p not in absent} for graph in self.drive.graphs])

    def unaware(self, pairs: Iterable[tuple[int, int]]) -> "_Replay":
        """The same, where a policy that follows who is next ahead does not for these pairs (sender, receiver)."""
        policy = self.policy
        return replace(self, policy=policy.without(pairs)) if isinstance(policy, FollowsNextAhead) else self

    def next(
        self, memory: PolicyState, state: Float[Tensor, "N D"], moved: Sequence[int], t: int
    ) -> tuple[Float[Tensor, "N D"], PolicyState]:
        """The states after the decision at step t, in which the vehicles of `moved` are too far away to matter."""
        seen = state.clone()
        seen[list(moved), 0] += FAR
        if isinstance(self.policy, FollowsNextAhead) and self.drive.outside:
            action, memory = self.policy.act(memory, _relative(seen[None]), self._next_outside(state, t))
        else:
            action, memory = self.policy.act(memory, _relative(seen[None]))
        dynamics, now = self.policy.dynamics, state[None]
        after = dynamics.step(now, action.double(), self.policy.dt)
        return (after if dynamics.stop is None else dynamics.stop(now, after))[0], memory

    def _next_outside(self, state: Float[Tensor, "N D"], t: int) -> NextAhead:
        """Who of the recorded others is next ahead of each vehicle at step t."""
        assert self.drive.origin is not None, "others are placed along the road"
        (shift, aside), values = self.drive.origin, state.numpy()
        across = values[:, 1] + aside if self.policy.dynamics.name is DUBINS.name else np.full(len(values), aside)
        return self.drive.outside[t].next_ahead(values[:, 0] + shift, across)


def _effect(
    own: _Replay, without: Sequence[InteractionGraph | None], memories: Sequence[PolicyState], reason: Reason, j: int
) -> Effect:
    """The effect of a reason on vehicle j at every instant after the first decision."""
    drive, dt = own.drive, own.policy.dt
    moved = [sender for sender, kind in reason if kind == "vehicle"]
    unaware = own.unaware({(sender, j) for sender, _ in reason})
    a = own.policy.dynamics.index("a")
    steps, back = len(drive.state) - 1, max(1, round(LOOK_BACK / dt))
    again = torch.stack([own.next(memories[t], drive.state[t], [], t)[0][j] for t in range(steps)])
    once = torch.stack(
        [unaware.next(replace(memories[t], graph=without[t]), drive.state[t], moved, t)[0][j] for t in range(steps)]
    )
    longer = torch.stack(
        [_without_for(unaware, without, memories, moved, j, max(t + 1 - back, 0), t + 1) for t in range(steps)]
    )
    recorded = drive.state[1:, j]
    return Effect(
        receiver=j,
        reason=" and ".join(f"{kind} {sender}" for sender, kind in reason),
        time=dt * np.arange(1, steps + 1),
        acceleration=recorded[:, a].numpy(),
        decision=(again - once)[:, a].numpy(),
        second=(recorded - longer)[:, a].numpy(),
        lateral=(_lateral(own, recorded) - _lateral(own, longer)).numpy(),
        agrees=((again - recorded)[:, a].abs() < AGREES).numpy(),
    )


def _without_for(
    own: _Replay,
    without: Sequence[InteractionGraph | None],
    memories: Sequence[PolicyState],
    moved: Sequence[int],
    j: int,
    first: int,
    last: int,
) -> Float[Tensor, " D"]:
    """The state of vehicle j at step `last` if the reason is absent from step `first` on, the others as recorded."""
    memory, state = memories[first], own.drive.state[first]
    for t in range(first, last):
        after, memory = own.next(replace(memory, graph=without[t]), state, moved, t)
        state = own.drive.state[t + 1].clone()
        state[j] = after[j]
    return state[j]


def _lateral(own: _Replay, state: Float[Tensor, "T D"]) -> Float[Tensor, " T"]:
    """v·ω [m/s²]; zero in one dimension."""
    if own.policy.dynamics.name is not DUBINS.name:
        return torch.zeros(len(state), dtype=state.dtype)
    return state[:, own.policy.dynamics.speed] * state[:, own.policy.dynamics.index("yaw_rate")]


def _relative(state: Float[Tensor, "B 3 *T D"]) -> Float[Tensor, "B 3 *T D"]:
    """float32 states with x counted from the latest position of the leader, as the loop gives them to policies."""
    counted = state.clone()
    counted[..., 0] -= state[:, -1:, 0] if state.ndim == 3 else state[:, -1:, -1:, 0]
    return counted.float()
