"""What happens to the groups of a round while they are driven: how each ends, when, and all events."""

from collections.abc import Sequence, Set
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from cosim.loop import end_conditions
from cosim.loop.observation import Frame
from cosim.loop.state_layouts import Pose
from cosim.measures.collision_detection import overlapping_pairs
from cosim.spec.scenario import GroupRule, Merge
from cosim.sumo import Sumo
from cosim.world.episode import COLUMNS, Ending, Event, EventKind
from cosim.world.groups import Group, MergeLanes, next_ahead
from cosim.world.snapshot import Snapshot, StepReport

PLACEMENT_TOLERANCE = 1e-6  # [m], [m/s]
HARD_BRAKING = 4.5  # [m/s^2]
_S, _D, _V = (COLUMNS.index(name) for name in ("s", "d", "v"))


@dataclass(frozen=True)
class Round:
    """Several groups that are taken at the same instant, and how long they are driven and watched (in steps).

    `owned` are the roles that are driven, `lanes` where a merge takes place, `third` whether there is a vehicle 2.
    """

    groups: tuple[Group, ...]
    rule: GroupRule
    owned: tuple[int, ...]
    driven: int
    watched: int
    dt: float
    lanes: MergeLanes | None = None
    third: bool = True
    undriven: str = "sumo"  # whose the vehicles are that no policy drives

    @property
    def vehicles(self) -> list[str]:
        return [vehicle for group in self.groups for vehicle in group.ids]


