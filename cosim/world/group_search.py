"""Finding groups of three interacting vehicles in traffic, and why there are not more; pure functions of snapshots."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from cosim.measures.surrogate_safety import net_gap
from cosim.spec.scenario import CarFollowing, Merge
from cosim.world.groups import SAME_LANE, Group, MergeLanes, next_ahead
from cosim.world.snapshot import Snapshot

OUTSIDE = "outside the study area"
Ids = tuple[str, str, str]
Candidates = Iterator[tuple[Ids | None, str]]
"""The vehicles of each candidate with "", or with the first rule that it fails; None where it lacks a vehicle."""


@dataclass(frozen=True)
class GroupSearch:
    """The groups found, the number of candidates `seen`, and how many of them failed which rule (the first they fail).

    Searches add up: a candidate that is seen at several times counts as often.
    """

    groups: tuple[Group, ...] = ()
    seen: int = 0
    failed: Counter[str] = field(default_factory=Counter)

    def __add__(self, later: "GroupSearch") -> "GroupSearch":
        failed = self.failed + later.failed
        return GroupSearch((*self.groups, *later.groups), self.seen + later.seen, failed)


def search_groups(
    history: Sequence[Snapshot],
    rule: CarFollowing | Merge,
    *,
    zone: tuple[float, float],
    barred: Mapping[str, str],
    limit: int,
    lanes: MergeLanes | None = None,
) -> GroupSearch:
    """Up to `limit` groups that fit the rule, the one farthest ahead first; no vehicle is in two groups.

    All vehicles of a group are within `zone` (the range of s [m]) at the end of the history. None is `barred`, which
    says why a vehicle cannot be in a group. `lanes` are those of a merge rule.
    """
    now = history[-1]
    outside = {v: OUTSIDE for v, s in zip(now.ids, now.s, strict=True) if not zone[0] <= s <= zone[1]}
    barred = {**barred, **outside}
    if isinstance(rule, CarFollowing):
        candidates = _chains(history, rule, barred)
    else:
        assert lanes is not None, "a merge takes place between two lanes"
        candidates = _merges(history, rule, barred, lanes)
    seen, fitting, failed = 0, [], Counter[str]()
    for ids, failure in candidates:
        seen += 1
        if failure or ids is None:
            failed[failure] += 1
        else:
            fitting.append(ids)
    groups: list[Group] = []
    taken: set[str] = set()
    for ids in sorted(fitting, key=lambda ids: (-now.s[now.row_of[ids[0]]], ids)):
        if taken & set(ids):
            failed["shares a vehicle with another group"] += 1
        elif len(groups) < limit:
            groups.append(Group(ids, now.time))
            taken |= set(ids)
    return GroupSearch(tuple(groups), seen, failed)


def why_not_more(rule: str, seen: int, failed: Mapping[str, int]) -> str:
    """How many candidates a search for groups of a rule saw, and how many failed which limit."""
    noun = "chains of three vehicles in the study area" if rule == "car_following" else "vehicles on the ending lane"
    reasons = [f"{count} {reason}" for reason, count in sorted(failed.items(), key=lambda item: (-item[1], item[0]))]
    return f"{seen} {noun} seen, once a second" + (f": {'; '.join(reasons)}" if reasons else "")


def _chains(history: Sequence[Snapshot], rule: CarFollowing, barred: Mapping[str, str]) -> Candidates:
    """Triples in one lane of the study area, each vehicle the next one's leader, now and during the whole history."""
    leaders = [_leaders(snapshot) for snapshot in history]
    now = leaders[-1]
    for rear, middle in now.items():
        if (front := now.get(middle)) is None:
            continue
        ids = rear, middle, front
        if any(barred.get(vehicle) == OUTSIDE for vehicle in ids):
            continue
        reason = next((barred[vehicle] for vehicle in ids if vehicle in barred), "")
        if not reason and any(at.get(rear) != middle or at.get(middle) != front for at in leaders):
            reason = "in another order or lane during the history"
        yield ids, reason or _too_far_or_slow(history[-1], ids, rule) or _unsteady(history, ids, rule)


def _leaders(snapshot: Snapshot) -> dict[str, str]:
    """The next vehicle ahead in the same lane, for every vehicle that has one."""
    ahead = next_ahead(snapshot, np.arange(len(snapshot.ids)))
    return {snapshot.ids[row]: snapshot.ids[k] for row, k in enumerate(ahead) if k >= 0}


