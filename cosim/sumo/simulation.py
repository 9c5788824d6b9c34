"""The running simulation: start, step, read, command, close.

One guarded simulation per process. What a command changes and when it is seen is written in docs/coupling.md.
Measured facts behind the choices here: plain getters are faster than subscriptions in libsumo; a vehicle moved by
`moveToXY` stands exactly where it was put only with the keep-route bits used below; its reported speed is exactly the
commanded one only if `setSpeed` goes with it and the safety checks are off.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import libsumo
import numpy as np

from cosim.sumo.cache import CachedAnswers
from cosim.sumo.drivers import Drivers
from cosim.sumo.net import Net
from cosim.world.road_frame import RoadFrame, heading_of, sumo_angle_of
from cosim.world.snapshot import LANE_AHEAD, NearbyFilter, Snapshot, StepReport, near, rows_of

_NO_CHECKS = 0  # speed mode: SUMO neither bounds nor corrects the commanded speed
_NO_CHANGES = 0  # lane-change mode: SUMO never changes the vehicle's lane
_KEEP_ROUTE_EXACT_POSITION = 3  # moveToXY: keep the route (1) and do not snap to the lane (2)
_GIVEN_LANE_EXACT_POSITION = 2  # moveToXY: on the edge and lane that the call names, and do not snap to it
_RINGS = ((5.0, 150.0, 20.0), (1.0, 30.0, 4.0))
"""Who is asked where he is: every 5 s everybody, every second those who were at most 150 m along and 20 m across the
road too far away to be near, in between those who were 30 m and 4 m. Nobody comes nearer than that in so little time.
"""
_TWIN = "twin:"  # prefix of the ids of twins
_NOWHERE = (libsumo.constants.INVALID_DOUBLE_VALUE,) * 2  # where a vehicle is that is off all lanes

# libsumo's own functions without their Python wrappers, for what is asked of every vehicle in every step: half the time
_raw = libsumo._libsumo
_point, _angle, _lane = _raw.vehicle_getPosition, _raw.vehicle_getAngle, _raw.vehicle_getLaneID
_speed, _acceleration = _raw.vehicle_getSpeed, _raw.vehicle_getAcceleration
_set_speed, _move = _raw.vehicle_setSpeed, _raw.vehicle_moveToXY
_NATIVE_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)


class SumoError(RuntimeError):
    """SUMO refused or failed; the message is SUMO's own."""


# ids, world points [V, 2], s and d of some vehicles
_Positions = tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]