class Record:
    """The endings and events so far."""

    def __init__(self, task: Round, width: Float[np.ndarray, "G 3"]) -> None:
        self._task, self._width, self._owned = task, width, list(task.owned)
        self._left_alone = np.array([role not in task.owned for role in range(3)])
        self._inside = np.zeros(len(task.groups), dtype=int)  # steps since vehicle 0 is inside the target lane
        self.active = list(range(len(task.groups)))  # the groups that did not end yet
        self.endings: dict[int, Ending] = {}
        self.ends: dict[int, float] = {}
        self.events: list[list[Event]] = [[] for _ in task.groups]

    def driven(self, time: Float[np.ndarray, " T"], g: int) -> Bool[np.ndarray, "T 3"]:
        """At which instants, from the first command to the end, which roles stood where they were commanded to."""
        when = (time > self._task.groups[g].time + 1e-6) & (time <= self.ends[g] + 1e-6)
        return when[:, None] & ~self._left_alone

    def _owned_ids(self, g: int) -> tuple[str, ...]:
        return tuple(self._task.groups[g].ids[role] for role in self._task.owned)

    def take_over(self, world: Sumo, time: float) -> None:
        for g in self.active:
            for vehicle in self._owned_ids(g):
                world.take(vehicle)
            self.events[g].append(Event(time, EventKind.TAKEN, self._owned_ids(g)))

    def hand_back(self, world: Sumo, frame: Frame, ended: Set[int]) -> None:
        for g in sorted(ended):
            ids = self._task.groups[g].ids
            for role in self._task.owned:
                world.remove_shadow(ids[role])
                if frame.valid[g, role]:
                    world.release(ids[role])
            self.events[g].append(Event(frame.time, EventKind.HANDED_BACK, self._owned_ids(g), self.endings[g].value))

    def verify(self, frame: Frame, commanded: Pose) -> None:
        """Note every owned vehicle that is gone, or that is not where and as fast as the dynamics say."""
        owned, seen = self._owned, frame.state
        error = np.maximum(np.abs(seen[..., _S] - commanded.s), np.abs(seen[..., _D] - commanded.d))
        error = np.maximum(error, np.abs(seen[..., _V] - commanded.v))
        right = frame.valid & (error <= PLACEMENT_TOLERANCE)
        if (right | self._left_alone).all():
            return
        for g in self.active:
            for role in owned:
                vehicle = (self._task.groups[g].ids[role],)
                if not frame.valid[g, role]:
                    self.events[g].append(Event(frame.time, EventKind.VANISHED, vehicle))
                elif not right[g, role]:
                    self.events[g].append(Event(frame.time, EventKind.MISPLACED, vehicle, f"by {error[g, role]:.3g}"))

    def judge(self, frame: Frame, before: Frame, snapshot: Snapshot, report: StepReport, last: bool) -> None:
        """End the groups that cannot or need not be driven any further, and all after the `last` driven step."""
        active = self.active
        if not active:
            return
        touching = self._contacts(snapshot, frame, report)
        lost = self._lost(frame, snapshot)
        found = self._endings(frame, before, snapshot)
        for g in active:
            ending = Ending.CONTACT if g in touching else lost.get(g) or found[g]
            if ending is None and last:
                ending = Ending.LATE if isinstance(self._task.rule, Merge) else Ending.HORIZON
            if ending is not None:
                self.endings[g], self.ends[g] = ending, frame.time
        self.active = [g for g in active if g not in self.endings]

    def _lost(self, frame: Frame, snapshot: Snapshot) -> dict[int, Ending]:
        """The groups of which a vehicle is gone, or a driven one where there is no lane."""
        if frame.complete and "" not in snapshot.lane:
            return {}
        there, rows = np.logical_and.reduce(frame.valid, axis=1).tolist(), frame.rows[:, self._owned].tolist()
        off_road = {
            g: Ending.OFF_ROAD for g, owned in enumerate(rows) if there[g] and not all(snapshot.lane[r] for r in owned)
        }
        return off_road | {g: Ending.LOST for g, all_there in enumerate(there) if not all_there}

    def _endings(self, frame: Frame, before: Frame, snapshot: Snapshot) -> Sequence[Ending | None]:
        """What the rule says of each group, of those that did not end yet."""
        task = self._task
        if not isinstance(task.rule, Merge):
            ahead = next_ahead(snapshot, frame.rows[:, :2].ravel()).reshape(-1, 2)
            return end_conditions.car_following(before.state, frame.state, frame.rows, ahead, task.third)
        return [
            self._merging(frame, before, snapshot, g) if g not in self.endings else None
            for g in range(len(task.groups))
        ]

    def _merging(self, frame: Frame, before: Frame, snapshot: Snapshot, g: int) -> Ending | None:
        task = self._task
        assert isinstance(task.rule, Merge)
        assert task.lanes is not None, "a merge takes place between two lanes"
        rows = frame.rows[g] if task.third else frame.rows[g][[0, 1, 1]]  # nobody comes between 1 and 1
        width = float(self._width[g, 0])
        ending = end_conditions.merging(before.state[g], frame.state[g], snapshot, rows, task.lanes, width, task.dt)
        self._inside[g] = self._inside[g] + 1 if ending is Ending.MERGED else 0
        settled = self._inside[g] * task.dt >= task.rule.settle - 1e-6
        return ending if ending is not Ending.MERGED or settled else None

    def _contacts(self, snapshot: Snapshot, frame: Frame, report: StepReport) -> set[int]:
        """Which groups touch something, by our own test; SUMO's opinion and every disagreement become events."""
        active, roles = self.active, 2  # 0 and 1, whoever drives them
        rows = frame.rows[active, :roles]
        rows = rows.ravel() if frame.complete else rows[frame.valid[active, :roles]]
        hits = overlapping_pairs(snapshot.xy, snapshot.heading, snapshot.length, snapshot.width, rows)
        ours = {frozenset((snapshot.ids[i], snapshot.ids[j])) for i, j in hits.tolist()}
        theirs = {frozenset(pair) for pair in report.collisions}
        if not ours and not theirs and not report.teleported:
            return set()
        touching = set()
        for g in active:
            members = set(self._task.groups[g].ids[:roles])
            for kind, pairs in (
                (EventKind.CONTACT, ours),
                (EventKind.SUMO_COLLISION, theirs),
                (EventKind.DISAGREEMENT, ours ^ theirs),
            ):
                mine = sorted(_rear_first(snapshot, pair) for pair in pairs if pair & members)
                self.events[g] += [Event(frame.time, kind, pair) for pair in mine]
            self.events[g] += [Event(frame.time, EventKind.TELEPORT, (v,)) for v in report.teleported if v in members]
            if any(pair & members for pair in ours):
                touching.add(g)
        return touching


def _rear_first(snapshot: Snapshot, pair: frozenset[str]) -> tuple[str, ...]:
    """The two vehicles, the one that is farther back (as far as it was seen) first: it drove into the other."""
    rows = snapshot.rows(sorted(pair))
    return tuple(sorted(pair, key=lambda vehicle: (snapshot.s[rows[vehicle]] if vehicle in rows else np.inf, vehicle)))


def hard_braking(frames: Sequence[Frame], g: int, group: Group, owned: Sequence[int], end: float) -> tuple[Event, ...]:
    """The first hard braking of each handed-back vehicle after the end of the drive."""
    a = COLUMNS.index("a")
    found, later = [], [frame for frame in frames if frame.time > end]
    for role in owned:
        for frame in later:
            if frame.valid[g, role] and frame.state[g, role, a] < -HARD_BRAKING:
                detail = f"{frame.state[g, role, a]:.2f} m/s^2"
                found.append(Event(frame.time, EventKind.HARD_BRAKING, (group.ids[role],), detail))
                break
    return tuple(found)
