"""Driving the groups of one round: all of them in one model call per step.

The same function records a round that is left to SUMO (`policy=None`), so that both sides of a comparison are measured
alike. See docs/coupling.md for what a command does and when.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from cosim.episode import COLUMNS, Ending, Episode, Event, EventKind
from cosim.frames import RoadFrame
from cosim.groups import SAME_LANE, Group, next_ahead
from cosim.pilot import OWNED, Frame, Pilot
from cosim.safety import overlaps
from cosim.sumo import Snapshot, StepReport, Sumo
from gri.policy import Policy

PLACEMENT_TOLERANCE = 1e-6  # [m], [m/s]
HARD_BRAKING = 4.5  # [m/s^2]


@dataclass(frozen=True)
class Round:
    """Several groups that are taken at the same instant, and how long they are driven and watched (in steps)."""

    groups: tuple[Group, ...]
    driven: int
    watched: int
    dt: float

    @property
    def vehicles(self) -> list[str]:
        return [vehicle for group in self.groups for vehicle in group.ids]


def drive(
    world: Sumo, road: RoadFrame, history: Sequence[Snapshot], task: Round, policy: Policy | None, driver: str
) -> list[Episode]:
    """Drive (or only watch) the groups from the last snapshot of the history on; one Episode per group."""
    frames = [Frame.of(snapshot, task.groups) for snapshot in history]
    assert frames[-1].valid.all(), "a group was selected with a vehicle that is not there"
    length = history[-1].length[frames[-1].rows]
    pilot = None if policy is None else Pilot(policy, frames, length, task.dt)
    record = _Record(task)
    if pilot is not None:
        record.take_over(world, frames[-1].time)
    for k in range(task.driven + task.watched):
        active = record.active
        if pilot is not None and active:
            pilot.command(world, road, task.groups, active)
        report = world.step()
        snapshot = world.snapshot(road, around=task.vehicles)
        frame = Frame.of(snapshot, task.groups)
        if pilot is not None:
            record.verify(frame, pilot)
            frame = pilot.stamp(frame, active)
        record.judge(frame, frames[-1], snapshot, report, last=k + 1 == task.driven)
        if pilot is not None:
            record.hand_back(world, frame, ended=set(active) - set(record.active))
            pilot.observe(frame, record.active)
        frames.append(frame.carried_on(frames[-1]))
    return [
        Episode(
            driver=driver,
            group=group,
            time=np.array([frame.time for frame in frames]),
            state=np.stack([frame.state[g] for frame in frames]),
            valid=np.stack([frame.valid[g] for frame in frames]),
            driven=record.driven(frames, g) & (pilot is not None),
            length=length[g],
            graph=None if pilot is None or pilot.graph is None else pilot.graph[g : g + 1],
            ending=record.endings[g],
            end=record.ends[g],
            events=tuple(record.events[g]) + _hard_braking(frames, g, group, record.ends[g]),
        )
        for g, group in enumerate(task.groups)
    ]


class _Record:
    """What happened to each group of a round so far: how it ended, when, and all events."""

    def __init__(self, task: Round) -> None:
        self._groups = task.groups
        self.endings: dict[int, Ending] = {}
        self.ends: dict[int, float] = {}
        self.events: list[list[Event]] = [[] for _ in task.groups]

    @property
    def active(self) -> list[int]:
        """The groups that did not end yet."""
        return [g for g in range(len(self._groups)) if g not in self.endings]

    def driven(self, frames: Sequence[Frame], g: int) -> Bool[np.ndarray, " T"]:
        """The instants from the first command to the end."""
        time = np.array([frame.time for frame in frames])
        return (time > self._groups[g].time + 1e-6) & (time <= self.ends[g] + 1e-6)

    def take_over(self, world: Sumo, time: float) -> None:
        for g, group in enumerate(self._groups):
            for role in OWNED:
                world.take(group.ids[role])
            self.events[g].append(Event(time, EventKind.TAKEN, group.ids[: len(OWNED)]))

    def hand_back(self, world: Sumo, frame: Frame, ended: set[int]) -> None:
        for g in ended:
            ids = self._groups[g].ids
            for role in OWNED:
                if frame.valid[g, role]:
                    world.release(ids[role])
            self.events[g].append(Event(frame.time, EventKind.HANDED_BACK, ids[: len(OWNED)], self.endings[g].value))

    def verify(self, frame: Frame, pilot: Pilot) -> None:
        """Note every owned vehicle that is gone, or that is not where and as fast as the dynamics say."""
        seen = frame.state[:, OWNED][..., [COLUMNS.index("s"), COLUMNS.index("v")]]
        error = np.abs(seen - pilot.expected[..., :2]).max(axis=-1)
        for g in self.active:
            for role in OWNED:
                vehicle = (self._groups[g].ids[role],)
                if not frame.valid[g, role]:
                    self.events[g].append(Event(frame.time, EventKind.VANISHED, vehicle))
                elif error[g, role] > PLACEMENT_TOLERANCE:
                    self.events[g].append(Event(frame.time, EventKind.MISPLACED, vehicle, f"by {error[g, role]:.3g}"))

    def judge(self, frame: Frame, before: Frame, snapshot: Snapshot, report: StepReport, last: bool) -> None:
        """End the groups that cannot be driven any further, and all of them after the `last` driven step."""
        active = self.active
        touching = self._contacts(snapshot, frame, report)
        together = _together(snapshot, frame)
        for g in active:
            ending = _ending(frame, before, g, g in touching, bool(together[g])) or (Ending.HORIZON if last else None)
            if ending is not None:
                self.endings[g], self.ends[g] = ending, frame.time

    def _contacts(self, snapshot: Snapshot, frame: Frame, report: StepReport) -> set[int]:
        """Which groups touch something, by our own test; SUMO's opinion and every disagreement become events."""
        rows = frame.rows[self.active][:, OWNED][frame.valid[self.active][:, OWNED]]
        hits = overlaps(snapshot.xy, snapshot.heading, snapshot.length, snapshot.width, rows)
        ours = {frozenset((snapshot.ids[i], snapshot.ids[j])) for i, j in hits}
        theirs = {frozenset(pair) for pair in report.collisions}
        if not ours and not theirs and not report.teleported:
            return set()
        touching = set()
        for g in self.active:
            members = set(self._groups[g].ids[: len(OWNED)])
            for kind, pairs in (
                (EventKind.CONTACT, ours),
                (EventKind.SUMO_COLLISION, theirs),
                (EventKind.DISAGREEMENT, ours ^ theirs),
            ):
                mine = sorted(tuple(sorted(pair)) for pair in pairs if pair & members)
                self.events[g] += [Event(frame.time, kind, pair) for pair in mine]
            self.events[g] += [Event(frame.time, EventKind.TELEPORT, (v,)) for v in report.teleported if v in members]
            if any(pair & members for pair in ours):
                touching.add(g)
        return touching


