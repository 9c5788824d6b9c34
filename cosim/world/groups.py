"""Groups of interacting vehicles: their roles and lanes, and which of them can be driven in one branch.

Roles: in car following 0 follows 1, 1 follows 2, and so on; in merging 0 merges between the lag vehicle 1 and the
leader 2. The last role is the given leader, which SUMO drives (Sec. VI-C, VI-D of the paper). A merge has three
vehicles, car following two to eight.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from cosim.spec.scenario import CarFollowing, Merge
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import LaneStrip, Snapshot
from gri.core.edges import EdgeType

SAME_LANE = 1.0  # [m] of lateral distance; lanes are wider than 3 m, vehicles keep to their centres


@dataclass(frozen=True)
class Group:
    """The ids of N interacting vehicles in the order of their roles 0 … N−1; `time` [s] is when they were found."""

    ids: tuple[str, ...]
    time: float

    @property
    def leader(self) -> str:
        """The vehicle of the last role."""
        return self.ids[-1]


@dataclass(frozen=True)
class LanePair:
    """A lane that ends and the lane beside it, up to `end` [m] of s."""

    source: str
    target: str
    end: float


@dataclass(frozen=True)
class MergeLanes:
    """The lane that ends (`source`) and the lane beside it into which vehicles merge (`target`).

    `side` is 1 where the target is on the side of larger d, and −1 where it is on the other one. Both lanes may go on
    across nodes: `pairs` are the lanes one after the other. `targets` are the lanes on which lag vehicle and leader may
    be. Empty means the one lane each. `ends` is off where the source goes on along the road all the same.
    `path` is the way of a ramp that joins the target at a node, with the s of the road from there on.
    """

    source: LaneStrip
    target: LaneStrip
    side: int = 1
    pairs: tuple[LanePair, ...] = ()
    targets: frozenset[str] = frozenset()
    ends: bool = True
    path: RoadFrame | None = None

    @property
    def boundary(self) -> float:
        """Lateral position d [m] of the line between them."""
        return self.target.centre - self.side * 0.5 * self.target.width

    def beyond(self, d: Float[np.ndarray, "*n"] | float) -> Float[np.ndarray, "*n"] | float:
        """How far [m] a place at d is beyond that line, on the side of the target."""
        return self.side * (d - self.boundary)

    def at(self, s: float) -> LanePair:
        """The two lanes at s [m]."""
        last = LanePair(self.source.lane, self.target.lane, self.source.end)
        return next((pair for pair in self.pairs if s < pair.end), self.pairs[-1] if self.pairs else last)

    @property
    def source_ids(self) -> frozenset[str]:
        """The lanes on which merging vehicles are."""
        return frozenset({self.source.lane, *(pair.source for pair in self.pairs)})

    @property
    def target_ids(self) -> frozenset[str]:
        """The lanes on which lag vehicle and leader are."""
        return self.targets or frozenset({self.target.lane})


def order_of(rule: CarFollowing | Merge) -> tuple[int, ...]:
    """The roles from the rear to the front."""
    return tuple(range(rule.size)) if isinstance(rule, CarFollowing) else (1, 0, 2)


def next_ahead(snapshot: Snapshot, rows: Int[np.ndarray, " R"]) -> Int[np.ndarray, " R"]:
    """Row of the next vehicle ahead in the same lane, −1 where the road ahead is empty; for a few vehicles.

    Of vehicles at the same distance it is the first one. `everybody_ahead` gives the same for all vehicles.
    """
    if not len(snapshot.ids):
        return np.full(len(rows), -1)
    distance = snapshot.s[None] - snapshot.s[rows][:, None]  # Shape: (R, V)
    same_lane = np.abs(snapshot.d[None] - snapshot.d[rows][:, None]) < SAME_LANE
    distance = np.where(same_lane & (distance > 0), distance, np.inf)
    nearest = distance.argmin(axis=1)
    return np.where(np.isinf(distance[np.arange(len(rows)), nearest]), -1, nearest)


def everybody_ahead(snapshot: Snapshot) -> Int[np.ndarray, " V"]:
    """What `next_ahead` gives for all V vehicles, in O(V log V).

    The road is cut into strips as wide as SAME_LANE. A vehicle is in the same lane as all others of its strip, and
    perhaps as some in the strips beside it, of which only those count that are no farther ahead than the next one in
    its own strip. These stretches do not overlap, so no more than about three vehicles are looked at for each one.
    """
    s, d, n = snapshot.s, snapshot.d, len(snapshot.ids)
    if not n:
        return np.full(0, -1)
    values, rank = np.unique(s, return_inverse=True)
    stride = len(values) + 1
    strip = np.floor(d / SAME_LANE).astype(np.int64) * stride
    key = strip + rank  # orders by strip, then by s
    order = np.argsort(key, kind="stable")
    keys = key[order]
    first = np.minimum(np.searchsorted(keys, key, side="right"), n - 1)
    own = order[first]
    # Rounding can set two vehicles of one strip a whole SAME_LANE apart.
    found = (strip[own] == strip) & (s[own] > s) & (np.abs(d[own] - d) < SAME_LANE)
    # Two vehicles at slightly different s can be at the same rounded distance.
    reach = np.where(found, s[own] + 4 * np.spacing(np.maximum(np.abs(s), np.abs(s[own]))), np.inf)
    until = np.searchsorted(values, reach, side="right")
    beside = np.array([[-stride], [0], [stride]])
    begin, end = np.searchsorted(keys, key + beside, side="right"), np.searchsorted(keys, strip + until + beside)
    count = (end - begin).ravel()
    behind = np.repeat(np.tile(np.arange(n), 3), count)
    ahead = order[np.arange(len(behind)) + np.repeat(begin.ravel() - (np.cumsum(count) - count), count)]
    distance = np.where(np.abs(d[ahead] - d[behind]) < SAME_LANE, s[ahead] - s[behind], np.inf)
    least = np.full(n, np.inf)
    np.minimum.at(least, behind, distance)
    nearest = np.isfinite(distance) & (distance == least[behind])
    row = np.full(n, n)
    np.minimum.at(row, behind[nearest], ahead[nearest])
    return np.where(row < n, row, -1)


def isolated(groups: Sequence[Group], now: Snapshot) -> list[tuple[Group, ...]]:
    """The groups, sorted into sets that can be driven in one branch each because none acts on another's leader.

    In a set the followers of every group are behind the leader of every group, in whatever lanes. So nothing that a
    policy drives is ahead of a leader. Two groups in one lane are never in one set. Each group is in the
    first set that it fits into.
    """
    s = {vehicle: float(now.s[row]) for vehicle, row in now.row_of.items()}
    sets: list[list[Group]] = []
    for group in groups:

        def fits(others: list[Group], group: Group = group) -> bool:
            together = [*others, group]
            foremost_driven = max(s[vehicle] for one in together for vehicle in one.ids[:-1])
            return foremost_driven < min(s[one.leader] for one in together)

        place = next(filter(fits, sets), None)
        if place is None:
            sets.append([group])
        else:
            place.append(group)
    return [tuple(one) for one in sets]


def expected_graph(rule: CarFollowing | Merge) -> dict[tuple[int, int], EdgeType]:
    """The relations that the definition of the group rule implies; all other pairs have none."""
    if isinstance(rule, CarFollowing):
        return {(j + 1, j): EdgeType.FOLLOW for j in range(rule.size - 1)}
    return {(2, 0): EdgeType.FOLLOW, (1, 0): EdgeType.CUT_IN, (0, 1): EdgeType.YIELD}
