"""Episode: the frozen result of driving one group in one closed-loop run, with its ending and events."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from cosim.measures.surrogate_safety import net_gap, time_to_collision
from cosim.spec.scenario import AFTERMATH
from cosim.world.groups import Group
from cosim.world.snapshot import COLUMNS
from cosim.world.surroundings import Surroundings

if TYPE_CHECKING:
    import gri.core.graph  # with all of torch, which reading a finished run does not need

SUCCESS_HEADWAY = 2.0  # [m], the paper's δ_f (Sec. VI-E)


class Ending(StrEnum):
    """Why the drive of a group ended."""

    HORIZON = "horizon"  # the group was driven until the scenario's horizon
    MERGED = "merged"  # vehicle 0 has been inside the target lane for as long as the rule says
    LATE = "late"  # vehicle 0 did not merge within the horizon
    LANE_END = "lane_end"  # vehicle 0 came to the end of its lane before it was inside the target lane
    OFF_ROAD = "off_road"  # a driven vehicle left all lanes; without a command SUMO would remove it in the next step
    CONTACT = "contact"  # the box of vehicle 0 or 1 touched another one
    CUT_IN = "cut_in"  # another vehicle drove between two of the group
    LANE_LEFT = "lane_left"  # a vehicle of the group that had to keep its lane changed it
    LOST = "lost"  # a vehicle of the group left the simulation
    POLICY_FAILED = "policy_failed"  # the policy raised an error, gave no usable answer, or ended its process


INTERRUPTED = frozenset({Ending.CUT_IN, Ending.LANE_LEFT, Ending.LOST})
ARRIVED = frozenset({Ending.HORIZON, Ending.MERGED})
LEFT_ALONE = frozenset({"sumo", "recorded"})  # drivers of groups that no policy drove
OTHER, CUTTER = "other", "cutter"  # names in `Contact.who`: outsiders, and a neighbour that was made to cut in


class BrokenUpBy(StrEnum):
    """The cause that broke up a group before its drive was completed (docs/decisions/003)."""

    NOBODY = ""  # the group stayed together
    POLICY = "policy"  # a driven vehicle left its lane, vanished, or moved behind an outsider that kept its lane
    OTHERS = "others"  # vehicles that the policy does not drive; they do the same in the counterpart
    UNKNOWN = "unknown"  # an outsider cut in, which it does not do in the counterpart, or there is no counterpart


@dataclass(frozen=True)
class Contact:
    """The first moment at which the boxes of two vehicles overlap, at least one of them a member of the group.

    `time` is in s. `vehicles` are their ids, the one farther back first: it drove into the other. `who` names the same
    two by role, such as "0→1", "1→other" or "other→0". `speed_difference` [m/s] is the closing speed: the norm of the
    difference of both velocities. `after_hand_back` says whether the drive of the group was over.
    """

    time: float
    vehicles: tuple[str, str]
    who: str
    speed_difference: float
    after_hand_back: bool


@dataclass(frozen=True)
class LaneEntry:
    """An outsider changed into the lane of the group, near the group, at `time` [s]."""

    vehicle: str
    time: float


@dataclass(frozen=True)
class RoleChange:
    """From `time` [s] on, `vehicle` has the role in the group; "" where nobody has it."""

    time: float
    role: int
    vehicle: str


@dataclass(frozen=True)
class FilterUse:
    """How the safety filter changed the actions of the driven vehicles during a drive.

    `along` and `across` are shares of all steps of driven vehicles: with an acceleration changed by more than 0.05
    m/s², and steered by the filter. `hardest` [m/s²] is the greatest change.
    """

    along: float
    across: float
    hardest: float


@dataclass(frozen=True)
class Outcome:
    """What a drive came to, in three facts.

    `contact`: a vehicle that the policy drives touched another one, or two members touched each other, from the
    take-over until AFTERMATH after the hand-back. `completed`: the group was driven to the horizon, or merged.
    `order_kept`: the paper's success (Sec. VI-E), see `Episode.order_kept`.
    """

    contact: bool
    completed: bool
    order_kept: bool


class EventKind(StrEnum):
    """What can happen to a group."""

    TAKEN = "taken"
    HANDED_BACK = "handed_back"
    CONTACT = "contact"  # by our oriented boxes
    SUMO_COLLISION = "sumo_collision"  # in SUMO's own list
    DISAGREEMENT = "disagreement"  # only one of the two tests found the contact
    MISPLACED = "misplaced"  # place or speed of a commanded vehicle differ from the command
    VANISHED = "vanished"  # a commanded vehicle is no longer in the simulation
    TELEPORT = "teleport"
    JOINED = "joined"  # a vehicle that was not in the group has a role in it now; the detail says which
    HARD_BRAKING = "hard_braking"  # after the hand-back
    RELEASED = "released"  # a recorded vehicle, to car following behind a driven vehicle or another released one
    POLICY_FAILED = "policy_failed"  # the time is that of the decision, the detail says what was wrong


@dataclass(frozen=True)
class Event:
    """Something that happened to vehicles of a group at `time` [s]."""

    time: float
    kind: EventKind
    vehicles: tuple[str, ...]
    detail: str = ""


@dataclass(frozen=True)
class Episode:
    """The trajectories and events of one group, from the start of its history to the end of the watch.

    `state` has the features of COLUMNS for the N roles, `valid` says where a vehicle is present, `driven` where a
    policy commanded it. `order` lists the roles from the rear to the front by the group rule. `graph` is the graph that
    the policy used, one row for each instant of `graph_time` [s] (None where the policy has no graph). `end` [s] is the
    time of the hand-back, `length` and `width` are in m. `judged_roles` are the roles that the policy of the round
    drives; where SUMO drives the group they are the same ones, so that both are judged alike. `contacts` are those of
    all members, `lane_entries` are lane changes of outsiders until AFTERMATH after the hand-back, `intruders` those of
    them that ended the drive as cut_in. `broken_up_by` is final after the comparison with the counterpart
    (`cosim.world.break_ups.compared`). `surroundings` are the vehicles around the group from the
    take-over to AFTERMATH after the hand-back. `filter_use` is missing without a safety filter. `role_changes` are
    those of a group that others joined, in the order of time. Then `state` is that of whoever has a role, while
    `length` and `width` stay those of the take-over. `safety` are the measures of `cosim.world.safety`, where several
    runs share the episode and they have been computed for all.
    """

    driver: str
    group: Group
    time: Float[np.ndarray, " T"]
    state: Float[np.ndarray, "T N C"]
    valid: Bool[np.ndarray, "T N"]
    driven: Bool[np.ndarray, "T N"]
    length: Float[np.ndarray, " N"]
    width: Float[np.ndarray, " N"]
    order: tuple[int, ...]
    graph: "gri.core.graph.InteractionGraph | None"
    graph_time: Float[np.ndarray, " R"]
    ending: Ending
    end: float
    events: tuple[Event, ...]
    judged_roles: tuple[int, ...] = (0, 1)
    contacts: tuple[Contact, ...] = ()
    lane_entries: tuple[LaneEntry, ...] = ()
    intruders: tuple[LaneEntry, ...] = ()
    broken_up_by: BrokenUpBy = BrokenUpBy.NOBODY
    surroundings: Surroundings | None = None
    filter_use: FilterUse | None = None
    role_changes: tuple[RoleChange, ...] = ()
    safety: Mapping[str, float] | None = None

    @property
    def members(self) -> list[tuple[str, ...]]:
        """The ids by role at each instant of `time`."""
        ids, changes, found = [*self.group.ids], [*self.role_changes], []
        for time in self.time.tolist():
            while changes and changes[0].time <= time + 1e-6:
                change = changes.pop(0)
                ids[change.role] = change.vehicle
            found.append(tuple(ids))
        return found

    @property
    def unchanged(self) -> Bool[np.ndarray, " T"]:
        """The instants before another vehicle joined the group."""
        return np.asarray(self.held.all(1))

    @property
    def held(self) -> Bool[np.ndarray, "T N"]:
        """Whether each role is still that of the vehicle that had it at the take-over; one that comes back is new."""
        held = np.ones((len(self.time), len(self.order)), dtype=bool)
        for change in self.role_changes:
            held[self.time > change.time - 1e-6, change.role] = False
        return held

    @property
    def spells(self) -> list[tuple[float, float, tuple[str, ...], tuple[int, ...]]]:
        """The times during which nobody joins, in order.

        Each has its begin [s], the instant at which the next one begins [s], the ids by role, and the roles of vehicles
        that had them from the take-over on.
        """
        ids, kept, found, begin = [*self.group.ids], [*range(len(self.order))], [], self.group.time
        for change in self.role_changes:
            if change.time > begin + 1e-6:
                found.append((begin, change.time, tuple(ids), tuple(kept)))
                begin = change.time
            ids[change.role] = change.vehicle
            kept = [role for role in kept if role != change.role]
        return [*found, (begin, np.inf, tuple(ids), tuple(kept))]

    @property
    def kept_roles(self) -> tuple[int, ...]:
        """The judged roles of the vehicles that had them from the take-over on."""
        changed = {change.role for change in self.role_changes}
        return tuple(role for role in self.judged_roles if role not in changed)

    def feature(self, name: str) -> Float[np.ndarray, "T N"]:
        """One of COLUMNS."""
        return self.state[..., COLUMNS.index(name)]

    @property
    def followers(self) -> tuple[int, ...]:
        """All roles but the leader's."""
        return tuple(range(len(self.order) - 1))

    @property
    def in_lane(self) -> bool:
        """Whether the group follows in one lane, rather than merges."""
        return self.order[0] == 0

    @property
    def during_drive(self) -> Bool[np.ndarray, " T"]:
        """The instants from the take-over to the end of the drive, whether a policy or SUMO drove."""
        return (self.time >= self.group.time - 1e-6) & (self.time <= self.end + 1e-6)

    @property
    def in_path(self) -> Bool[np.ndarray, "T F"]:
        """Whether neighbours of `order` overlap laterally, so that the rear one could drive into the other."""
        behind, ahead = list(self.order[:-1]), list(self.order[1:])
        d = self.feature("d")
        return np.abs(d[:, behind] - d[:, ahead]) < 0.5 * (self.width[behind] + self.width[ahead])

    @property
    def gap(self) -> Float[np.ndarray, "T F"]:
        """Net gaps [m] along the road between neighbours of `order`, in any lanes and whichever of both is ahead."""
        s = self.feature("s")
        behind, ahead = list(self.order[:-1]), list(self.order[1:])
        in_order = net_gap(s[:, behind], s[:, ahead], self.length[ahead])
        return np.maximum(in_order, net_gap(s[:, ahead], s[:, behind], self.length[behind]))

    @property
    def ttc(self) -> Float[np.ndarray, "T F"]:
        """Times to collision [s] over the same gaps; +inf where the vehicles are not in each other's path."""
        s, v = self.feature("s"), self.feature("v")
        behind, ahead = list(self.order[:-1]), list(self.order[1:])
        opening = np.where(s[:, ahead] >= s[:, behind], 1, -1) * (v[:, ahead] - v[:, behind])
        return np.where(self.in_path, time_to_collision(self.gap, -opening, np.zeros_like(opening)), np.inf)

    @property
    def jerk(self) -> Float[np.ndarray, "T N"]:
        """Change of acceleration since the previous instant [m/s³]; 0 at the first one."""
        a = self.feature("a")
        return np.vstack([np.zeros_like(a[:1]), np.diff(a, axis=0) / np.diff(self.time)[:, None]])

    @property
    def order_kept(self) -> bool:
        """Whether the drive was completed without contact and every follower is behind its leader by δ_f at the end.

        This is the paper's success. Completed means driven to the horizon, or merged. Car following has all but the
        leader as followers, a merge has vehicle 0 behind the leader 2 (Sec. VI-E of the paper).
        """
        last = np.flatnonzero(self.during_drive)[-1]
        s, there = self.feature("s")[last], self.valid[last]
        followed = pairwise(self.order) if self.in_lane else ((0, 2),)
        return self.ending in ARRIVED and all(
            s[ahead] - s[behind] >= SUCCESS_HEADWAY
            for behind, ahead in followed
            if there[ahead] or not self.role_changes
        )

    @property
    def counted_contacts(self) -> tuple[Contact, ...]:
        """The contacts between members, and those of judged roles; not those of an undriven member with an outsider."""
        judged, members = {str(role) for role in self.judged_roles}, {str(role) for role in self.order}
        sides = [(contact, set(contact.who.split("→"))) for contact in self.contacts]
        return tuple(contact for contact, both in sides if both & judged or both <= members)

    @property
    def outcome(self) -> Outcome:
        """The three facts about the drive."""
        return Outcome(bool(self.counted_contacts), self.ending in ARRIVED, self.order_kept)

    @property
    def judged_after(self) -> float:
        """How long [s] contacts were judged after the hand-back: AFTERMATH, or less where the watch is shorter."""
        return min(AFTERMATH, float(self.time[-1]) - self.end)