def _together(snapshot: Snapshot, frame: Frame) -> Bool[np.ndarray, " G"]:
    """Whether 1 is still the next vehicle ahead of 0, and 2 that of 1."""
    return (next_ahead(snapshot, frame.rows[:, :2].ravel()).reshape(-1, 2) == frame.rows[:, 1:]).all(axis=1)


def _ending(frame: Frame, before: Frame, g: int, touching: bool, together: bool) -> Ending | None:
    """Why a group cannot be driven any further, if it cannot."""
    if touching:
        return Ending.CONTACT
    if not frame.valid[g].all():
        return Ending.LOST
    d = COLUMNS.index("d")
    if (np.abs(frame.state[g, :, d] - before.state[g, :, d]) > SAME_LANE).any():
        return Ending.LANE_LEFT
    return None if together else Ending.CUT_IN


def _hard_braking(frames: Sequence[Frame], g: int, group: Group, end: float) -> tuple[Event, ...]:
    """The first hard braking of each handed-back vehicle after the end of the drive."""
    a = COLUMNS.index("a")
    found = []
    for role in OWNED:
        for frame in frames:
            if frame.time > end and frame.valid[g, role] and frame.state[g, role, a] < -HARD_BRAKING:
                detail = f"{frame.state[g, role, a]:.2f} m/s^2"
                found.append(Event(frame.time, EventKind.HARD_BRAKING, (group.ids[role],), detail))
                break
    return tuple(found)
