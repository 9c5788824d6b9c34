"""The cause that broke up a group: the policy, other vehicles, or one that cannot be told.

A group breaks up when it ends as cut_in, lane_left or lost. Whether an outsider would have cut in anyway is told by the
counterpart, the same group in the same traffic left to SUMO.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from cosim.spec.scenario import AFTERMATH
from cosim.world.episode import BrokenUpBy, Ending, Episode, LaneEntry
from cosim.world.groups import SAME_LANE
from cosim.world.snapshot import Snapshot

SAME_TIME = 1.0  # [s]; lane changes of a vehicle in two branches are the same if they are no farther apart in time
NEAR_GROUP = 50.0  # [m] behind the last and ahead of the first member, in which lane changes of outsiders are recorded


def lane_entries(
    takeover: Snapshot, trace: Sequence[Snapshot], members: Sequence[Sequence[str]], ends: Sequence[float]
) -> list[tuple[LaneEntry, ...]]:
    """Outsiders that changed into the lane of each group, near it, until AFTERMATH after its hand-back.

    `trace` are the snapshots after the take-over, `members` the vehicles of each group, `ends` [s] their hand-backs.
    The lane of a group is that of vehicle 1 at the take-over: the lane of all members in car following, the target lane
    of a merge.
    """
    found: list[list[LaneEntry]] = [[] for _ in members]
    if not trace:
        return [tuple(entries) for entries in found]
    lanes = np.array([takeover.d[takeover.row_of[of[1]]] for of in members])
    earlier = [_earlier_d(before, now) for before, now in pairwise((takeover, *trace))]
    now, before = np.concatenate([now.d for now in trace]), np.concatenate(earlier)
    entered = (np.abs(now - lanes[:, None]) < SAME_LANE) & (np.abs(before - lanes[:, None]) >= SAME_LANE)
    first = np.cumsum([0, *(len(now.ids) for now in trace)])
    groups, places = (of.tolist() for of in np.nonzero(entered))
    for g, place in zip(groups, places, strict=True):
        step = int(np.searchsorted(first, place, side="right")) - 1
        snapshot, row, own = trace[step], place - int(first[step]), members[g]
        vehicle, present = snapshot.ids[row], [*snapshot.rows(own).values()]
        if vehicle in own or not present or snapshot.time > ends[g] + AFTERMATH + 1e-6:
            continue
        s = snapshot.s[present]
        if s.min() - NEAR_GROUP <= snapshot.s[row] <= s.max() + NEAR_GROUP:
            found[g].append(LaneEntry(vehicle, snapshot.time))
    return [tuple(entries) for entries in found]


def _earlier_d(before: Snapshot, now: Snapshot) -> Float[np.ndarray, " V"]:
    """Lateral positions [m] one snapshot earlier of the vehicles that are there now; NaN where they were not seen."""
    if before.ids == now.ids:
        return before.d
    d = dict(zip(before.ids, before.d.tolist(), strict=True))
    return np.array([d.get(vehicle, np.nan) for vehicle in now.ids], dtype=float)


def with_cause(episode: Episode, members: Sequence[str], takeover: Snapshot, trace: Sequence[Snapshot]) -> Episode:
    """The episode with its `intruders` and with `broken_up_by`, as far as the episode alone tells it.

    `members` are the ids by role as the end conditions saw them: a successor in the place of the leader, only two where
    vehicle 2 was removed. `takeover` is the snapshot of the take-over, `trace` are those after it. An outsider that
    changed into the gap counts as UNKNOWN until the counterpart is compared.
    """
    keeping = [role for role in (episode.order if episode.in_lane else (1, 2)) if role < len(members)]
    k = next((k for k, now in enumerate(trace) if now.time >= episode.end - 1e-6), len(trace) - 1)
    before, now = (takeover, *trace)[k], trace[k]
    match episode.ending:
        case Ending.LOST:
            roles = {role for role, vehicle in enumerate(members) if vehicle not in now.row_of}
        case Ending.LANE_LEFT:
            jumped = {role for role in keeping if _sideways(members[role], before, now) > SAME_LANE}
            roles = jumped or {role for role in keeping if _sideways(members[role], takeover, now) > SAME_LANE}
        case Ending.CUT_IN:
            keepers = {role: members[role] for role in keeping}
            between = _between(keepers, takeover.d[takeover.row_of[episode.group.ids[1]]], now)
            intruders = _recent(episode, between)
            if intruders:
                return replace(episode, intruders=intruders, broken_up_by=BrokenUpBy.UNKNOWN)
            drifted = {role for role in keeping if _sideways(members[role], takeover, now) >= SAME_LANE}
            roles = drifted | {role for v in between for role in keeping if _passed(members[role], v, before, now)}
        case Ending.CONTACT if not episode.outcome.contact:
            return replace(episode, broken_up_by=BrokenUpBy.OTHERS)  # an undriven member and an outsider
        case _:
            return episode
    if not roles:
        return replace(episode, broken_up_by=BrokenUpBy.UNKNOWN)
    by_policy = roles & set(episode.judged_roles)
    return replace(episode, broken_up_by=BrokenUpBy.POLICY if by_policy else BrokenUpBy.OTHERS)


def compared(episode: Episode, counterpart: Episode) -> Episode:
    """The episode with `broken_up_by` OTHERS instead of UNKNOWN where an intruder does the same in the counterpart."""
    if episode.broken_up_by is BrokenUpBy.UNKNOWN and do_the_same(episode.intruders, counterpart.lane_entries):
        return replace(episode, broken_up_by=BrokenUpBy.OTHERS)
    return episode


def do_the_same(intruders: Sequence[LaneEntry], entries: Sequence[LaneEntry]) -> bool:
    """Whether one of the intruders changes into the lane in the counterpart as well, within SAME_TIME."""
    return any(
        one.vehicle == other.vehicle and abs(one.time - other.time) <= SAME_TIME + 1e-6
        for one in intruders
        for other in entries
    )


def _recent(episode: Episode, vehicles: Sequence[str]) -> tuple[LaneEntry, ...]:
    """The last lane entry of each of the vehicles, if it was at most SAME_TIME before the end."""
    last = {entry.vehicle: entry for entry in episode.lane_entries if entry.time <= episode.end + 1e-6}
    found = [last[vehicle] for vehicle in vehicles if vehicle in last]
    return tuple(entry for entry in found if episode.end - entry.time <= SAME_TIME + 1e-6)


def _between(keepers: Mapping[int, str], lane: float, now: Snapshot) -> list[str]:
    """The outsiders in the lane at d = `lane` [m] between the members that have to keep it."""
    s = [now.s[row] for row in now.rows([*keepers.values()]).values()]
    inside = (np.abs(now.d - lane) < SAME_LANE) & (now.s > min(s)) & (now.s < max(s))
    return [now.ids[row] for row in np.flatnonzero(inside) if now.ids[row] not in keepers.values()]


def _sideways(vehicle: str, before: Snapshot, now: Snapshot) -> float:
    """How far [m] a vehicle moved sideways; 0 where it was not there."""
    if vehicle not in before.row_of or vehicle not in now.row_of:
        return 0.0
    return abs(float(now.d[now.row_of[vehicle]] - before.d[before.row_of[vehicle]]))


def _passed(member: str, other: str, before: Snapshot, now: Snapshot) -> bool:
    """Whether the order of two vehicles along the road changed."""
    if not {member, other} <= set(before.ids) & set(now.ids):
        return False
    ahead = [bool(at.s[at.row_of[other]] > at.s[at.row_of[member]]) for at in (before, now)]
    return ahead[0] != ahead[1]
