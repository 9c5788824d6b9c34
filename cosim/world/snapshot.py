"""What is read from the world: all vehicles, or some, at one instant; what happened in a step; where lanes lie.

Plain values: whoever has them needs no simulation.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntFlag
from functools import cached_property, lru_cache
from itertools import compress

import numpy as np
from jaxtyping import Bool, Float, Int

COLUMNS = (
    "s",
    "d",
    "x",
    "y",
    "heading",
    "v",
    "a",
)  # of tables of vehicles, SI units, frames of cosim/world/road_frame.py


@dataclass(frozen=True)
class Snapshot:
    """All vehicles at one instant, in SUMO's order of ids. World and road frame (`road_frame`), SI units."""

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

    @cached_property
    def where(self) -> Mapping[str, int]:
        """Row of every vehicle."""
        return _places(self.ids)

    def features(self, rows: Int[np.ndarray, "G N"]) -> Float[np.ndarray, "G N C"]:
        """The features of COLUMNS of the vehicles in these rows."""
        place = {"x": self.xy[:, 0], "y": self.xy[:, 1]}
        table = np.array([place[name] if name in place else getattr(self, name) for name in COLUMNS])
        return table[:, rows].transpose(1, 2, 0)

    def only(self, wanted: Bool[np.ndarray, " V"]) -> "Snapshot":
        """Some of the vehicles."""
        ids, lane = (tuple(compress(of, wanted)) for of in (self.ids, self.lane))
        arrays = ("xy", "heading", "v", "a", "s", "d", "length", "width")
        return replace(self, ids=ids, lane=lane, **{name: getattr(self, name)[wanted] for name in arrays})

    def rows(self, ids: Sequence[str]) -> dict[str, int]:
        """Row of each id that is present."""
        return {vehicle: self.where[vehicle] for vehicle in ids if vehicle in self.where}


@lru_cache(maxsize=2)
def _places(ids: tuple[str, ...]) -> Mapping[str, int]:
    """Place of every id, the same ones again in most steps."""
    return dict(zip(ids, range(len(ids)), strict=True))


@dataclass(frozen=True)
class Driving:
    """The vehicles on some lanes at one instant, lane by lane, and what SUMO says of their drivers.

    Plain lists: they are read in every step. `lane` counts the lanes asked for, `position` [m] runs along the lane.
    `leader` is "" where none is near, `gap` [m] is what is left to it beyond the driver's least gap.
    """

    ids: list[str]
    lane: list[int]
    position: list[float]
    v: list[float]
    leader: list[str]
    gap: list[float]

    @cached_property
    def where(self) -> dict[str, int]:
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
    """What does not change about a vehicle and its driver; SI units."""

    kind: str
    length: float
    width: float
    acceleration: float
    imperfection: float
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
class Strip:
    """A lane in the road frame: from `begin` to `end` [m], its centre at `centre` [m] to the left, its width [m]."""

    lane: str
    begin: float
    end: float
    centre: float
    width: float


@dataclass
class NearbyFilter:
    """Who can come near the `vehicles` within some seconds: who was not far from them, and who entered since."""

    vehicles: tuple[str, ...]
    lane_ahead: float
    ids: tuple[str, ...]
    time: float
    """When they were found [s]."""

    def holds(self, vehicles: tuple[str, ...], lane_ahead: float, since: float) -> bool:
        """Whether they are still those who can come so near to these vehicles."""
        return self.vehicles == vehicles and self.lane_ahead >= lane_ahead and self.time >= since

    def stepped(self, entered: Sequence[str], gone: Sequence[str]) -> None:
        """One step later."""
        if entered or gone:
            self.ids = tuple([vehicle for vehicle in (*self.ids, *entered) if vehicle not in gone])


LANE_AHEAD = 80.0  # [m] along its own lane within which others have to do with a vehicle, if nothing else is said


def near(
    s: Float[np.ndarray, " V"],
    d: Float[np.ndarray, " V"],
    rows: Int[np.ndarray, " R"],
    along: float = 0,
    across: float = 0,
    lane_ahead: float = LANE_AHEAD,
) -> Bool[np.ndarray, " V"]:
    """Who has to do with the vehicles `rows`: so far along their own lane, 25 m beside it, themselves included.

    With `along` and `across`: who is at most so much farther away.
    """
    ds, dd = np.abs(s - s[rows, None]), np.abs(d - d[rows, None])
    involved = ((ds < lane_ahead + along) & (dd < 2 + across)) | ((ds < 25 + along) & (dd < 6 + across))
    return np.logical_or.reduce(involved, axis=0)


def rows_of(ids: Sequence[str], wanted: Iterable[str]) -> Int[np.ndarray, " R"]:
    """Rows of those of the wanted vehicles that are there."""
    which = set(wanted)
    return np.array([row for row, vehicle in enumerate(ids) if vehicle in which], dtype=int)
