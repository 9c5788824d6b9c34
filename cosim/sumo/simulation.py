"""The running simulation: start, step, read, command, close.

There is one simulation per process. docs/coupling.md says what a command changes and when that is seen. The choices
made here rest on measurements. In libsumo plain getters are faster than subscriptions. A vehicle moved by `moveToXY` is
exactly where it was put only with the keep-route bits used below. Its reported speed is exactly the commanded one only
if `setSpeed` is called as well and the safety checks are off.
"""

import math
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path
from tempfile import TemporaryFile

import libsumo
import numpy as np
from jaxtyping import Float

from cosim.sumo.bends import slow_before_bends
from cosim.sumo.cache import CachedVehicleValues
from cosim.sumo.drivers import Drivers
from cosim.sumo.net import Net
from cosim.sumo.path_encoding import use_utf8_paths
from cosim.sumo.positions import SHADOW, without_shadows
from cosim.sumo.speed_limits import set_limits, speeds_on
from cosim.sumo.states import StateReader
from cosim.world.road_frame import RoadFrame, sumo_angle_of
from cosim.world.snapshot import LANE_AHEAD, Snapshot, StepReport
from cosim.world.surroundings import Instant

_NO_CHECKS = 0  # speed mode: SUMO neither bounds nor corrects the commanded speed
_OWN_SPEED = -1.0  # setSpeed: SUMO's driver decides on the speed again
_NO_CHANGES = 0  # lane-change mode: SUMO never changes the vehicle's lane
_ACCELERATION_CHECKS = 0b110  # speed mode: SUMO bounds acceleration and braking by those of the driver
_KEEP_ROUTE_EXACT_POSITION = 3  # moveToXY: keep the route (1) and do not snap to the lane (2)
_GIVEN_LANE_EXACT_POSITION = 2  # moveToXY: on the edge and lane that the call names, and do not snap to it

# libsumo's functions without their Python wrappers, for what is called often: half the time
_raw = libsumo._libsumo
_set_speed, _move, _time = _raw.vehicle_setSpeed, _raw.vehicle_moveToXY, _raw.simulation_getTime
_arrived, _collisions = _raw.simulation_getArrivedIDList, _raw.simulation_getCollisions
_teleporting, _teleported = _raw.simulation_getStartingTeleportIDList, _raw.simulation_getEndingTeleportIDList
_NATIVE_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)


class SumoError(RuntimeError):
    """SUMO refused or failed; the message is SUMO's own."""


