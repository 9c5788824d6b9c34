"""Finding groups of interacting vehicles in traffic, and why there are not more; pure functions of snapshots."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int

from cosim.measures.surrogate_safety import net_gap
from cosim.spec.scenario import USUAL_SIZE, CarFollowing, Merge
from cosim.world.groups import SAME_LANE, Group, MergeLanes, everybody_ahead
from cosim.world.snapshot import Snapshot

OUTSIDE = "outside the study area"
Ids = tuple[str, ...]
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


_NUMBERS = ("", "", "two", "three", "four", "five", "six", "seven", "eight")
_ON_ENDING_LANE = "vehicles on the ending lane"


def why_not_more(rule: str, seen: int, failed: Mapping[str, int], size: int = USUAL_SIZE) -> str:
    """How many candidates a search for groups of a rule saw, and how many failed which limit."""
    noun = f"chains of {_NUMBERS[size]} vehicles in the study area" if rule == "car_following" else _ON_ENDING_LANE
    reasons = [f"{count} {reason}" for reason, count in sorted(failed.items(), key=lambda item: (-item[1], item[0]))]
    return f"{seen} {noun} seen, once a second" + (f": {'; '.join(reasons)}" if reasons else "")


def _chains(history: Sequence[Snapshot], rule: CarFollowing, barred: Mapping[str, str]) -> Candidates:
    """Chains in one lane of the study area, each vehicle the next one's leader, now and during the whole history."""
    now, ahead = history[-1], everybody_ahead(history[-1])
    rows = np.arange(len(ahead))[:, None]
    for _ in range(rule.size - 1):
        following = np.concatenate([rows, ahead[rows[:, -1:]]], axis=1)
        rows = following[following[:, -1] >= 0]
    outside = np.array([barred.get(vehicle) == OUTSIDE for vehicle in now.ids], dtype=bool)
    rows = rows[~outside[rows].any(axis=1)]
    ids: list[Ids] = [tuple(now.ids[row] for row in of) for of in rows.tolist()]
    reasons = [next((barred[vehicle] for vehicle in of if vehicle in barred), "") for of in ids]
    free = [k for k, reason in enumerate(reasons) if not reason]
    for k, failure in zip(free, _chain_failures(history, rule, rows[free]), strict=True):
        reasons[k] = failure
    yield from zip(ids, reasons, strict=True)


def _chain_failures(history: Sequence[Snapshot], rule: CarFollowing, rows: Int[np.ndarray, "C N"]) -> list[str]:
    """The first limit that each chain fails, given by its rows in the last snapshot; "" where it fails none."""
    now = history[-1]
    d, v, gap = now.d[rows], now.v[rows], net_gap(now.s[rows[:, :-1]], now.s[rows[:, 1:]], now.length[rows[:, 1:]])
    reordered, moved, unsteady = (np.zeros(len(rows), dtype=bool) for _ in range(3))
    for snapshot, at in zip(history, _rows_during(history, rows), strict=True):
        present = (at >= 0).all(axis=1)
        reordered |= ~present
        if present.any():
            reordered |= (everybody_ahead(snapshot)[at[:, :-1]] != at[:, 1:]).any(axis=1)
            moved |= (np.abs(snapshot.d[at] - d) >= SAME_LANE).any(axis=1)
            unsteady |= (np.abs(np.diff(snapshot.v[at], axis=1)) > rule.max_speed_difference).any(axis=1)
    limits = [
        (f"gap < {rule.min_gap:g} m", gap < rule.min_gap),
        (f"gap > {rule.max_gap:g} m", gap > rule.max_gap),
        (f"time gap > {rule.max_time_gap:g} s", gap > rule.max_time_gap * v[:, :-1]),
        (f"speed < {rule.min_speed:g} m/s", v[:, :-1] < rule.min_speed),
    ]
    checks = [
        ("in another order or lane during the history", reordered),
        *((text, of[:, follower]) for follower in range(rule.size - 1) for text, of in limits),
        ("lane change during the history", moved),
        (f"speed difference > {rule.max_speed_difference:g} m/s during the history", unsteady),
        ("", np.ones(len(rows), dtype=bool)),
    ]
    first = np.argmax([of for _, of in checks], axis=0)
    return [checks[k][0] for k in first.tolist()]


def _rows_during(history: Sequence[Snapshot], rows: Int[np.ndarray, "C N"]) -> Iterator[Int[np.ndarray, "C N"]]:
    """The rows of the same vehicles in each snapshot; −1 where a vehicle is absent."""
    members, which = np.unique(rows, return_inverse=True)
    names = [history[-1].ids[row] for row in members.tolist()]
    for snapshot in history:
        at = np.array([snapshot.row_of.get(vehicle, -1) for vehicle in names], dtype=int)
        yield at[which.reshape(rows.shape)]


def _gap(now: Snapshot, behind: int, ahead: int) -> float:
    return float(net_gap(now.s[[behind]], now.s[[ahead]], now.length[[ahead]])[0])


def _gap_failure(gap: float, rule: CarFollowing | Merge) -> str:
    if gap < rule.min_gap:
        return f"gap < {rule.min_gap:g} m"
    return f"gap > {rule.max_gap:g} m" if gap > rule.max_gap else ""


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
        if not reason and lanes.path is not None and _is_behind_another(now, merger, lanes):
            reason = "behind another vehicle on the ramp"
        yield ids, reason or _unacceptable(now, ids, rule) or _left_lane(history, ids)


def _is_behind_another(now: Snapshot, merger: str, lanes: MergeLanes) -> bool:
    """Whether another vehicle is ahead on the ramp: it will be the leader, or stands in the way."""
    ahead = np.isin(now.lane, [*lanes.source_ids]) & (now.s > now.s[now.row_of[merger]])
    return bool(ahead.any())


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
