"""Reading the positions of vehicles: of all, or of those near to given ones, of which as few as possible are read."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain

import libsumo
import numpy as np
from jaxtyping import Int

from cosim.world.road_frame import LanePlace, RoadFrame
from cosim.world.snapshot import NearbyFilter, is_near, rows_of

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


class PositionReader:
    """Reads positions in the running simulation, and remembers which vehicles were far from the ones last asked for."""

    def __init__(self, is_taken: Callable[[str], bool]) -> None:
        self._rings: list[NearbyFilter] = []
        self._is_taken = is_taken
        self._last: dict[str, tuple[float, float]] = {}  # time [s] and s [m] of vehicles when they were last seen

    def update(self, arrived: Sequence[str]) -> None:
        """Take note of the vehicles that entered and left the net in a step."""
        for vehicle in arrived:
            self._last.pop(vehicle, None)
        if self._rings:
            departed = without_shadows(libsumo.simulation.getDepartedIDList())
            for ring in self._rings:
                ring.update(departed, arrived)

    def of_all(self, road: RoadFrame, span: tuple[float, float] | None = None) -> Positions:
        """The positions of all vehicles, or of those with s in `span` [m]."""
        found = self._read(road, without_shadows(libsumo.vehicle.getIDList()))
        if span is None:
            return found
        return _only(found, np.flatnonzero((found[2] >= span[0]) & (found[2] <= span[1])))

    def of_nearby(self, road: RoadFrame, around: tuple[str, ...], lane_ahead: float) -> Positions:
        """The positions of the vehicles near to those `around`, and of some more; see `is_near` for `lane_ahead`."""
        rings, now = self._rings, libsumo.simulation.getTime()
        while rings and not rings[-1].is_valid_for(around, lane_ahead, now - _RINGS[len(rings) - 1][0] + 1e-6):
            rings.pop()
        try:
            ids, xy, s, d = self._read(road, rings[-1].ids) if rings else self.of_all(road)
        except libsumo.TraCIException:  # a vehicle vanished without having arrived
            rings.clear()
            return self.of_nearby(road, around, lane_ahead)
        for _, along, across in _RINGS[len(rings) :]:
            near = is_near(s, d, rows_of(ids, around), along, across, lane_ahead)
            ids, xy, s, d = _only((ids, xy, s, d), np.flatnonzero(near))
            rings.append(NearbyFilter(around, lane_ahead, ids, now))
        return ids, xy, s, d

    def _read(self, road: RoadFrame, ids: tuple[str, ...]) -> Positions:
        """The positions of those vehicles that have one: SUMO lists a vehicle that left all lanes for a few steps more.

        Vehicles in another world than that of the road are left out.
        """
        points = [*map(_point, ids)]
        if _NOWHERE in points:
            ids = tuple(v for v, point in zip(ids, points, strict=True) if point != _NOWHERE)
            points = [point for point in points if point != _NOWHERE]
        xy = np.array([*chain.from_iterable(points)], dtype=float).reshape(-1, 2)
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


def _only(positions: Positions, rows: Int[np.ndarray, " R"]) -> Positions:
    ids, xy, s, d = positions
    return tuple([ids[row] for row in rows.tolist()]), xy[rows], s[rows], d[rows]


def without_shadows(ids: Iterable[str]) -> tuple[str, ...]:
    """The ids without those of shadow vehicles."""
    return tuple(vehicle for vehicle in ids if not vehicle.startswith(SHADOW))