class Sumo:
    """The running simulation, with its network (`net`) and SUMO's drivers (`drivers`). Made by `sumo(...)` only."""

    def __init__(self) -> None:
        self._sizes = CachedVehicleValues(lambda v: (libsumo.vehicle.getLength(v), libsumo.vehicle.getWidth(v)))
        self.net, self.drivers = Net(), Drivers(self._sizes)
        self._modes: dict[str, tuple[int, int]] = {}  # (speed mode, lane-change mode) before take-over
        self._states = StateReader(self._sizes, self._modes, self.is_taken)
        self._known = self._states.positions.known
        self._returning: dict[str, tuple[float, float]] = {}  # (time headway, minimum gap) before the hand-back
        self._shadowed: set[str] = set()  # vehicles that have a shadow vehicle
        self._commanded: set[str] = set()  # vehicles with a moveToXY since the last step
        self.before_step: Callable[[], None] | None = None  # called by `step` before anything moves
        self.teleports = 0  # vehicles that SUMO has teleported so far
        self.collision_steps = 0  # steps so far with a collision in SUMO's list

    def step(self) -> StepReport:
        """Advance by one step."""
        if self.before_step is not None:
            self.before_step()
        libsumo.simulationStep()
        self._commanded.clear()
        self._states.positions.update(_arrived(), bool(_teleporting() or _teleported()))
        return self._report()

    def after_other_steps(self, *, reported: bool) -> StepReport | None:
        """Take note of steps that compiled code has made; returns the report of the last one if asked for.

        Nobody was teleported, and nothing collided, in those before.
        """
        self._commanded.clear()
        self._states.positions.forget()
        return self._report() if reported else None

    def _report(self) -> StepReport:
        arrived, begun, hits = _arrived(), _teleporting(), _collisions()
        pairs = [(hit.collider, hit.victim) for hit in hits] if hits else ()
        report = StepReport(
            time=_time(),
            arrived=without_shadows(arrived),
            teleported=without_shadows(begun),
            collisions=tuple(pair for pair in pairs if len(without_shadows(pair)) == 2),
        )
        self.teleports += len(report.teleported)
        self.collision_steps += bool(report.collisions)
        return report

    def snapshot(
        self,
        road: RoadFrame,
        around: Sequence[str] | None = None,
        lane_ahead: float = LANE_AHEAD,
        span: tuple[float, float] | None = None,
    ) -> Snapshot:
        """Read all vehicles, or those with s in `span` [m], or those near to the vehicles `around` and some more.

        `lane_ahead` [m] is the distance along the lane that counts as near (see `is_near`).
        """
        return self._states.snapshot(road, around, lane_ahead, span)

    def near_and_recorded(
        self, road: RoadFrame, around: Sequence[str], spans: Callable[[], Float[np.ndarray, "G 2"]]
    ) -> tuple[Snapshot, Instant]:
        """The snapshot of the vehicles near to those `around` and some more, and those to record, read once.

        The latter are all vehicles in some spans of s [m] and some more; every span begins at its first value, ends at
        its second one, and moves slower than 10 m per step. All vehicles `around` are to be in a span. The spans are
        asked for where they are needed, which is once in a second.
        """
        return self._states.near_and_recorded(road, around, spans)

    def take(self, vehicle: str) -> None:
        """Take a vehicle from SUMO's drivers; from now on it must be commanded in every step."""
        api = libsumo.vehicle
        self._modes.setdefault(vehicle, (api.getSpeedMode(vehicle), api.getLaneChangeMode(vehicle)))
        self._returning.pop(vehicle, None)
        api.setSpeedMode(vehicle, _NO_CHECKS)
        api.setLaneChangeMode(vehicle, _NO_CHANGES)

    def command(self, vehicle: str, x: float, y: float, heading: float, speed: float, lane: str = "") -> None:
        """Set the position (x, y) [m] of the front bumper, heading [rad] and speed [m/s] after the next step.

        SUMO assigns the vehicle to the nearest lane, or to `lane`, which must pass there. Raises SumoError for
        non-finite numbers.
        """
        if not math.isfinite(x + y + heading + speed):
            raise SumoError(
                f"refused a non-finite command for {vehicle}: x={x}, y={y}, heading={heading}, speed={speed};"
                " the policy or its dynamics returned a number that is not finite"
            )
        _set_speed(vehicle, speed)
        if lane:
            edge, _, index = lane.rpartition("_")
            _move(vehicle, edge, int(index), x, y, sumo_angle_of(heading), _GIVEN_LANE_EXACT_POSITION)
        else:
            _move(vehicle, "", -1, x, y, sumo_angle_of(heading), _KEEP_ROUTE_EXACT_POSITION)
        self._commanded.add(vehicle)

    def command_all(
        self,
        vehicles: Sequence[str],
        xy: Float[np.ndarray, "K 2"],
        heading: Float[np.ndarray, " K"],
        speed: Float[np.ndarray, " K"],
        lanes: Mapping[str, str],
    ) -> None:
        """`command` for several vehicles at once, on the given `lanes` where they name one that is not ""."""
        speeds, headings, (xs, ys) = speed.tolist(), heading.tolist(), xy.T.tolist()
        if any(lanes.values()) or not math.isfinite(sum(xs) + sum(ys) + sum(headings) + sum(speeds)):
            for vehicle, *pose in zip(vehicles, xs, ys, headings, speeds, strict=True):
                self.command(vehicle, *pose, lane=lanes.get(vehicle, ""))
            return
        options = repeat(""), repeat(-1), xs, ys, map(sumo_angle_of, headings), repeat(_KEEP_ROUTE_EXACT_POSITION)
        deque(map(_set_speed, vehicles, speeds), maxlen=0)  # `deque` calls them all, in less time than a loop
        deque(map(_move, vehicles, *options), maxlen=0)
        self._commanded.update(vehicles)

    def is_commanded(self, vehicle: str) -> bool:
        """Whether the vehicle has a command for the coming step."""
        return vehicle in self._commanded

    @property
    def is_euler(self) -> bool:
        """Whether accelerations follow from speeds: SUMO's update of positions is not the ballistic one."""
        return self._states.is_euler

    @property
    def known_ids(self) -> tuple[str, ...]:
        """The ids of all vehicles on the net, in order; one that left all lanes may be among them."""
        return self._known.ids

    @property
    def taken(self) -> tuple[str, ...]:
        """The vehicles that SUMO's drivers do not drive alone: those taken, and those on their way back."""
        return tuple(self._modes)

    def is_taken(self, vehicle: str) -> bool:
        """Whether the vehicle was taken and has not been handed back since."""
        return vehicle in self._modes and vehicle not in self._returning

    def add(self, vehicle: str, route: str, kind: str, length: float, width: float, speed: float) -> None:
        """Add a vehicle of the type `kind` [m, m/s]; it enters the net where its first command puts it.

        A driver who is found faster than it would want to drive wants that speed, as SUMO lets it depart only then.
        """
        self._known.can_be_kept = False  # it is on the net from its first command on, without having departed
        try:
            libsumo.vehicle.add(vehicle, route, kind, departSpeed=f"{speed:.3f}")
        except libsumo.TraCIException:
            libsumo.vehicle.add(vehicle, route, kind, departSpeed="0")
            limit = libsumo.lane.getMaxSpeed(f"{libsumo.vehicle.getRoute(vehicle)[0]}_0")
            libsumo.vehicle.setSpeedFactor(vehicle, max(libsumo.vehicle.getSpeedFactor(vehicle), speed / limit))
        libsumo.vehicle.setLength(vehicle, length)
        libsumo.vehicle.setWidth(vehicle, width)

    def place_shadow(self, vehicle: str, x: float, y: float, heading: float, speed: float, lane: str) -> None:
        """Put a shadow of the vehicle on a lane, to which others react; no snapshot, report or count shows it."""
        self.add_shadow(vehicle)
        self.command(SHADOW + vehicle, x, y, heading, speed, lane)

    def add_shadow(self, vehicle: str) -> None:
        """Add the shadow of a vehicle, if it has none; it must be put somewhere before the next step."""
        shadow, api = SHADOW + vehicle, libsumo.vehicle
        if vehicle in self._shadowed:
            return
        # a headway of its own gives a vehicle a type of its own, which SUMO deletes with any vehicle that has it
        kind = api.getTypeID(vehicle).removesuffix(f"@{vehicle}")
        api.add(shadow, self._shadow_route(vehicle), kind)
        api.setSpeedMode(shadow, _NO_CHECKS)
        api.setLaneChangeMode(shadow, _NO_CHANGES)
        self._shadowed.add(vehicle)

    def has_shadow(self, vehicle: str) -> bool:
        """Whether the vehicle has a shadow."""
        return vehicle in self._shadowed

    def _shadow_route(self, vehicle: str) -> str:
        """The id of a route for the vehicle's shadow; SUMO forgets the ids of routes that belong to one vehicle."""
        route = libsumo.vehicle.getRouteID(vehicle)
        if route in libsumo.route.getIDList():
            return route
        own = f"{SHADOW}{route}"
        if own not in libsumo.route.getIDList():
            libsumo.route.add(own, libsumo.vehicle.getRoute(vehicle))
        return own

    def remove_shadow(self, vehicle: str) -> None:
        """Remove the vehicle's shadow, if it has one."""
        if vehicle in self._shadowed:
            self._shadowed.discard(vehicle)
            libsumo.vehicle.remove(SHADOW + vehicle)

    def remove(self, vehicle: str) -> None:
        """Remove a vehicle from the simulation, at once."""
        self._modes.pop(vehicle, None)
        self._returning.pop(vehicle, None)
        self._known.forget()
        libsumo.vehicle.remove(vehicle)

    def begin_release(self, vehicle: str) -> None:
        """Let SUMO move a taken vehicle along its lane again; `guide` must follow before every step until `release`."""
        self._returning[vehicle] = libsumo.vehicle.getTau(vehicle), libsumo.vehicle.getMinGap(vehicle)

    def set_headway(self, vehicle: str, headway: float, min_gap: float) -> None:
        """Set the time headway [s] and the minimum gap [m] that the driver of a returning vehicle wants."""
        libsumo.vehicle.setTau(vehicle, headway)
        libsumo.vehicle.setMinGap(vehicle, min_gap)

    def guide(self, vehicle: str, speed: float, lateral: float, *, safely: bool) -> None:
        """Set the speed [m/s] of a returning vehicle after the next step and its offset [m] to the left in its lane.

        In left-hand traffic SUMO takes the offset to the right, although it tells that of a placed vehicle to the left.
        With `safely` SUMO drives slower where its own safe speed is lower.
        """
        mode = self._modes[vehicle][0] & ~_ACCELERATION_CHECKS if safely else _NO_CHECKS
        libsumo.vehicle.setSpeedMode(vehicle, mode)
        libsumo.vehicle.setLateralLanePosition(vehicle, lateral)
        _set_speed(vehicle, speed)

    def allow_lane_changes(self, vehicle: str) -> None:
        """Let a returning vehicle change lanes as before the take-over."""
        libsumo.vehicle.setLaneChangeMode(vehicle, self._modes[vehicle][1])

    def release(self, vehicle: str) -> None:
        """Hand a vehicle back to SUMO's driver, with the modes and the headway that it had before the take-over."""
        speed_mode, lane_change_mode = self._modes.pop(vehicle)
        if vehicle in self._returning:
            headway, min_gap = self._returning.pop(vehicle)
            libsumo.vehicle.setTau(vehicle, headway)
            libsumo.vehicle.setMinGap(vehicle, min_gap)
        libsumo.vehicle.setSpeed(vehicle, _OWN_SPEED)
        libsumo.vehicle.setSpeedMode(vehicle, speed_mode)
        libsumo.vehicle.setLaneChangeMode(vehicle, lane_change_mode)

    def forbid_lane_changes(self, vehicle: str) -> None:
        """Let SUMO's driver of a vehicle keep its lane from now on."""
        libsumo.vehicle.setLaneChangeMode(vehicle, _NO_CHANGES)

    def speeds(self, vehicles: Iterable[str]) -> dict[str, float]:
        """Speeds [m/s] of those of the vehicles that are in the simulation."""
        present = self._known.present
        return {vehicle: _raw.vehicle_getSpeed(vehicle) for vehicle in vehicles if vehicle in present}

    def ask_for_speeds(self, vehicles: Iterable[str], speeds: Mapping[str, float]) -> None:
        """Ask SUMO's drivers of these vehicles for the given speeds [m/s] in the next step.

        A driver keeps to its limits of acceleration and braking, and never exceeds the speed that is safe behind its
        leader. A driver without a given speed decides by itself. Absent vehicles and those taken are left alone.
        """
        free = self._known.present - self._modes.keys()
        for vehicle in vehicles:
            if vehicle in free:
                _set_speed(vehicle, speeds.get(vehicle, _OWN_SPEED))

    def route_ahead(self, vehicle: str) -> tuple[str, ...]:
        """Edges of a vehicle's route from the one it is on; on a junction, from the one it comes from."""
        return tuple(libsumo.vehicle.getRoute(vehicle)[max(libsumo.vehicle.getRouteIndex(vehicle), 0) :])

    def slow_before_bends(self, friction: float) -> None:
        """Let SUMO's drivers slow down before bends, on a road with this coefficient of friction."""
        slow_before_bends(friction)

    def speeds_on(self, edges: Sequence[str]) -> tuple[float, float]:
        """The sum of the speeds [m/s] of the vehicles on these edges, and their number."""
        return speeds_on(edges)

    def set_limits(self, lanes: Sequence[str], limits: Sequence[float]) -> None:
        """Set the speed limit [m/s] of each lane, from the next step on."""
        set_limits(lanes, limits)

    def waiting(self) -> int:
        """Number of vehicles that could not enter the net at their departure time and still wait."""
        return len(without_shadows(libsumo.simulation.getPendingVehicles()))

    def _close(self) -> None:
        if self._commanded:  # closing and restarting with a pending moveToXY crashes SUMO
            libsumo.simulationStep()
        libsumo.close()


