"""Reading the states of vehicles: of all, of a stretch of the road, or of those near to given ones."""

import math
from collections.abc import Callable, Collection, Sequence
from itertools import chain, repeat

import libsumo
import numpy as np
from jaxtyping import Float

from cosim.sumo.cache import CachedVehicleValues
from cosim.sumo.positions import PositionReader, Positions, only
from cosim.world.road_frame import RoadFrame, heading_of
from cosim.world.snapshot import COLUMNS, LANE_AHEAD, Snapshot, row_of_ids
from cosim.world.surroundings import Instant

# libsumo's functions without their Python wrappers, for what is read of every vehicle in every step: half the time
_raw = libsumo._libsumo
_angle, _lane, _time = _raw.vehicle_getAngle, _raw.vehicle_getLaneID, _raw.simulation_getTime
_speed, _acceleration = _raw.vehicle_getSpeed, _raw.vehicle_getAcceleration


class StateReader:
    """Reads states in the running simulation.

    `sizes` are the lengths and widths [m] of vehicles, `taken` are the vehicles that SUMO does not drive alone, and
    `is_taken` says whether SUMO does not drive a vehicle at all.
    """

    def __init__(
        self,
        sizes: CachedVehicleValues[tuple[float, float]],
        taken: Collection[str],
        is_taken: Callable[[str], bool],
    ) -> None:
        self.positions, self._sizes, self._taken = PositionReader(is_taken), sizes, taken
        self._sized: tuple[tuple[str, ...], np.ndarray] = (), np.empty((2, 0))
        self._step = libsumo.simulation.getDeltaT()
        self.is_euler = libsumo.simulation.getOption("step-method.ballistic") == "false"
        self._last: tuple[float, tuple[str, ...], np.ndarray] = -math.inf, (), np.empty(0)  # time, ids, speeds

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
        ids, time = positions[0], _time()
        return Snapshot.of_block(time, ids, self._block(positions, time), self._sizes_of(ids), tuple(map(_lane, ids)))

    def near_and_recorded(
        self, road: RoadFrame, around: Sequence[str], spans: Callable[[], Float[np.ndarray, "G 2"]]
    ) -> tuple[Snapshot, Instant]:
        """See `cosim.sumo.simulation.Sumo.near_and_recorded`."""
        time = _time()
        recorded, (names, rows) = self.positions.in_spans(road, tuple(around), LANE_AHEAD, spans)
        block, sizes = self._block(recorded, time), self._sizes_of(recorded[0])
        near = Snapshot.of_block(time, names, block[:, rows], sizes[:, rows], tuple(map(_lane, names)))
        return near, Instant(time, recorded[0], block.T, *sizes)

    def _block(self, positions: Positions, time: float) -> Float[np.ndarray, "C V"]:
        """The features of COLUMNS of these vehicles, a row for each feature."""
        ids, xy, s, d = positions
        n = len(ids)
        block = np.empty((len(COLUMNS), n))
        block[0], block[1], block[2:4] = s, d, xy.T
        block[4] = heading_of(np.fromiter(map(_angle, ids), float, n))
        block[5] = v = np.fromiter(map(_speed, ids), float, n)
        block[6] = self._accelerations(ids, v, time)
        return block

    def _accelerations(self, ids: tuple[str, ...], v: Float[np.ndarray, " V"], time: float) -> Float[np.ndarray, " V"]:
        """Accelerations [m/s²] as SUMO has them. Where SUMO alone drives, they are not read but follow from speeds.

        SUMO's acceleration is the change of the speed in a step divided by the step, bit for bit, except that of a
        commanded vehicle, which is 0 where a command puts the vehicle on another lane. With SUMO's ballistic update it
        is another number where a vehicle stops within a step.
        """
        (at, before, v_before), self._last = self._last, (time, ids, v)
        if not self.is_euler or abs(time - at - self._step) > 1e-6:  # the last reading was not one step ago
            return np.fromiter(map(_acceleration, ids), float, len(ids))
        row_of, unknown = row_of_ids(ids), []
        if before is not ids and before != ids:
            row_before = row_of_ids(before)
            rows = np.fromiter(map(row_before.get, ids, repeat(-1)), int, len(ids))
            unknown = np.flatnonzero(rows < 0).tolist()
            v_before = np.append(v_before, 0.0)[rows]
        a = (v - v_before) / self._step
        for row in unknown:
            a[row] = _acceleration(ids[row])
        for vehicle in self._taken:
            if vehicle in row_of:
                a[row_of[vehicle]] = _acceleration(vehicle)
        return a

    def _sizes_of(self, ids: tuple[str, ...]) -> Float[np.ndarray, "2 V"]:
        """Lengths and widths [m]; kept, as most steps have the same vehicles as the one before."""
        if ids is not self._sized[0] and ids != self._sized[0]:
            sizes = np.array([*chain.from_iterable(map(self._sizes.__getitem__, ids))], dtype=float)
            self._sized = ids, sizes.reshape(-1, 2).T.copy()
        return self._sized[1]