def _gap(now: Snapshot, behind: int, ahead: int) -> float:
    return float(net_gap(now.s[[behind]], now.s[[ahead]], now.length[[ahead]])[0])


def _gap_failure(gap: float, rule: CarFollowing | Merge) -> str:
    if gap < rule.min_gap:
        return f"gap < {rule.min_gap:g} m"
    return f"gap > {rule.max_gap:g} m" if gap > rule.max_gap else ""


def _too_far_or_slow(now: Snapshot, ids: Ids, rule: CarFollowing) -> str:
    """The limit of gap, time gap or speed that a follower does not keep."""
    for behind, ahead in pairwise(now.row_of[vehicle] for vehicle in ids):
        gap, v = _gap(now, behind, ahead), float(now.v[behind])
        if failure := _gap_failure(gap, rule):
            return failure
        if gap > rule.max_time_gap * v:
            return f"time gap > {rule.max_time_gap:g} s"
        if v < rule.min_speed:
            return f"speed < {rule.min_speed:g} m/s"
    return ""


def _unsteady(history: Sequence[Snapshot], ids: Ids, rule: CarFollowing) -> str:
    """Whether a vehicle changed its lane, or drove at another speed than its leader, during the history."""
    rows = [[snapshot.row_of[vehicle] for vehicle in ids] for snapshot in history]
    d = np.array([snapshot.d[row] for snapshot, row in zip(history, rows, strict=True)])
    v = np.array([snapshot.v[row] for snapshot, row in zip(history, rows, strict=True)])
    if np.any(np.abs(d - d[-1]) >= SAME_LANE):
        return "lane change during the history"
    if np.any(np.abs(np.diff(v, axis=1)) > rule.max_speed_difference):
        return f"speed difference > {rule.max_speed_difference:g} m/s during the history"
    return ""


def _merges(history: Sequence[Snapshot], rule: Merge, barred: Mapping[str, str], lanes: MergeLanes) -> Candidates:
    """Vehicles on the ending lane with a lag vehicle and a leader in the lane beside them."""
    now, rows, sources, targets = history[-1], history[-1].row_of, lanes.source_ids, lanes.target_ids
    beside = sorted((now.s[row], vehicle) for vehicle, row in rows.items() if now.lane[row] in targets)
    for merger in (vehicle for vehicle, row in rows.items() if now.lane[row] in sources):
        if not rule.zone[0] <= now.s[rows[merger]] <= rule.zone[1]:
            yield None, f"outside the zone {list(rule.zone)} m"
            continue
        ahead = int(np.searchsorted([s for s, _ in beside], now.s[rows[merger]]))
        if not 0 < ahead < len(beside):
            yield None, f"no vehicle behind or ahead on lane {lanes.target.lane}"
            continue
        ids = merger, beside[ahead - 1][1], beside[ahead][1]
        reason = next((barred[vehicle] for vehicle in ids if vehicle in barred), "")
        yield ids, reason or _unacceptable(now, ids, rule) or _left_lane(history, ids)


def _unacceptable(now: Snapshot, ids: Ids, rule: Merge) -> str:
    """The limit of gaps, speeds or speed differences that merging vehicle, lag vehicle and leader do not keep."""
    merger, lag, leader = (now.row_of[vehicle] for vehicle in ids)
    for gap in (_gap(now, lag, merger), _gap(now, merger, leader)):
        if failure := _gap_failure(gap, rule):
            return failure
    if now.v[[merger, lag, leader]].min() < rule.min_speed:
        return f"speed < {rule.min_speed:g} m/s"
    if np.abs(now.v[[lag, leader]] - now.v[merger]).max() > rule.max_speed_difference:
        return f"speed difference > {rule.max_speed_difference:g} m/s"
    return ""


def _left_lane(history: Sequence[Snapshot], ids: Ids) -> str:
    """Whether one of the three was absent, or one of the last two changed its lane, during the history."""
    if any(not set(ids) <= snapshot.row_of.keys() for snapshot in history):
        return "absent during the history"
    d = np.array([[snapshot.d[snapshot.row_of[vehicle]] for vehicle in ids[1:]] for snapshot in history])
    return "lane change during the history" if np.any(np.abs(d - d[-1]) >= SAME_LANE) else ""
