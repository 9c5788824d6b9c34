"""Reading the positions of vehicles: of all, or of those near to given ones, of which as few as possible are read."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from itertools import chain

import libsumo
import numpy as np
from jaxtyping import Int

from cosim.world.road_frame import LanePlace, RoadFrame
from cosim.world.snapshot import NearbyFilter, is_near, row_of_ids, rows_of

SHADOW = "twin:"  # prefix of the ids of shadow vehicles; SUMO orders vehicles by id, so another one can change results
_RINGS = ((5.0, 150.0, 20.0), (1.0, 30.0, 4.0))
"""Which positions are read: (valid for [s], margin along the road [m], margin across it [m]).

The positions of all vehicles are read every 5 s. Every second, only vehicles within the first margins of being near are
read. In between, only those within the second margins are read. No vehicle moves farther than its margin in that time.
"""
_NOWHERE = (libsumo.constants.INVALID_DOUBLE_VALUE,) * 2  # the position of a vehicle that is off all lanes
_raw = libsumo._libsumo  # without libsumo's Python wrappers, which take as long again
_point, _lane, _along = _raw.vehicle_getPosition, _raw.vehicle_getLaneID, _raw.vehicle_getLanePosition
_TRACKED = 60.0  # [m] of s around the last known place of a vehicle, in which it is now
_LONGEST_TRACK = 1.5  # [s] since a vehicle was last seen, after which its last place says nothing
_ANYWHERE = LanePlace(-math.inf, math.inf)

# ids, world points [V, 2], s and d of some vehicles
Positions = tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]


class KnownVehicles:
    """The ids of the vehicles on the net, in SUMO's order, which is that of the ids.

    To ask SUMO takes longer than to read the speeds of all vehicles. So the ids are kept from step to step, with those
    that departed and without those that arrived. They are asked for again after a teleport and where vehicles are added
    or removed. A vehicle that left all lanes may be among them: its position is nowhere.
    """

    def __init__(self) -> None:
        self._ids: tuple[str, ...] | None = None
        self._present: frozenset[str] | None = None
        self.can_be_kept = True

    def update(self, departed: Sequence[str], arrived: Sequence[str]) -> None:
        """Take note of the vehicles that entered and left the net in a step."""
        if self._ids is None:
            return
        if libsumo.simulation.getStartingTeleportIDList() or libsumo.simulation.getEndingTeleportIDList():
            self.forget()
        elif departed or arrived:
            gone = {*arrived}
            self._ids = tuple(sorted({*self._ids, *departed} - gone))
            self._present = None

    def forget(self) -> None:
        """Ask SUMO again the next time."""
        self._ids = self._present = None

    @property
    def ids(self) -> tuple[str, ...]:
        """All ids, in order."""
        if self._ids is None or not self.can_be_kept:
            self._ids, self._present = without_shadows(libsumo.vehicle.getIDList()), None
        return self._ids

    @property
    def present(self) -> Set[str]:
        """All ids."""
        ids = self.ids
        if self._present is None:
            self._present = frozenset(ids)
        return self._present


class PositionReader:
    """Reads positions in the running simulation, and remembers which vehicles were far from the ones last asked for."""

    def __init__(self, is_taken: Callable[[str], bool]) -> None:
        self._rings: list[NearbyFilter] = []
        self._is_taken = is_taken
        self._last: dict[str, tuple[float, float]] = {}  # time [s] and s [m] of vehicles when they were last seen
        self.known = KnownVehicles()

    def update(self, arrived: Sequence[str]) -> None:
        """Take note of the vehicles that entered and left the net in a step."""
        for vehicle in arrived:
            self._last.pop(vehicle, None)
        departed = without_shadows(libsumo.simulation.getDepartedIDList())
        self.known.update(departed, arrived)
        for ring in self._rings:
            ring.update(departed, arrived)

    def of_all(self, road: RoadFrame) -> Positions:
        """The positions of all vehicles."""
        try:
            return self._read(road, self.known.ids)
        except libsumo.TraCIException:  # a vehicle vanished without having arrived
            self.known.forget()
            return self._read(road, self.known.ids)

    def of_nearby(self, road: RoadFrame, around: tuple[str, ...], lane_ahead: float) -> Positions:
        """The positions of the vehicles near to those `around`, and of some more; see `is_near` for `lane_ahead`."""
        try:
            return self._nearby(around, lane_ahead, lambda: self.of_all(road), lambda ids: self._read(road, ids))
        except libsumo.TraCIException:  # a vehicle vanished without having arrived
            self._rings.clear()
            return self.of_nearby(road, around, lane_ahead)

    def rows_nearby(self, everybody: Positions, around: tuple[str, ...], lane_ahead: float) -> Int[np.ndarray, " R"]:
        """The rows of these vehicles in the positions of all vehicles, which have been read already."""
        row_of = row_of_ids(everybody[0])

        def some(ids: tuple[str, ...]) -> Positions:
            return only(everybody, np.array([row_of[vehicle] for vehicle in ids if vehicle in row_of], dtype=int))

        ids = self._nearby(around, lane_ahead, lambda: everybody, some)[0]
        return np.array([*map(row_of.__getitem__, ids)], dtype=int)

    def _nearby(
        self,
        around: tuple[str, ...],
        lane_ahead: float,
        everybody: Callable[[], Positions],
        some: Callable[[tuple[str, ...]], Positions],
    ) -> Positions:
        rings, now = self._rings, libsumo.simulation.getTime()
        while rings and not rings[-1].is_valid_for(around, lane_ahead, now - _RINGS[len(rings) - 1][0] + 1e-6):
            rings.pop()
        found = some(rings[-1].ids) if rings else everybody()
        for _, along, across in _RINGS[len(rings) :]:
            ids, _, s, d = found
            near = is_near(s, d, rows_of(ids, around), along, across, lane_ahead)
            found = only(found, np.flatnonzero(near))
            rings.append(NearbyFilter(around, lane_ahead, found[0], now))
        return found

    def _read(self, road: RoadFrame, ids: tuple[str, ...]) -> Positions:
        """The positions of those vehicles that have one: SUMO lists a vehicle that left all lanes for a few steps more.

        Vehicles in another world than that of the road are left out.
        """
        points = [*map(_point, ids)]
        if _NOWHERE in points:
            ids = tuple(v for v, point in zip(ids, points, strict=True) if point != _NOWHERE)
            points = [point for point in points if point != _NOWHERE]
        xy = np.fromiter(chain.from_iterable(points), float, 2 * len(points)).reshape(-1, 2)
        if road.places is None:
            return ids, xy, *road.to_road(xy)
        rows, low, high = self._in_world(road.places, ids)
        ids, xy = tuple([ids[row] for row in rows]), xy[rows]
        s, d = road.to_road(xy, (np.array(low), np.array(high)))
        now = libsumo.simulation.getTime()
        self._last |= {vehicle: (now, at) for vehicle, at in zip(ids, s.tolist(), strict=True)}
        return ids, xy, s, d

    def _in_world(
        self, places: Mapping[str, LanePlace], ids: tuple[str, ...]
    ) -> tuple[list[int], list[float], list[float]]:
        """The rows of the vehicles in the world of the road, and the range of s [m] in which each of them is.

        The lane of a vehicle says where it is. That of a vehicle that a policy drives is SUMO's guess: it is where it
        was a moment ago. So is a vehicle beside all lanes.
        """
        rows, low, high, now = [], [], [], libsumo.simulation.getTime()
        for row, (vehicle, lane) in enumerate(zip(ids, map(_lane, ids), strict=True)):
            place, (time, last) = places.get(lane), self._last.get(vehicle, (-math.inf, 0.0))
            if now - time < _LONGEST_TRACK and (not lane or self._is_taken(vehicle)):
                place = LanePlace(last - _TRACKED, last + _TRACKED)
            elif not lane:
                place = _ANYWHERE
            if place is not None and (place.is_whole or place.first <= _along(vehicle) <= place.last):
                rows.append(row)
                low.append(place.low)
                high.append(place.high)
        return rows, low, high


def only(positions: Positions, rows: Int[np.ndarray, " R"]) -> Positions:
    """The positions in these rows."""
    ids, xy, s, d = positions
    return tuple([ids[row] for row in rows.tolist()]), xy[rows], s[rows], d[rows]


def without_shadows(ids: Iterable[str]) -> tuple[str, ...]:
    """The ids without those of shadow vehicles."""
    return tuple(vehicle for vehicle in ids if not vehicle.startswith(SHADOW))