_running = False


@contextmanager
def sumo(arguments: Sequence[str], log: Path) -> Iterator[Sumo]:
    """Run SUMO in this process with these command-line arguments; `log` is the file its `--error-log` names.

    Raises SumoError with SUMO's own message where SUMO refuses. Also raises it for a second simulation in one process,
    because libsumo would silently discard the first.
    """
    global _running
    if _running:
        raise SumoError("a simulation is already running in this process; run the second one in a process of its own")
    _running = True
    try:
        with sumo_errors(log):
            use_utf8_paths()
            _start(arguments, log)
            world = Sumo()
            try:
                yield world
            finally:
                world._close()
    finally:
        _running = False


@contextmanager
def sumo_errors(log: Path) -> Iterator[None]:
    """Turn what libsumo raises into SumoError with SUMO's own message from its log."""
    try:
        yield
    except _NATIVE_ERRORS as error:
        raise SumoError(_native_message(error, log)) from error


def _start(arguments: Sequence[str], log: Path) -> None:
    """Start SUMO. What it prints while it fails to start is in the SumoError: its error log is still empty then."""
    sys.stderr.flush()
    with TemporaryFile(dir=log.parent) as printed:
        kept = os.dup(2)
        os.dup2(printed.fileno(), 2)
        try:
            libsumo.start(["sumo", *arguments])
        except _NATIVE_ERRORS as error:
            printed.seek(0)
            lines = [line.strip() for line in printed.read().decode(errors="replace").splitlines()]
            errors = [line for line in lines if line.startswith("Error")]
            raise SumoError("; ".join(errors[-3:]) or str(error)) from error
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            printed.seek(0)
            os.write(2, printed.read())


def version() -> str:
    """SUMO's version, e.g. "1.28.0"."""
    return libsumo.__version__


def _native_message(error: Exception, log: Path) -> str:
    """The last error lines SUMO wrote, or the exception's own text."""
    written = log.read_text(errors="replace").splitlines() if log.is_file() else []
    errors = [line.strip() for line in written if line.startswith("Error")]
    return "; ".join(errors[-3:]) or str(error)