class Sumo:
    """The running simulation, with its network and SUMO's drivers in it. Obtained from `sumo(...)` only."""

    def __init__(self) -> None:
        self._sizes = CachedAnswers(lambda v: (libsumo.vehicle.getLength(v), libsumo.vehicle.getWidth(v)))
        self._sized: tuple[tuple[str, ...], np.ndarray, np.ndarray] = ((), np.empty(0), np.empty(0))
        self.net, self.drivers = Net(), Drivers(self._sizes)
        self._modes: dict[str, tuple[int, int]] = {}  # (speed mode, lane-change mode) before take-over
        self._twins: set[str] = set()  # vehicles that have one
        self._rings: list[NearbyFilter] = []  # what the last snapshots around vehicles found, see _RINGS
        self._commanded: set[str] = set()  # vehicles with a moveToXY since the last step
        self.before_step: Callable[[], None] | None = None  # called by `step` before anything moves

    def step(self) -> StepReport:
        """Advance by one step length."""
        if self.before_step is not None:
            self.before_step()
        libsumo.simulationStep()
        self._commanded.clear()
        arrived = libsumo.simulation.getArrivedIDList()
        if self._rings:
            departed = _real(libsumo.simulation.getDepartedIDList())
            for ring in self._rings:
                ring.stepped(departed, arrived)
        pairs = [(hit.collider, hit.victim) for hit in libsumo.simulation.getCollisions()]
        return StepReport(
            time=libsumo.simulation.getTime(),
            arrived=_real(arrived),
            teleported=_real(libsumo.simulation.getStartingTeleportIDList()),
            collisions=tuple(pair for pair in pairs if len(_real(pair)) == 2),
        )

    def snapshot(
        self, road: RoadFrame, around: Sequence[str] | None = None, lane_ahead: float = LANE_AHEAD
    ) -> Snapshot:
        """Read every vehicle on the road network, or only those who can be near the vehicles `around` (see `near`)."""
        if around is None:
            ids, xy, s, d = self._positions(road, _real(libsumo.vehicle.getIDList()))
        else:
            ids, xy, s, d = self._positions_around(road, tuple(around), lane_ahead)
        if ids != self._sized[0]:
            sizes = np.array([*chain.from_iterable(map(self._sizes.__getitem__, ids))], dtype=float).reshape(-1, 2)
            self._sized = ids, sizes[:, 0].copy(), sizes[:, 1].copy()
        angle, v, a = np.array([[*map(read, ids)] for read in (_angle, _speed, _acceleration)], dtype=float)
        return Snapshot(
            time=libsumo.simulation.getTime(),
            ids=ids,
            xy=xy,
            heading=heading_of(angle),
            v=v,
            a=a,
            s=s,
            d=d,
            length=self._sized[1],
            width=self._sized[2],
            lane=tuple(map(_lane, ids)),
        )

    def _positions(self, road: RoadFrame, ids: tuple[str, ...]) -> _Positions:
        """Of those that are somewhere: SUMO keeps a vehicle that left all lanes on its list for a few steps."""
        points = [*map(_point, ids)]
        if _NOWHERE in points:
            ids = tuple(v for v, point in zip(ids, points, strict=True) if point != _NOWHERE)
            points = [point for point in points if point != _NOWHERE]
        xy = np.array([*chain.from_iterable(points)], dtype=float).reshape(-1, 2)
        return ids, xy, *road.to_road(xy)

    def _positions_around(self, road: RoadFrame, around: tuple[str, ...], lane_ahead: float) -> _Positions:
        """Asks where they are only those who can have come near since they were asked last."""
        rings, now = self._rings, libsumo.simulation.getTime()
        while rings and not rings[-1].holds(around, lane_ahead, now - _RINGS[len(rings) - 1][0] + 1e-6):
            rings.pop()
        try:
            ids, xy, s, d = self._positions(road, rings[-1].ids if rings else _real(libsumo.vehicle.getIDList()))
        except libsumo.TraCIException:  # somebody vanished without having arrived
            rings.clear()
            return self._positions_around(road, around, lane_ahead)
        for _, along, across in _RINGS[len(rings) :]:
            rows = np.flatnonzero(near(s, d, rows_of(ids, around), along, across, lane_ahead))
            ids, xy, s, d = tuple([ids[row] for row in rows.tolist()]), xy[rows], s[rows], d[rows]
            rings.append(NearbyFilter(around, lane_ahead, ids, now))
        return ids, xy, s, d

    def take(self, vehicle: str) -> None:
        """Take a vehicle from SUMO's drivers; from now on it must be commanded in every step."""
        api = libsumo.vehicle
        self._modes.setdefault(vehicle, (api.getSpeedMode(vehicle), api.getLaneChangeMode(vehicle)))
        api.setSpeedMode(vehicle, _NO_CHECKS)
        api.setLaneChangeMode(vehicle, _NO_CHANGES)

    def command(self, vehicle: str, x: float, y: float, heading: float, speed: float, lane: str = "") -> None:
        """Where the vehicle's front bumper shall stand after the next step, its heading [rad] and speed [m/s].

        SUMO books the vehicle on the nearest lane, or on `lane`, which must be one that passes there.
        """
        if not math.isfinite(x + y + heading + speed):
            raise SumoError(
                f"refused a non-finite command for {vehicle}: x={x}, y={y}, heading={heading}, speed={speed}"
            )
        _set_speed(vehicle, speed)
        if lane:
            edge, _, index = lane.rpartition("_")
            _move(vehicle, edge, int(index), x, y, sumo_angle_of(heading), _GIVEN_LANE_EXACT_POSITION)
        else:
            _move(vehicle, "", -1, x, y, sumo_angle_of(heading), _KEEP_ROUTE_EXACT_POSITION)
        self._commanded.add(vehicle)

    def is_commanded(self, vehicle: str) -> bool:
        """Whether the vehicle has a command for the coming step."""
        return vehicle in self._commanded

    def owns(self, vehicle: str) -> bool:
        """Whether the vehicle was taken and not given back since."""
        return vehicle in self._modes

    def add(self, vehicle: str, route: str, kind: str, length: float, width: float, speed: float) -> None:
        """Announce a vehicle of that type and size; it enters the net where its first command puts it."""
        libsumo.vehicle.add(vehicle, route, kind, departSpeed=f"{speed:.3f}")
        libsumo.vehicle.setLength(vehicle, length)
        libsumo.vehicle.setWidth(vehicle, width)

    def place_shadow(self, vehicle: str, x: float, y: float, heading: float, speed: float, lane: str) -> None:
        """Put a copy of the vehicle on a lane, for others to see; no snapshot, report or count shows it."""
        twin, api = _TWIN + vehicle, libsumo.vehicle
        if vehicle not in self._twins:
            api.add(twin, api.getRouteID(vehicle), api.getTypeID(vehicle))
            api.setSpeedMode(twin, _NO_CHECKS)
            api.setLaneChangeMode(twin, _NO_CHANGES)
            self._twins.add(vehicle)
        self.command(twin, x, y, heading, speed, lane)

    def remove_shadow(self, vehicle: str) -> None:
        """Take the vehicle's twin away, if there is one."""
        if vehicle in self._twins:
            self._twins.discard(vehicle)
            libsumo.vehicle.remove(_TWIN + vehicle)

    def remove(self, vehicle: str) -> None:
        """Take a vehicle out of the simulation, for good and at once."""
        self._modes.pop(vehicle, None)
        libsumo.vehicle.remove(vehicle)

    def release(self, vehicle: str) -> None:
        """Hand a vehicle back: SUMO's own speed control and the modes it had before."""
        speed_mode, lane_change_mode = self._modes.pop(vehicle)
        libsumo.vehicle.setSpeed(vehicle, -1)
        libsumo.vehicle.setSpeedMode(vehicle, speed_mode)
        libsumo.vehicle.setLaneChangeMode(vehicle, lane_change_mode)

    def route(self, vehicle: str) -> tuple[str, ...]:
        """Edges of a vehicle's route."""
        return tuple(libsumo.vehicle.getRoute(vehicle))

    def waiting(self) -> int:
        """How many vehicles should have entered the net and could not yet."""
        return len(_real(libsumo.simulation.getPendingVehicles()))

    def _close(self) -> None:
        if self._commanded:  # closing and restarting with a pending moveToXY crashes SUMO
            libsumo.simulationStep()
        libsumo.close()


