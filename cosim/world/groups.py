"""Finding groups of three interacting vehicles in traffic; pure functions of a history of snapshots.

Roles: in car following 0 follows 1 follows 2; in merging 0 merges between the lag vehicle 1 and the leader 2. Vehicle 2
is the given leader, which SUMO drives (Sec. VI-C, VI-D of the paper).
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Int

from cosim.measures.surrogate_safety import net_gap
from cosim.spec.scenario import CarFollowing, Merge
from cosim.world.snapshot import LaneStrip, Snapshot
from gri.core.graph import EdgeType

SAME_LANE = 1.0  # [m] of lateral distance; lanes are wider than 3 m, vehicles keep to their centres


@dataclass(frozen=True)
class Group:
    """The ids of three interacting vehicles in the order of their roles 0, 1, 2; `time` [s] is when they were found."""

    ids: tuple[str, str, str]
    time: float


@dataclass(frozen=True)
class MergeLanes:
    """The lane that ends (`source`) and the lane to its left into which vehicles merge (`target`)."""

    source: LaneStrip
    target: LaneStrip

    @property
    def boundary(self) -> float:
        """Lateral position d [m] of the line between them."""
        return self.target.centre - 0.5 * self.target.width


def target_lane(rule: Merge) -> str:
    """Id of the lane to the left of the one that ends."""
    edge, _, index = rule.lane.rpartition("_")
    return f"{edge}_{int(index) + 1}"


def order_of(rule: CarFollowing | Merge) -> tuple[int, int, int]:
    """The roles from the rear to the front."""
    return (0, 1, 2) if isinstance(rule, CarFollowing) else (1, 0, 2)


def next_ahead(snapshot: Snapshot, rows: Int[np.ndarray, " R"]) -> Int[np.ndarray, " R"]:
    """Row of the next vehicle ahead in the same lane, −1 where the road ahead is empty."""
    if not len(snapshot.ids):
        return np.full(len(rows), -1)
    distance = snapshot.s[None] - snapshot.s[rows][:, None]  # Shape: (R, V)
    same_lane = np.abs(snapshot.d[None] - snapshot.d[rows][:, None]) < SAME_LANE
    distance = np.where(same_lane & (distance > 0), distance, np.inf)
    nearest = distance.argmin(axis=1)
    return np.where(np.isinf(distance[np.arange(len(rows)), nearest]), -1, nearest)


def find_groups(
    history: Sequence[Snapshot],
    rule: CarFollowing | Merge,
    *,
    zone: tuple[float, float],
    eligible: Set[str],
    limit: int,
) -> list[Group]:
    """Up to `limit` groups that fit the rule, the one farthest ahead first; no vehicle is in two groups.

    All vehicles of a group are within `zone` (the range of s [m]) at the end of the history and among the `eligible`.
    """
    now, taken, groups = history[-1], set(), []
    rows = now.rows(now.ids)
    inside = {v for v, row in rows.items() if zone[0] <= now.s[row] <= zone[1]} & eligible
    found = _chains(history, rule, inside) if isinstance(rule, CarFollowing) else _merges(history, rule, inside)
    for ids in sorted(found, key=lambda ids: (-now.s[rows[ids[0]]], ids)):
        if len(groups) < limit and not taken & set(ids):
            groups.append(Group(ids, now.time))
            taken |= set(ids)
    return groups


def _chains(history: Sequence[Snapshot], rule: CarFollowing, inside: Set[str]) -> list[tuple[str, str, str]]:
    """Triples in one lane in which, at every instant of the history, each is the next one's leader."""
    leaders = [_leaders(snapshot) for snapshot in history]
    now, rows = history[-1], history[-1].rows(history[-1].ids)
    chains = [(rear, middle, leaders[-1].get(middle, "")) for rear, middle in leaders[-1].items()]
    return [
        ids
        for ids in chains
        if set(ids) <= inside
        and all(at.get(ids[0]) == ids[1] and at.get(ids[1]) == ids[2] for at in leaders)
        and all(_follows_closely(now, rows[behind], rows[ahead], rule) for behind, ahead in pairwise(ids))
        and _steady(history, ids, rule.max_speed_difference)
    ]


