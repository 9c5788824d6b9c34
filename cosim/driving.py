"""Driving the groups of one round: all of them in one model call per step.

The same function records a round that is left to SUMO (`policy=None`), so that both sides of a comparison are measured
alike. See docs/coupling.md for what a command does and when.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float

from cosim.episode import COLUMNS, Ending, Episode, Event, EventKind
from cosim.frames import RoadFrame, model_offsets
from cosim.groups import SAME_LANE, Group, lane_leaders
from cosim.safety import overlaps
from cosim.sumo import Snapshot, StepReport, Sumo
from gri.dynamics import DynamicsName, stop_at_standstill
from gri.graph import InteractionGraph
from gri.policy import Policy
from gri.types import Trajectory

OWNED = (0, 1)  # roles that a policy drives; 2 is the given leader
PLACEMENT_TOLERANCE = 1e-6  # [m], [m/s]
HARD_BRAKING = 4.5  # [m/s^2]


@dataclass(frozen=True)
class Round:
    """Several groups that are taken at the same instant, and how long they are driven and watched (in steps)."""

    groups: tuple[Group, ...]
    driven: int
    watched: int
    dt: float


@dataclass(frozen=True)
class _Frame:
    """The groups at one instant: features of COLUMNS, which vehicles are there, and their rows in the snapshot."""

    time: float
    state: Float[np.ndarray, "G 3 C"]
    valid: Bool[np.ndarray, "G 3"]
    rows: np.ndarray  # [G, 3], -1 where absent


def drive(
    world: Sumo, road: RoadFrame, history: Sequence[Snapshot], task: Round, policy: Policy | None, driver: str
) -> list[Episode]:
    """Drive (or only watch) the groups from the last snapshot of the history on; one Episode per group."""
    frames = [_frame(snapshot, task.groups) for snapshot in history]
    assert frames[-1].valid.all(), "a group was selected with a vehicle that is not there"
    length = history[-1].length[frames[-1].rows]
    pilot = None if policy is None else _Pilot(policy, frames, length, task.dt)
    endings: list[Ending | None] = [None] * len(task.groups)
    ends = [0.0] * len(task.groups)
    events: list[list[Event]] = [[] for _ in task.groups]
    owned = np.zeros((len(frames), len(task.groups)), dtype=bool)
    if pilot is not None:
        _take_over(world, task.groups, frames[-1].time, events)
    for k in range(task.driven + task.watched):
        active = [g for g, ending in enumerate(endings) if ending is None]
        if pilot is not None and active:
            pilot.command(world, road, task.groups, active)
        report = world.step()
        snapshot = world.snapshot(road)
        frame = _frame(snapshot, task.groups)
        if pilot is not None:
            _verify(frame, pilot, task.groups, active, events)
            frame = pilot.stamp(frame, active)
        touching = _contacts(snapshot, frame, report, task.groups, active, events)
        for g in active:
            ending = _ending(frame, frames[-1], g, task.groups[g], snapshot, touching[g])
            if ending is None and k + 1 == task.driven:
                ending = Ending.HORIZON
            if ending is not None:
                endings[g], ends[g] = ending, frame.time
                if pilot is not None:
                    _hand_back(world, task.groups[g], frame, g, ending, events[g])
        if pilot is not None:
            pilot.observe(frame, [g for g in active if endings[g] is None])
        owned = np.vstack([owned, [[pilot is not None and g in active for g in range(len(task.groups))]]])
        frames.append(_carry_on(frame, frames[-1]))
    return [
        Episode(
            driver=driver,
            group=group,
            time=np.array([frame.time for frame in frames]),
            state=np.stack([frame.state[g] for frame in frames]),
            valid=np.stack([frame.valid[g] for frame in frames]),
            driven=owned[:, g],
            length=length[g],
            graph=None if pilot is None or pilot.graph is None else pilot.graph[g : g + 1],
            ending=endings[g] or Ending.HORIZON,
            end=ends[g],
            events=tuple(events[g]) + _hard_braking(frames, g, group, ends[g]),
        )
        for g, group in enumerate(task.groups)
    ]


class _Pilot:
    """A policy at the wheel: the model-frame state of all groups and the policy's memory."""

    def __init__(self, policy: Policy, frames: Sequence[_Frame], length: Float[np.ndarray, "G 3"], dt: float) -> None:
        assert policy.dynamics.name is DynamicsName.POINT_MASS_1D, f"cannot drive {policy.dynamics.name} here"
        self._policy, self._dt = policy, dt
        self._offset = torch.from_numpy(model_offsets(length))
        self._lateral = frames[-1].state[:, :, COLUMNS.index("d")]
        states = torch.stack([self._model_state(frame) for frame in frames[-policy.history_steps :]], dim=2)
        self._state = states[:, :, -1]
        self._commanded = self._state
        with torch.inference_mode():
            self._memory = policy.begin(Trajectory.complete(_relative(states), dt))

    @property
    def graph(self) -> InteractionGraph | None:
        return self._memory.graph

    def _model_state(self, frame: _Frame) -> torch.Tensor:
        """[G, 3, (x, v, a)] in the model's frame, float64."""
        state = torch.from_numpy(frame.state[..., [COLUMNS.index(name) for name in ("s", "v", "a")]]).clone()
        state[..., 0] += self._offset
        return state

    def command(self, world: Sumo, road: RoadFrame, groups: Sequence[Group], active: Sequence[int]) -> None:
        """Ask the policy, move the dynamics one step on, and tell SUMO where the vehicles will be."""
        with torch.inference_mode():
            action, self._memory = self._policy.act(self._memory, _relative(self._state))
            following = self._policy.dynamics.step(self._state, action.double(), self._dt)
            self._commanded = stop_at_standstill(self._state, following)
        s = (self._commanded[..., 0] - self._offset).numpy()
        v = self._commanded[..., 1].numpy()
        for g in active:
            xy, heading = road.to_world(s[g], self._lateral[g])
            for role in OWNED:
                x, y = xy[role].tolist()
                world.command(groups[g].ids[role], x, y, float(heading[role]), float(v[g, role]))

    def observe(self, frame: _Frame, active: Sequence[int]) -> None:
        """Read the world; the vehicles that are driven are where the dynamics put them."""
        state = self._model_state(frame)
        if active:
            state[np.ix_(active, OWNED)] = self._commanded[np.ix_(active, OWNED)]
        self._state = state

    def stamp(self, frame: _Frame, active: Sequence[int]) -> _Frame:
        """The frame with the dynamics' acceleration of owned vehicles; SUMO reports the past step's mean instead."""
        state = frame.state.copy()
        if active:
            state[(*np.ix_(active, OWNED), COLUMNS.index("a"))] = self._commanded[np.ix_(active, OWNED)][..., 2]
        return replace(frame, state=state)

    def expected(self, g: int, role: int) -> tuple[float, float]:
        """(s, v) of an owned vehicle after the last command."""
        x, v, _ = self._commanded[g, role].tolist()
        return x - float(self._offset[g, role]), v


