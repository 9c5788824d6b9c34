"""Reading the states of vehicles: of all, of a stretch of the road, or of those near to given ones."""

from collections.abc import Callable, Sequence
from itertools import chain

import libsumo
import numpy as np

from cosim.sumo.cache import CachedVehicleValues
from cosim.sumo.positions import PositionReader, Positions, only
from cosim.world.road_frame import RoadFrame, heading_of
from cosim.world.snapshot import LANE_AHEAD, Snapshot
from cosim.world.surroundings import Instant

# libsumo's functions without their Python wrappers, for what is read of every vehicle in every step: half the time
_raw = libsumo._libsumo
_angle, _lane = _raw.vehicle_getAngle, _raw.vehicle_getLaneID
_speed, _acceleration = _raw.vehicle_getSpeed, _raw.vehicle_getAcceleration


class StateReader:
    """Reads states in the running simulation.

    `sizes` are the lengths and widths [m] of vehicles, `is_taken` says whether SUMO does not drive a vehicle.
    """

    def __init__(self, sizes: CachedVehicleValues[tuple[float, float]], is_taken: Callable[[str], bool]) -> None:
        self.positions, self._sizes = PositionReader(is_taken), sizes
        self._sized: tuple[tuple[str, ...], np.ndarray, np.ndarray] = (), np.empty(0), np.empty(0)

    def snapshot(
        self, road: RoadFrame, around: Sequence[str] | None, lane_ahead: float, span: tuple[float, float] | None
    ) -> Snapshot:
        """See `cosim.sumo.simulation.Sumo.snapshot`."""
        if around is not None:
            return self._snapshot(self.positions.of_nearby(road, tuple(around), lane_ahead))
        everybody = self.positions.of_all(road)
        if span is not None:
            everybody = only(everybody, np.flatnonzero((everybody[2] >= span[0]) & (everybody[2] <= span[1])))
        return self._snapshot(everybody)

    def _snapshot(self, positions: Positions) -> Snapshot:
        ids, xy, s, d = positions
        angle, v, a = _read(ids)
        length, width = self._sizes_of(ids)
        lane, time = tuple(map(_lane, ids)), libsumo.simulation.getTime()
        return Snapshot(time, ids, xy, heading_of(angle), v, a, s, d, length, width, lane)

    def near_and_all(self, road: RoadFrame, around: Sequence[str]) -> tuple[Snapshot, Instant]:
        """What `snapshot` reads near to the vehicles `around`, and all vehicles as they are recorded, read once."""
        everybody = self.positions.of_all(road)
        ids, xy, s, d = everybody
        rows = self.positions.rows_nearby(everybody, tuple(around), LANE_AHEAD)
        angle, v, a = _read(ids)
        heading, (length, width), time = heading_of(angle), self._sizes_of(ids), libsumo.simulation.getTime()
        state = np.column_stack([s, d, xy, heading, v, a])
        names = tuple([ids[row] for row in rows.tolist()])
        lane = tuple(map(_lane, names))
        of_near = (of[rows] for of in (xy, heading, v, a, s, d, length, width))
        return Snapshot(time, names, *of_near, lane=lane), Instant(time, ids, state, length, width)

    def _sizes_of(self, ids: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Lengths and widths [m]; kept, as most steps have the same vehicles as the one before."""
        if ids is not self._sized[0] and ids != self._sized[0]:
            sizes = np.array([*chain.from_iterable(map(self._sizes.__getitem__, ids))], dtype=float).reshape(-1, 2)
            self._sized = ids, sizes[:, 0].copy(), sizes[:, 1].copy()
        return self._sized[1], self._sized[2]


def _read(ids: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles [deg], speeds [m/s] and accelerations [m/s²]."""
    angle, v, a = (np.fromiter(map(read, ids), float, len(ids)) for read in (_angle, _speed, _acceleration))
    return angle, v, a
