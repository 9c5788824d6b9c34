"""What is read from SUMO, as plain values: vehicles at one instant, reports of steps, positions of lanes.

`Snapshot` is what the closed loop reads, `LaneTraffic` is what scenes are made from.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntFlag
from functools import cached_property, lru_cache
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float, Int

COLUMNS = ("s", "d", "x", "y", "heading", "v", "a")
"""Features of vehicle states: SI units, frames of `cosim.world.road_frame`."""


@dataclass(frozen=True)
class Snapshot:
    """All vehicles at one instant, in SUMO's order of ids.

    `xy` and `heading` are in the world frame, `s` and `d` in the road frame (`cosim.world.road_frame`), SI units.
    `lane` is the id of a vehicle's lane, "" where it is on none; `lane` is empty where lanes were not read.
    """

    time: float
    ids: tuple[str, ...]
    xy: Float[np.ndarray, "V 2"]
    heading: Float[np.ndarray, " V"]
    v: Float[np.ndarray, " V"]
    a: Float[np.ndarray, " V"]
    s: Float[np.ndarray, " V"]
    d: Float[np.ndarray, " V"]
    length: Float[np.ndarray, " V"]
    width: Float[np.ndarray, " V"]
    lane: tuple[str, ...]

    @classmethod
    def of_block(
        cls,
        time: float,
        ids: tuple[str, ...],
        block: Float[np.ndarray, "C V"],
        sizes: Float[np.ndarray, "2 V"],
        lane: tuple[str, ...],
    ) -> "Snapshot":
        """The snapshot whose features of COLUMNS are the rows of a block; `sizes` are lengths and widths [m]."""
        s, d, _, _, heading, v, a = block
        snapshot = cls(time, ids, block[2:4].T, heading, v, a, s, d, sizes[0], sizes[1], lane)
        snapshot.__dict__["state"] = block.T  # what the cached property would join again
        return snapshot

    @cached_property
    def row_of(self) -> Mapping[str, int]:
        """Row of every vehicle."""
        return row_of_ids(self.ids)

    @cached_property
    def state(self) -> Float[np.ndarray, "V C"]:
        """The features of COLUMNS of all vehicles."""
        return np.column_stack([self.s, self.d, self.xy, self.heading, self.v, self.a])

    def features(self, rows: Int[np.ndarray, "G N"]) -> Float[np.ndarray, "G N C"]:
        """The features of COLUMNS of the vehicles in these rows."""
        return self.state[rows]

    def only(self, wanted: Bool[np.ndarray, " V"]) -> "Snapshot":
        """The snapshot of the wanted vehicles."""
        ids, lane = (tuple(compress(of, wanted)) for of in (self.ids, self.lane))
        arrays = ("xy", "heading", "v", "a", "s", "d", "length", "width")
        return replace(self, ids=ids, lane=lane, **{name: getattr(self, name)[wanted] for name in arrays})

    def rows(self, ids: Sequence[str]) -> dict[str, int]:
        """Row of each id that is present."""
        return {vehicle: self.row_of[vehicle] for vehicle in ids if vehicle in self.row_of}


@lru_cache(maxsize=8)
def row_of_ids(ids: tuple[str, ...]) -> Mapping[str, int]:
    """Row of every id; cached, as most steps have the same ids as the one before."""
    return dict(zip(ids, range(len(ids)), strict=True))


@dataclass(frozen=True)
class LaneTraffic:
    """The vehicles on some lanes at one instant, lane by lane, with their leaders.

    The columns are plain lists because they are read in every step. `lane` is the index of the lane among those read,
    `position` [m] is along the lane, `v` is in m/s. `leader` is "" where none is near, `gap` [m] is the gap to it minus
    the driver's minimum gap.
    """

    ids: list[str]
    lane: list[int]
    position: list[float]
    v: list[float]
    leader: list[str]
    gap: list[float]

    @cached_property
    def row_of(self) -> dict[str, int]:
        """Row of every vehicle."""
        return dict(zip(self.ids, range(len(self.ids)), strict=True))


class LaneChange(IntFlag):
    """Bits of SUMO's lane-change state that are used here (SUMO doc: LaneChangeAction)."""

    LEFT = 1 << 1
    RIGHT = 1 << 2
    STRATEGIC = 1 << 3
    COOPERATIVE = 1 << 4
    URGENT = 1 << 8
    BLOCKED_BY_LEFT_LEADER = 1 << 9
    BLOCKED_BY_LEFT_FOLLOWER = 1 << 10
    BLOCKED_BY_RIGHT_LEADER = 1 << 11
    BLOCKED_BY_RIGHT_FOLLOWER = 1 << 12


@dataclass(frozen=True)
class DriverParameters:
    """Constant parameters of a vehicle and its driver; SI units."""

    kind: str
    length: float
    width: float
    acceleration: float
    imperfection: float
    """Krauss's sigma; 0 for models without one."""
    action_step: float
    """Time between two decisions [s], SUMO's `actionStepLength`."""
    speed_factor: float
    max_speed: float


@dataclass(frozen=True)
class StepReport:
    """What SUMO says happened in one step; `collisions` are (collider, victim)."""

    time: float
    arrived: tuple[str, ...]
    teleported: tuple[str, ...]
    collisions: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class LaneStrip:
    """A lane in the road frame: from `begin` to `end` [m] along the road, its `centre` at d [m], its `width` [m]."""

    lane: str
    begin: float
    end: float
    centre: float
    width: float


@dataclass
class NearbyFilter:
    """The vehicles (`ids`) that can come near to given `vehicles` within some seconds.

    They are those that were not far away at `time` [s], and those that have entered the net since. `lane_ahead` [m] is
    the distance along the lane that counts as near.
    """

    vehicles: tuple[str, ...]
    lane_ahead: float
    ids: tuple[str, ...]
    time: float

    def is_valid_for(self, vehicles: tuple[str, ...], lane_ahead: float, since: float) -> bool:
        """Whether the filter is for these vehicles and this distance, and not older than `since` [s]."""
        return self.vehicles == vehicles and self.lane_ahead >= lane_ahead and self.time >= since

    def update(self, entered: Sequence[str], gone: Sequence[str]) -> None:
        """Add the vehicles that entered the net in a step, and drop those that left it."""
        if entered:
            self.ids = (*self.ids, *entered)
        if any(vehicle in self.ids for vehicle in gone):
            self.ids = tuple([vehicle for vehicle in self.ids if vehicle not in gone])


LANE_AHEAD = 80.0  # [m] along its lane, within which other vehicles count as near to a vehicle by default


def is_near(
    s: Float[np.ndarray, " V"],
    d: Float[np.ndarray, " V"],
    rows: Int[np.ndarray, " R"],
    along: float = 0,
    across: float = 0,
    lane_ahead: float = LANE_AHEAD,
) -> Bool[np.ndarray, " V"]:
    """The vehicles near to those in `rows`, which are near to themselves.

    Near means less than `lane_ahead` [m] away in the same lane, or less than 25 m along the road in a lane beside it.
    `along` and `across` [m] widen these limits.
    """
    ds, dd = np.abs(s - s[rows, None]), np.abs(d - d[rows, None])
    involved = ((ds < lane_ahead + along) & (dd < 2 + across)) | ((ds < 25 + along) & (dd < 6 + across))
    return np.logical_or.reduce(involved, axis=0)


def rows_of(ids: Sequence[str], wanted: Iterable[str]) -> Int[np.ndarray, " R"]:
    """Rows of the wanted vehicles that are present."""
    which = set(wanted)
    return np.array([row for row, vehicle in enumerate(ids) if vehicle in which], dtype=int)