def _relative(state: Float[torch.Tensor, "G 3 *T 3"]) -> Float[torch.Tensor, "G 3 *T 3"]:
    """float32 states with x counted from the leader's latest position, where float32 is finest."""
    latest = state[:, 2:3, ..., 0] if state.dim() == 3 else state[:, 2:3, -1:, 0]
    return torch.cat([state[..., :1] - latest[..., None], state[..., 1:]], dim=-1).float()


def _frame(snapshot: Snapshot, groups: Sequence[Group]) -> _Frame:
    where = {vehicle: row for row, vehicle in enumerate(snapshot.ids)}
    rows = np.array([[where.get(vehicle, -1) for vehicle in group.ids] for group in groups])
    features = {"x": snapshot.xy[:, 0], "y": snapshot.xy[:, 1]}
    columns = [features[name] if name in features else getattr(snapshot, name) for name in COLUMNS]
    state = np.stack(columns, axis=-1)[rows]
    valid = rows >= 0
    return _Frame(snapshot.time, np.where(valid[..., None], state, 0.0), valid, rows)


def _carry_on(frame: _Frame, previous: _Frame) -> _Frame:
    """The frame with the last known state of vehicles that are gone; `valid` keeps saying that they are."""
    return replace(frame, state=np.where(frame.valid[..., None], frame.state, previous.state))


