"""Reading the positions of vehicles: of all, or of those near to given ones, of which as few as possible are read."""

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import chain, compress

import libsumo
import numpy as np
from jaxtyping import Float, Int

from cosim.world.road_frame import LanePlace, RoadFrame
from cosim.world.snapshot import NearbyFilter, is_near, row_of_ids, rows_of

SHADOW = "twin:"  # prefix of the ids of shadow vehicles; SUMO orders vehicles by id, so another one can change results
_RINGS = ((5.0, 150.0, 20.0, 300.0), (1.0, 30.0, 4.0, 60.0))
"""Which positions are read: (valid for [s], margin along the road [m], across it [m], and beyond spans of s [m]).

The positions of all vehicles are read every 5 s. Every second, only vehicles within the first margins of being near are
read. In between, only those within the second margins are read. No vehicle moves farther than its margin in that time.
"""
_NOWHERE = libsumo.constants.INVALID_DOUBLE_VALUE  # x of a vehicle that is off all lanes
_raw = libsumo._libsumo  # without libsumo's Python wrappers, which take as long again
_point, _lane, _along = _raw.vehicle_getPosition, _raw.vehicle_getLaneID, _raw.vehicle_getLanePosition
_time, _departed = _raw.simulation_getTime, _raw.simulation_getDepartedIDList
_TRACKED = 60.0  # [m] of s around the last known place of a vehicle, in which it is now
_LONGEST_TRACK = 1.5  # [s] since a vehicle was last seen, after which its last place says nothing
_ANYWHERE = LanePlace(-math.inf, math.inf)

# ids, world points [V, 2], s and d of some vehicles
Positions = tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]
NearRows = tuple[tuple[str, ...], Int[np.ndarray, " R"]]
"""Ids of vehicles, and their rows among others."""


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

    def update(self, departed: Sequence[str], arrived: Sequence[str], teleported: bool) -> None:
        """Take note of the vehicles that entered and left the net in a step, and whether any was teleported."""
        if teleported:
            self.forget()
        if self._ids is None:
            return
        if departed or arrived:
            self._ids, self._present = updated(self._ids, departed, arrived), None

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


@dataclass
class _Ring:
    """The vehicles that can come near to some others within some seconds, and those that can come into some spans."""

    near: NearbyFilter
    in_spans: tuple[str, ...] | None = None

    def update(self, entered: Sequence[str], gone: Sequence[str]) -> None:
        """Take note of the vehicles that entered and left the net in a step."""
        self.near.update(entered, gone)
        if self.in_spans is not None and (entered or gone):
            self.in_spans = updated(self.in_spans, entered, gone)