def _leaders(snapshot: Snapshot) -> dict[str, str]:
    """The next vehicle ahead in the same lane, for every vehicle that has one."""
    ahead = next_ahead(snapshot, np.arange(len(snapshot.ids)))
    return {snapshot.ids[row]: snapshot.ids[k] for row, k in enumerate(ahead) if k >= 0}


def _gap(now: Snapshot, behind: int, ahead: int) -> float:
    return float(net_gap(now.s[[behind]], now.s[[ahead]], now.length[[ahead]])[0])


def _follows_closely(now: Snapshot, behind: int, ahead: int, rule: CarFollowing) -> bool:
    """Whether gap and speed of a follower are within the limits of the rule."""
    gap = _gap(now, behind, ahead)
    v = float(now.v[behind])
    return rule.min_gap <= gap <= min(rule.max_gap, rule.max_time_gap * v) and v >= rule.min_speed


def _steady(history: Sequence[Snapshot], ids: Sequence[str], max_speed_difference: float) -> bool:
    """Whether all vehicles kept their lane and drove at similar speeds as their leaders during the history."""
    rows = [[snapshot.rows(ids)[vehicle] for vehicle in ids] for snapshot in history]
    d = np.array([snapshot.d[row] for snapshot, row in zip(history, rows, strict=True)])
    v = np.array([snapshot.v[row] for snapshot, row in zip(history, rows, strict=True)])
    similar = np.abs(np.diff(v, axis=1)) <= max_speed_difference
    return bool((np.abs(d - d[-1]) < SAME_LANE).all() and similar.all())


def _merges(history: Sequence[Snapshot], rule: Merge, inside: Set[str]) -> list[tuple[str, str, str]]:
    """Vehicles on the ending lane with a lag vehicle and a leader in the lane to their left."""
    now, rows, target = history[-1], history[-1].rows(history[-1].ids), target_lane(rule)
    beside = sorted((now.s[rows[v]], v) for v in now.ids if now.lane[rows[v]] == target)
    found = []
    for merger in inside:
        if now.lane[rows[merger]] != rule.lane or not rule.zone[0] <= now.s[rows[merger]] <= rule.zone[1]:
            continue
        ahead = np.searchsorted([s for s, _ in beside], now.s[rows[merger]])
        if not 0 < ahead < len(beside):
            continue
        ids = merger, beside[ahead - 1][1], beside[ahead][1]
        if set(ids[1:]) <= inside and _acceptable(now, [rows[v] for v in ids], rule) and _kept_lane(history, ids):
            found.append(ids)
    return found


def _acceptable(now: Snapshot, rows: list[int], rule: Merge) -> bool:
    """Whether gaps and speed differences of merger, lag vehicle and leader are within the limits of the rule."""
    merger, lag, leader = rows
    gaps = _gap(now, lag, merger), _gap(now, merger, leader)
    differences = np.abs(now.v[[lag, leader]] - now.v[merger])
    return (
        all(rule.min_gap <= gap <= rule.max_gap for gap in gaps)
        and float(now.v[rows].min()) >= rule.min_speed
        and float(differences.max()) <= rule.max_speed_difference
    )


def _kept_lane(history: Sequence[Snapshot], ids: tuple[str, str, str]) -> bool:
    """Whether all three were present during the whole history and the last two kept their lane."""
    rows = [snapshot.rows(ids) for snapshot in history]
    if any(len(found) < 3 for found in rows):
        return False
    d = np.array([[snapshot.d[row[v]] for v in ids[1:]] for snapshot, row in zip(history, rows, strict=True)])
    return bool((np.abs(d - d[-1]) < SAME_LANE).all())


def expected_graph(rule: CarFollowing | Merge) -> dict[tuple[int, int], EdgeType]:
    """The relations that the definition of the group rule implies; all other pairs have none."""
    if isinstance(rule, CarFollowing):
        return {(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}
    return {(2, 0): EdgeType.FOLLOW, (1, 0): EdgeType.CUT_IN, (0, 1): EdgeType.YIELD}