def _take_over(world: Sumo, groups: Sequence[Group], time: float, events: list[list[Event]]) -> None:
    for g, group in enumerate(groups):
        for role in OWNED:
            world.take(group.ids[role])
        events[g].append(Event(time, EventKind.TAKEN, tuple(group.ids[role] for role in OWNED)))


def _hand_back(world: Sumo, group: Group, frame: _Frame, g: int, ending: Ending, events: list[Event]) -> None:
    for role in OWNED:
        if frame.valid[g, role]:
            world.release(group.ids[role])
    events.append(Event(frame.time, EventKind.HANDED_BACK, tuple(group.ids[r] for r in OWNED), ending.value))


def _verify(
    frame: _Frame, pilot: _Pilot, groups: Sequence[Group], active: Sequence[int], events: list[list[Event]]
) -> None:
    """Record every owned vehicle that is gone, or that is not where and as fast as the dynamics say."""
    for g in active:
        for role in OWNED:
            vehicle = groups[g].ids[role]
            if not frame.valid[g, role]:
                events[g].append(Event(frame.time, EventKind.VANISHED, (vehicle,)))
                continue
            s, v = pilot.expected(g, role)
            seen = frame.state[g, role]
            error = max(abs(seen[COLUMNS.index("s")] - s), abs(seen[COLUMNS.index("v")] - v))
            if error > PLACEMENT_TOLERANCE:
                events[g].append(Event(frame.time, EventKind.MISPLACED, (vehicle,), f"by {error:.3g}"))


def _contacts(
    snapshot: Snapshot,
    frame: _Frame,
    report: StepReport,
    groups: Sequence[Group],
    active: Sequence[int],
    events: list[list[Event]],
) -> list[bool]:
    """Which groups touch something, by our own test; SUMO's opinion and every disagreement become events."""
    touching = [False] * len(groups)
    rows = np.array([frame.rows[g, role] for g in active for role in OWNED if frame.valid[g, role]], dtype=int)
    hits = overlaps(snapshot.xy, snapshot.heading, snapshot.length, snapshot.width, rows)
    ours = {frozenset((snapshot.ids[rows[i]], snapshot.ids[j])) for i, j in np.argwhere(hits)}
    theirs = {frozenset(pair) for pair in report.collisions}
    for g in active:
        members = {groups[g].ids[role] for role in OWNED}
        for kind, pairs in (
            (EventKind.CONTACT, ours),
            (EventKind.SUMO_COLLISION, theirs),
            (EventKind.DISAGREEMENT, ours ^ theirs),
        ):
            events[g] += [Event(frame.time, kind, tuple(sorted(p))) for p in sorted(pairs, key=sorted) if p & members]
        events[g] += [Event(frame.time, EventKind.TELEPORT, (v,)) for v in report.teleported if v in members]
        touching[g] = any(pair & members for pair in ours)
    return touching


def _ending(frame: _Frame, before: _Frame, g: int, group: Group, snapshot: Snapshot, touching: bool) -> Ending | None:
    """Why a group cannot be driven any further, if it cannot."""
    if touching:
        return Ending.CONTACT
    if not frame.valid[g].all():
        return Ending.LOST
    d = COLUMNS.index("d")
    if (np.abs(frame.state[g, :, d] - before.state[g, :, d]) > SAME_LANE).any():
        return Ending.LANE_LEFT
    leaders = lane_leaders(snapshot)
    if leaders.get(group.ids[0]) != group.ids[1] or leaders.get(group.ids[1]) != group.ids[2]:
        return Ending.CUT_IN
    return None


def _hard_braking(frames: Sequence[_Frame], g: int, group: Group, end: float) -> tuple[Event, ...]:
    """The first hard braking of a handed-back vehicle after the end of the drive."""
    a = COLUMNS.index("a")
    found = []
    for role in OWNED:
        for frame in frames:
            if frame.time > end and frame.valid[g, role] and frame.state[g, role, a] < -HARD_BRAKING:
                detail = f"{frame.state[g, role, a]:.2f} m/s^2"
                found.append(Event(frame.time, EventKind.HARD_BRAKING, (group.ids[role],), detail))
                break
    return tuple(found)