def _real(ids: Iterable[str]) -> tuple[str, ...]:
    """Without twins."""
    return tuple(vehicle for vehicle in ids if not vehicle.startswith(_TWIN))


_running = False


@contextmanager
def sumo(arguments: Sequence[str], log: Path) -> Iterator[Sumo]:
    """Run SUMO in this process with these command-line arguments; `log` is the file its `--error-log` names.

    Raises SumoError, with SUMO's own message, where SUMO refuses; a second simulation in one process is refused here,
    because libsumo would silently discard the first.
    """
    global _running
    if _running:
        raise SumoError("a simulation is already running in this process; run the second one in a process of its own")
    _running = True
    try:
        libsumo.start(["sumo", *arguments])
        world = Sumo()
        try:
            yield world
        finally:
            world._close()
    except _NATIVE_ERRORS as error:
        raise SumoError(_native_message(error, log)) from error
    finally:
        _running = False


def version() -> str:
    """SUMO's version, e.g. "1.28.0"."""
    return libsumo.__version__


def _native_message(error: Exception, log: Path) -> str:
    """The last error lines SUMO wrote, or the exception's own text."""
    written = log.read_text(errors="replace").splitlines() if log.is_file() else []
    errors = [line.strip() for line in written if line.startswith("Error")]
    return "; ".join(errors[-3:]) or str(error)