class PositionReader:
    """Reads positions in the running simulation, and remembers which vehicles were far from the ones last asked for."""

    def __init__(self, is_taken: Callable[[str], bool]) -> None:
        self._rings: list[_Ring] = []
        self._is_taken = is_taken
        self._last: dict[str, tuple[float, float]] = {}  # time [s] and s [m] of vehicles when they were last seen
        self._rows: tuple[tuple[str, ...], tuple[str, ...], NearRows] = (), (), ((), np.empty(0, dtype=int))
        self.known = KnownVehicles()

    def update(self, arrived: Sequence[str], teleported: bool) -> None:
        """Take note of the vehicles that entered and left the net in a step, and whether any was teleported."""
        for vehicle in arrived:
            self._last.pop(vehicle, None)
        departed = without_shadows(_departed())
        self.known.update(departed, arrived, teleported)
        for ring in self._rings:
            ring.update(departed, arrived)
        if teleported:
            self._rings = [ring for ring in self._rings if ring.in_spans is None]

    def forget(self) -> None:
        """Ask SUMO for everything again: steps were made that this reader took no note of."""
        self._rings.clear()
        self.known.forget()

    def of_all(self, road: RoadFrame) -> Positions:
        """The positions of all vehicles."""
        try:
            return self._read(road, self.known.ids)
        except libsumo.TraCIException:  # a vehicle vanished without having arrived
            self.known.forget()
            return self._read(road, self.known.ids)

    def of_nearby(self, road: RoadFrame, around: tuple[str, ...], lane_ahead: float) -> Positions:
        """The positions of the vehicles near to those `around`, and of some more; see `is_near` for `lane_ahead`."""
        rings = self._valid_rings(around, lane_ahead)
        try:
            found = self._read(road, rings[-1].near.ids) if rings else self.of_all(road)
        except libsumo.TraCIException:  # a vehicle vanished without having arrived
            rings.clear()
            found = self.of_all(road)
        for _, along, across, _ in _RINGS[len(rings) :]:
            near = is_near(found[2], found[3], rows_of(found[0], around), along, across, lane_ahead)
            found = only(found, np.flatnonzero(near))
            rings.append(_Ring(NearbyFilter(around, lane_ahead, found[0], _time())))
        return found

    def in_spans(
        self, road: RoadFrame, around: tuple[str, ...], lane_ahead: float, spans: Callable[[], Float[np.ndarray, "G 2"]]
    ) -> tuple[Positions, NearRows]:
        """The positions of the vehicles in some spans of s [m], each from its first to its second value, and some more.

        Also which of them `of_nearby` would find, if their positions are in the spans or near them.
        """
        rings = self._valid_rings(around, lane_ahead)
        if rings and rings[-1].in_spans is None:
            rings.clear()
        # Vehicles can come into the world of a road from elsewhere, and recorded vehicles appear anywhere.
        all_are_listed = road.places is None and self.known.can_be_kept
        try:
            found = self._read(road, rings[-1].in_spans or ()) if rings and all_are_listed else self.of_all(road)
        except libsumo.TraCIException:  # a vehicle vanished without having arrived
            rings.clear()
            found = self.of_all(road)
        near = only(found, self._near_rows(found[0], rings[-1].near.ids)[1]) if 0 < len(rings) < len(_RINGS) else found
        for _, along, across, beyond in _RINGS[len(rings) :]:
            is_inside = is_near(near[2], near[3], rows_of(near[0], around), along, across, lane_ahead)
            near = only(near, np.flatnonzero(is_inside))
            if all_are_listed:
                low, high = (spans() + np.array([-beyond, beyond])).T[:, :, None]
                found = only(found, np.flatnonzero(((found[2] >= low) & (found[2] <= high)).any(axis=0)))
            rings.append(_Ring(NearbyFilter(around, lane_ahead, near[0], _time()), found[0]))
        return found, self._near_rows(found[0], rings[-1].near.ids)

    def _near_rows(self, ids: tuple[str, ...], wanted: tuple[str, ...]) -> NearRows:
        """Those of the wanted vehicles that are among the ids, and their rows; kept for the next step."""
        if self._rows[0] is not ids or self._rows[1] is not wanted:
            row_of = row_of_ids(ids)
            names = tuple([vehicle for vehicle in wanted if vehicle in row_of])
            self._rows = ids, wanted, (names, np.array([row_of[vehicle] for vehicle in names], dtype=int))
        return self._rows[2]

    def _valid_rings(self, around: tuple[str, ...], lane_ahead: float) -> list[_Ring]:
        """The rings that still hold, from the widest one on; others are forgotten."""
        rings, now = self._rings, _time()
        while rings and not rings[-1].near.is_valid_for(around, lane_ahead, now - _RINGS[len(rings) - 1][0] + 1e-6):
            rings.pop()
        return rings

    def _read(self, road: RoadFrame, ids: tuple[str, ...]) -> Positions:
        """The positions of those vehicles that have one: SUMO lists a vehicle that left all lanes for a few steps more.

        Vehicles in another world than that of the road are left out.
        """
        xy = np.fromiter(chain.from_iterable(map(_point, ids)), float, 2 * len(ids)).reshape(-1, 2)
        somewhere = xy[:, 0] != _NOWHERE
        if not somewhere.all():
            ids, xy = tuple(compress(ids, somewhere)), xy[somewhere]
        if road.places is None:
            return ids, xy, *road.to_road(xy)
        rows, low, high = self._in_world(road.places, ids)
        ids, xy = tuple([ids[row] for row in rows]), xy[rows]
        s, d = road.to_road(xy, (np.array(low), np.array(high)))
        now = _time()
        self._last |= {vehicle: (now, at) for vehicle, at in zip(ids, s.tolist(), strict=True)}
        return ids, xy, s, d

    def _in_world(
        self, places: Mapping[str, LanePlace], ids: tuple[str, ...]
    ) -> tuple[list[int], list[float], list[float]]:
        """The rows of the vehicles in the world of the road, and the range of s [m] in which each of them is.

        The lane of a vehicle says where it is. That of a vehicle that a policy drives is SUMO's guess: it is where it
        was a moment ago. So is a vehicle beside all lanes.
        """
        rows, low, high, now = [], [], [], _time()
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


def updated(ids: tuple[str, ...], entered: Sequence[str], gone: Sequence[str]) -> tuple[str, ...]:
    """Ids in order, with those that entered and without those that are gone; most steps have few of either."""
    listed = list(ids)
    for vehicle in entered:
        row = bisect_left(listed, vehicle)
        if listed[row : row + 1] != [vehicle]:
            listed.insert(row, vehicle)
    for vehicle in gone:
        row = bisect_left(listed, vehicle)
        if listed[row : row + 1] == [vehicle]:
            del listed[row]
    return tuple(listed)


def only(positions: Positions, rows: Int[np.ndarray, " R"]) -> Positions:
    """The positions in these rows."""
    ids, xy, s, d = positions
    return tuple([ids[row] for row in rows.tolist()]), xy[rows], s[rows], d[rows]


def without_shadows(ids: Iterable[str]) -> tuple[str, ...]:
    """The ids without those of shadow vehicles."""
    return () if ids == () else tuple(vehicle for vehicle in ids if not vehicle.startswith(SHADOW))
