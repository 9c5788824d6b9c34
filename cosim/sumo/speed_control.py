"""Driving vehicles by speed commands: SUMO keeps their lanes, routes and right of way, a policy gives their speeds.

What was measured (docs/decisions/052-share-of-traffic.md): with all of SUMO's checks on, SUMO drove slower than
commanded in 97 % of the commands that close a gap, because its own car-following model bounds the speed. So the next
vehicle ahead is taken out of SUMO's check (`carFollowModel.ignoreIDs`), and whoever commands must keep clear of it. All
other bounds stay: speed limits, ends of lanes, signals, priority at junctions. Acceleration limits are off.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import libsumo

_raw = libsumo._libsumo  # without the Python wrappers, for what is read of every vehicle in every step
_speed, _leader, _lane = _raw.vehicle_getSpeed, _raw.vehicle_getLeader, _raw.vehicle_getLaneID
_set_speed, _vehicles = _raw.vehicle_setSpeed, _raw.vehicle_getIDList
_CHECKED = 0b11001  # speed mode: safe speed (but not behind the ignored leader), right of way, red lights
_OWN_SPEED = -1.0  # setSpeed: SUMO's driver decides on the speed again
_IGNORED = "carFollowModel.ignoreIDs"
LEADER_RANGE = 100.0  # [m] within which the next vehicle ahead is found
CHANGE_DISTANCE = 300.0  # [m] before the end of its lane from which a vehicle must change lanes
_NO_SPEED = libsumo.constants.INVALID_DOUBLE_VALUE  # of a vehicle that is in no lane
_departed, _arrived = _raw.simulation_getDepartedIDList, _raw.simulation_getArrivedIDList
_teleporting, _teleported = _raw.simulation_getStartingTeleportIDList, _raw.simulation_getEndingTeleportIDList
_NO_ROAD_VEHICLES = frozenset(
    {"pedestrian", "bicycle", "rail", "rail_urban", "rail_electric", "rail_fast", "tram", "ship"}
)


@dataclass(frozen=True)
class DriverLimits:
    """Constant facts of a vehicle and its driver: `length` [m], strongest braking [m/s²], and its type's prefix."""

    length: float
    braking: float
    kind: str


class SpeedControl:
    """Reads all vehicles of the running simulation, and commands the speeds of those that were taken."""

    def __init__(self, step: float) -> None:
        """`step` [s] is SUMO's; a vehicle that is taken decides in every step, whatever its action step was."""
        self._step = step
        self._modes: dict[str, int] = {}  # speed mode before the vehicle was taken
        self._ignored: dict[str, str] = {}  # whom a taken vehicle is not checked against
        self._present: tuple[str, ...] = ()

    def read(self) -> tuple[tuple[str, ...], list[float]]:
        """All vehicles in the net after a step, and their speeds [m/s]; to be called after every step.

        The list is kept up to date by who entered and left, because SUMO looks through all vehicles of the whole demand
        to list those in the net.
        """
        came = {*_departed(), *_teleported()}
        gone = {*_arrived(), *_teleporting()}
        if came or gone:
            self._present = (*(v for v in self._present if v not in gone), *sorted(came - gone - {*self._present}))
        try:
            speeds = [*map(_speed, self._present)]
        except libsumo.TraCIException:  # a vehicle vanished without having arrived
            speeds = [_NO_SPEED]
        if _NO_SPEED in speeds:
            self._present = _vehicles()
            speeds = [*map(_speed, self._present)]
        return self._present, speeds

    def lanes(self, vehicles: Iterable[str]) -> list[str]:
        """Lane of each vehicle, "" where it is on none."""
        return [*map(_lane, vehicles)]

    def leaders(self, vehicles: Iterable[str]) -> list[tuple[str, float]]:
        """The next vehicle ahead of each, and the gap [m] minus the minimum gap of the driver; ("", −1) for nobody."""
        nobody = "", -1.0
        return [_leader(vehicle, LEADER_RANGE) or nobody for vehicle in vehicles]

    def min_gap(self, vehicle: str) -> float:
        """The minimum gap [m] of a driver."""
        return libsumo.vehicle.getMinGap(vehicle)

    def limits(self, vehicle: str) -> DriverLimits:
        """The constant facts of a vehicle."""
        api = libsumo.vehicle
        kind = api.getTypeID(vehicle).partition("@")[0].rpartition(".")
        return DriverLimits(api.getLength(vehicle), api.getEmergencyDecel(vehicle), kind[0] or kind[2])

    def is_road_vehicle(self, vehicle: str) -> bool:
        """Whether it is a motor vehicle on a road."""
        return libsumo.vehicle.getVehicleClass(vehicle) not in _NO_ROAD_VEHICLES

    def must_change_lane(self, vehicle: str) -> bool:
        """Whether the vehicle must leave its lane within CHANGE_DISTANCE to follow its route."""
        own = _lane(vehicle)
        for lane, length, _, offset, *_ in _raw.vehicle_getBestLanes(vehicle):
            if lane == own:
                return offset != 0 and length - libsumo.vehicle.getLanePosition(vehicle) < CHANGE_DISTANCE
        return False

    def take(self, vehicle: str) -> None:
        """Take a vehicle; it drives by itself until it gets a command."""
        self._modes.setdefault(vehicle, libsumo.vehicle.getSpeedMode(vehicle))  # again after a teleport
        self._ignored.setdefault(vehicle, "")
        if abs(libsumo.vehicle.getActionStepLength(vehicle) - self._step) > 1e-6:
            libsumo.vehicle.setActionStepLength(vehicle, self._step)

    def command(self, vehicles: Sequence[str], leaders: Sequence[str], speeds: Sequence[float]) -> None:
        """Command the speed [m/s] after the next step of each vehicle; SUMO does not check it against its leader."""
        for vehicle, leader, speed in zip(vehicles, leaders, speeds, strict=True):
            if self._ignored[vehicle] != leader:
                self._change_ignored(vehicle, leader)
            _set_speed(vehicle, speed)

    def leave_to_sumo(self, vehicle: str) -> None:
        """Let SUMO's driver decide on the speed of a taken vehicle, until the next command."""
        if self._ignored[vehicle]:
            self._change_ignored(vehicle, "")
        _set_speed(vehicle, _OWN_SPEED)

    def _change_ignored(self, vehicle: str, leader: str) -> None:
        if leader and not self._ignored[vehicle]:
            libsumo.vehicle.setSpeedMode(vehicle, _CHECKED)
        elif not leader:
            libsumo.vehicle.setSpeedMode(vehicle, self._modes[vehicle])
        self._ignored[vehicle] = leader
        libsumo.vehicle.setParameter(vehicle, _IGNORED, leader)
