"""Judges and records the groups of a round while they are driven: how each ends, when, and all events."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from cosim.loop import end_conditions
from cosim.loop.observation import GroupObservation
from cosim.loop.state_layouts import Pose
from cosim.spec.scenario import GroupRule, Merge
from cosim.world.contacts import touching_pairs
from cosim.world.episode import COLUMNS, Ending, Event, EventKind
from cosim.world.groups import Group, MergeLanes, next_ahead
from cosim.world.hand_back_columns import BRAKING, BRAKING_WINDOW
from cosim.world.snapshot import Snapshot, StepReport

PLACEMENT_TOLERANCE = 1e-6  # [m], [m/s]
_S, _D, _V, _A = (COLUMNS.index(name) for name in ("s", "d", "v", "a"))


@dataclass(frozen=True)
class Round:
    """Several groups that are taken over at the same instant.

    They are driven for `driven_steps` at most and then watched for `watched_steps`. `driven_roles` are the roles that a
    policy drives, `lanes` are the lanes of a merge, `default_driver` ("sumo" or "recorded") moves all other vehicles.
    Without `has_third_vehicle` vehicle 2 is removed at the take-over. With `records_surroundings` the
    vehicles around the groups are read in every step, not only those near to them.
    """

    groups: tuple[Group, ...]
    rule: GroupRule
    driven_roles: tuple[int, ...]
    driven_steps: int
    watched_steps: int
    dt: float
    lanes: MergeLanes | None = None
    has_third_vehicle: bool = True
    default_driver: str = "sumo"
    records_surroundings: bool = False

    @property
    def size(self) -> int:
        """The number of vehicles of a group."""
        return self.rule.size

    @property
    def others_join(self) -> bool:
        """Whether a vehicle that comes between the members joins the group."""
        return self.rule.newcomers == "join" and self.has_third_vehicle

    @cached_property
    def vehicles(self) -> tuple[str, ...]:
        """The vehicles of all groups."""
        return tuple(vehicle for group in self.groups for vehicle in group.ids)

    def driven_ids(self, g: int) -> tuple[str, ...]:
        """The vehicles of one group that a policy drives."""
        return tuple(self.groups[g].ids[role] for role in self.driven_roles)


@runtime_checkable
class Members(Protocol):
    """What is recorded of changing members (`cosim.loop.membership`)."""

    driven: Bool[np.ndarray, "G N"]

    def driven_until(self, g: int, role: int) -> float: ...


class RoundRecorder:
    """The endings and events of a round so far; `width` [m] are the vehicles' widths.

    `members` are those of groups that others may join.
    """

    def __init__(self, this_round: Round, width: Float[np.ndarray, "G N"], members: Members | None = None) -> None:
        self.round, self._width, self._driven_roles = this_round, width, list(this_round.driven_roles)
        self._members = members
        self._undriven = np.array([role not in this_round.driven_roles for role in range(this_round.size)])
        self.steps_inside = np.zeros(len(this_round.groups), np.int64)  # of vehicle 0 in the target lane, at a stretch
        self.active = list(range(len(this_round.groups)))  # the groups that have not ended yet
        self.endings: dict[int, Ending] = {}
        self.ends: dict[int, float] = {}
        self.events: list[list[Event]] = [[] for _ in this_round.groups]
        self.touching: dict[int, list[tuple[str, ...]]] = {}  # pairs in contact when a group ended, the rear one first
        self.contacts: list[np.ndarray] = []  # by step: rows of vehicles in contact, (P, 2)

    def add(self, g: int, event: Event) -> None:
        """Record an event of a group."""
        self.events[g].append(event)

    def driven(self, time: Float[np.ndarray, " T"], g: int, roles: Sequence[int]) -> Bool[np.ndarray, "T N"]:
        """The instants, from the first command to the end, at which these roles stood where they were commanded to."""
        when = (time > self.round.groups[g].time + 1e-6) & (time <= self.ends[g] + 1e-6)
        until = np.array([self._driven_until(g, role) for role in range(self.round.size)])
        kept = time[:, None] < until - 1e-6
        return when[:, None] & kept & np.array([role in roles for role in range(self.round.size)])

    def driven_to_the_end(self, g: int) -> list[int]:
        """The roles that a policy drives, of vehicles that had them from the take-over to the end."""
        return [role for role in self._driven_roles if self._driven_until(g, role) == np.inf]

    def _driven_until(self, g: int, role: int) -> float:
        return np.inf if self._members is None else self._members.driven_until(g, role)

    def verify(self, observations: Sequence[GroupObservation], commanded: Sequence[tuple[Pose, Sequence[int]]]) -> None:
        """Record every driven vehicle that vanished, or whose place or speed is not as the dynamics say.

        `observations` are those after each command, `commanded` are the poses with the groups that were driven.
        """
        if not observations:
            return
        state = np.stack([observation.state for observation in observations])  # Shape: (T, G, N, C)
        valid = np.stack([observation.valid for observation in observations])
        error = np.zeros(valid.shape)
        for feature, name in ((_S, "s"), (_D, "d"), (_V, "v")):
            wanted = np.stack([getattr(pose, name) for pose, _ in commanded])
            np.maximum(error, np.abs(state[..., feature] - wanted), out=error)
        right = valid & (error <= PLACEMENT_TOLERANCE)
        if (right | self._undriven).all():
            return
        found: list[list[Event]] = [[] for _ in self.round.groups]
        for k, (observation, (_, active)) in enumerate(zip(observations, commanded, strict=True)):
            for g in active:
                for role in self._driven_roles:
                    vehicle = (self.round.groups[g].ids[role],)
                    if observation.time > self._driven_until(g, role) - 1e-6:
                        continue
                    if not valid[k, g, role]:
                        found[g].append(Event(observation.time, EventKind.VANISHED, vehicle))
                    elif not right[k, g, role]:
                        detail = f"by {error[k, g, role]:.3g}"
                        found[g].append(Event(observation.time, EventKind.MISPLACED, vehicle, detail))
        # Before other events of the same time: events are put in the order of time.
        self.events = [[*new, *events] for new, events in zip(found, self.events, strict=True)]

    def nothing_happened(self, steps: int) -> None:
        """Take note of steps without contacts in which no group ended; `steps_inside` is up to date."""
        self.contacts += [np.empty((0, 2), dtype=int)] * steps

    def judge(
        self,
        observation: GroupObservation,
        before: GroupObservation,
        snapshot: Snapshot,
        report: StepReport,
        last: bool,
    ) -> None:
        """End the groups that cannot or need not be driven any further, and all groups after the `last` driven step."""
        active = self.active
        if not active:
            return
        in_contact = self._contacts(snapshot, observation, report, self.look_for_contacts(snapshot))
        lost = self._lost(observation, snapshot)
        by_rule = self._endings_by_rule(observation, before, snapshot)
        for g in active:
            ending = Ending.CONTACT if g in in_contact else lost.get(g) or by_rule[g]
            if ending is None and last:
                ending = Ending.LATE if isinstance(self.round.rule, Merge) else Ending.HORIZON
            if ending is not None:
                self.endings[g], self.ends[g] = ending, observation.time
        self.active = [g for g in active if g not in self.endings]

    def end_failed(self, failures: Mapping[int, str], decision: float, now: float) -> None:
        """End the active groups for which the policy has given no usable answer at the time `decision` [s]."""
        for g in [g for g in self.active if g in failures]:
            self.endings[g], self.ends[g] = Ending.POLICY_FAILED, now
            self.add(g, Event(decision, EventKind.POLICY_FAILED, self.round.groups[g].ids, failures[g]))
        self.active = [g for g in self.active if g not in self.endings]

    def _lost(self, observation: GroupObservation, snapshot: Snapshot) -> dict[int, Ending]:
        """The groups that lack a vehicle, or have a driven one that is on no lane."""
        if observation.complete and "" not in snapshot.lane:
            return {}
        needed = observation.valid
        rows = [of[self._driven_roles] for of in observation.rows]
        if self._members is not None:  # only vehicle 0 has to be there
            needed = needed[:, :1]
            rows = [of[own] for of, own in zip(observation.rows, self._members.driven, strict=True)]
        present = np.logical_and.reduce(needed, axis=1).tolist()
        off_road = {
            g: Ending.OFF_ROAD
            for g, driven in enumerate(rows)
            if present[g] and not all(snapshot.lane[row] for row in driven.tolist())
        }
        return off_road | {g: Ending.LOST for g, all_present in enumerate(present) if not all_present}

    def look_for_contacts(self, snapshot: Snapshot) -> Int[np.ndarray, "P 2"]:
        """Rows of the vehicles in contact, the first one a member of a group; kept in `contacts`, once per step."""
        row_of = snapshot.row_of
        rows = np.array([row_of[vehicle] for vehicle in self.round.vehicles if vehicle in row_of], dtype=int)
        self.contacts.append(touching_pairs(snapshot, rows))
        return self.contacts[-1]

    def _endings_by_rule(
        self, observation: GroupObservation, before: GroupObservation, snapshot: Snapshot
    ) -> Sequence[Ending | None]:
        """What the group rule says of each group that has not ended yet."""
        this_round = self.round
        if not isinstance(this_round.rule, Merge):
            if self._members is not None:  # whoever comes between joins
                return [None] * len(this_round.groups)
            if end_conditions.all_follow(before, observation, snapshot, self.active, this_round.has_third_vehicle):
                return [None] * len(this_round.groups)
            followers = observation.rows[:, :-1]
            ahead = next_ahead(snapshot, followers.ravel()).reshape(followers.shape)
            return end_conditions.car_following(
                before.state, observation.state, observation.rows, ahead, this_round.has_third_vehicle
            )
        return [
            self._merging(observation, before, snapshot, g) if g not in self.endings else None
            for g in range(len(this_round.groups))
        ]

    def _merging(
        self, observation: GroupObservation, before: GroupObservation, snapshot: Snapshot, g: int
    ) -> Ending | None:
        this_round = self.round
        assert isinstance(this_round.rule, Merge)
        assert this_round.lanes is not None, "a merge takes place between two lanes"
        rows = observation.rows[g]
        if not this_round.has_third_vehicle:
            rows = rows[[0, 1, 1]]  # no vehicle can be between vehicle 1 and itself
        width, now = float(self._width[g, 0]), observation.state[g]
        if self._members is None:
            ending = end_conditions.merging(
                before.state[g], now, snapshot, rows, this_round.lanes, width, this_round.dt
            )
        else:
            ending = end_conditions.merging_alone(now[0], this_round.lanes, width, this_round.dt)
        self.steps_inside[g] = self.steps_inside[g] + 1 if ending is Ending.MERGED else 0
        settled = self.steps_inside[g] * this_round.dt >= this_round.rule.settle - 1e-6
        return ending if ending is not Ending.MERGED or settled else None

    def _contacts(
        self, snapshot: Snapshot, observation: GroupObservation, report: StepReport, hits: Int[np.ndarray, "P 2"]
    ) -> set[int]:
        """The groups in contact by our own test; SUMO's collisions and all disagreements are recorded as events.

        The contacts themselves are recorded for the drive and its aftermath at once, by `cosim.world.contacts`.
        """
        if not len(hits) and not report.collisions and not report.teleported:
            return set()
        active = self.active
        followers = slice(self.round.size - 1)  # they are tested for contacts, driven or not
        rows = observation.rows[active, followers]
        rows = rows.ravel() if observation.complete else rows[observation.valid[active, followers]]
        hits = hits[np.isin(hits[:, 0], rows)]
        ours = {frozenset((snapshot.ids[i], snapshot.ids[j])) for i, j in hits.tolist()}
        theirs = {frozenset(pair) for pair in report.collisions}
        if not ours and not theirs and not report.teleported:
            return set()
        in_contact = set()
        for g in active:
            members = set(self.round.groups[g].ids[followers])
            for kind, pairs in ((EventKind.SUMO_COLLISION, theirs), (EventKind.DISAGREEMENT, ours ^ theirs)):
                own = sorted(_rear_first(snapshot, pair) for pair in pairs if pair & members)
                self.events[g] += [Event(observation.time, kind, pair) for pair in own]
            teleported = [vehicle for vehicle in report.teleported if vehicle in members]
            self.events[g] += [Event(observation.time, EventKind.TELEPORT, (vehicle,)) for vehicle in teleported]
            if touching := sorted(_rear_first(snapshot, pair) for pair in ours if pair & members):
                self.touching[g] = touching
                in_contact.add(g)
        return in_contact


def _rear_first(snapshot: Snapshot, pair: frozenset[str]) -> tuple[str, ...]:
    """The two vehicles, the one farther back first: it drove into the other. Absent vehicles count as far ahead."""
    rows = snapshot.rows(sorted(pair))
    return tuple(sorted(pair, key=lambda vehicle: (snapshot.s[rows[vehicle]] if vehicle in rows else np.inf, vehicle)))


def hard_braking(
    observations: Sequence[GroupObservation], g: int, group: Group, driven_roles: Sequence[int], end: float
) -> tuple[Event, ...]:
    """The first braking of 3 m/s² or more of each handed-back vehicle, within 5 s after the end of the drive."""
    until = end + BRAKING_WINDOW + 1e-6
    found, later = [], [observation for observation in observations if end + 1e-6 < observation.time <= until]
    for role in driven_roles:
        for observation in later:
            if observation.valid[g, role] and observation.state[g, role, _A] <= -BRAKING[1]:
                detail = f"{observation.state[g, role, _A]:.2f} m/s^2"
                found.append(Event(observation.time, EventKind.HARD_BRAKING, (group.ids[role],), detail))
                break
    return tuple(found)
