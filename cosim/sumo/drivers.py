"""SUMO's drivers: their parameters, leaders and lane-change states, and switching reactions of theirs off."""

import math
from collections.abc import Iterable, Sequence

import libsumo

from cosim.sumo.cache import CachedVehicleValues
from cosim.world.snapshot import DriverParameters, LaneTraffic

_raw = libsumo._libsumo  # without the Python wrappers, for what is read of every vehicle in every step
_position, _speed, _vehicles = _raw.vehicle_getLanePosition, _raw.vehicle_getSpeed, _raw.lane_getLastStepVehicleIDs
_LEADER_RANGE = 100.0  # [m] within which leaders are read


class Drivers:
    """SUMO's drivers in the running simulation; `sizes` are (length, width) of vehicles [m]."""

    def __init__(self, sizes: CachedVehicleValues[tuple[float, float]]) -> None:
        self._sizes = sizes
        self._min_gaps = CachedVehicleValues(libsumo.vehicle.getMinGap)
        self._kinds = CachedVehicleValues(libsumo.vehicle.getTypeID)

    def read_lanes(self, lanes: Sequence[str]) -> LaneTraffic:
        """Read the vehicles on these lanes and their leaders. The simulation must have no shadow vehicles."""
        on = [*map(_vehicles, lanes)]
        ids = [v for of_lane in on for v in of_lane]
        position = [*map(_position, ids)]
        leader = [v for of_lane in on if of_lane for v in (*of_lane[1:], "")]  # a lane's first vehicle: below
        ahead, sizes, min_gaps = [*position[1:], 0.0], self._sizes, self._min_gaps
        gap = [
            p - sizes[other][0] - own - min_gaps[v] if other else math.inf
            for v, other, own, p in zip(ids, leader, position, ahead, strict=True)
        ]
        for row in [row for row, other in enumerate(leader) if not other]:
            leader[row], gap[row] = libsumo.vehicle.getLeader(ids[row], _LEADER_RANGE) or ("", math.inf)
        return LaneTraffic(
            ids=ids,
            lane=[k for k, of_lane in enumerate(on) for _ in of_lane],
            position=position,
            v=[*map(_speed, ids)],
            leader=leader,
            gap=gap,
        )

    def lane_change_state(self, vehicle: str, left: bool) -> int:
        """State of a driver's lane-change model for one side in the last step, as bits of `LaneChange`."""
        return libsumo.vehicle.getLaneChangeState(vehicle, 1 if left else -1)[0]

    def way_in_lane(self, vehicle: str) -> float:
        """The way [m] that a vehicle can go before it must change lanes to follow its route; inf where it need not.

        The number of lanes to change depends on lane and route alone (SUMO's documentation of `getBestLanes`).
        """
        own, at = libsumo.vehicle.getLaneID(vehicle), libsumo.vehicle.getLanePosition(vehicle)
        for lane, length, _, offset, *_ in libsumo.vehicle.getBestLanes(vehicle):
            if lane == own and offset != 0:
                return length - at
        return math.inf

    def speeds(self, vehicles: Sequence[str]) -> list[float]:
        """Speed [m/s] of each vehicle, nan where it left the simulation."""
        present = set(libsumo.vehicle.getIDList())
        return [libsumo.vehicle.getSpeed(v) if v in present else math.nan for v in vehicles]

    def kinds(self, vehicles: Iterable[str]) -> list[str]:
        """The vehicle type of each vehicle."""
        return [self._kinds[vehicle] for vehicle in vehicles]

    def parameters(self, vehicle: str) -> DriverParameters:
        """The constant parameters of a vehicle and its driver."""
        api = libsumo.vehicle
        return DriverParameters(
            kind=api.getTypeID(vehicle),
            length=api.getLength(vehicle),
            width=api.getWidth(vehicle),
            acceleration=api.getAccel(vehicle),
            imperfection=max(api.getImperfection(vehicle), 0.0),  # SUMO says -1 for models without one
            action_step=api.getActionStepLength(vehicle),
            speed_factor=api.getSpeedFactor(vehicle),
            max_speed=api.getMaxSpeed(vehicle),
        )

    def headway(self, vehicle: str) -> tuple[float, float]:
        """Time headway [s] and minimum gap [m] that a vehicle's driver wants."""
        return libsumo.vehicle.getTau(vehicle), libsumo.vehicle.getMinGap(vehicle)

    def leader(self, vehicle: str) -> tuple[str, float] | None:
        """The next vehicle ahead in the lane and the net gap [m] to it, if there is one."""
        found = libsumo.vehicle.getLeader(vehicle, _LEADER_RANGE)
        if not found or not found[0]:
            return None
        return found[0], found[1] + libsumo.vehicle.getMinGap(vehicle)

    def motion(self, vehicle: str) -> tuple[float, float]:
        """Speed [m/s] and acceleration [m/s²] of a vehicle."""
        return libsumo.vehicle.getSpeed(vehicle), libsumo.vehicle.getAcceleration(vehicle)

    def lane_offset(self, vehicle: str) -> float:
        """Lateral position [m] of a vehicle that was placed, to the left of the centre of its lane."""
        return libsumo.vehicle.getLateralLanePosition(vehicle)

    def allowed_speed(self, vehicle: str) -> float:
        """Speed [m/s] that a vehicle's driver wants on a free road in its lane."""
        return libsumo.vehicle.getAllowedSpeed(vehicle)

    def braking(self, vehicle: str) -> float:
        """Deceleration [m/s²] that a vehicle's driver is ready to use."""
        return libsumo.vehicle.getDecel(vehicle)

    def follow_speed(self, vehicle: str, v: float, gap: float, v_leader: float, braking: float) -> float:
        """Speed [m/s] that a driver's car-following model allows at the speed `v`, `gap` [m] behind a leader.

        `braking` [m/s²] is the leader's deceleration. Krauss and IDM depend on these numbers alone, so that this can be
        asked later, as long as the vehicle is in the simulation.
        """
        return libsumo.vehicle.getFollowSpeed(vehicle, v, gap, v_leader, braking)

    def secure_gap(self, vehicle: str, v: float, leader: str, v_leader: float, braking: float) -> float:
        """Gap [m] minus the minimum gap that a driver holds to be secure behind a leader."""
        return libsumo.vehicle.getSecureGap(vehicle, v, v_leader, braking, leader)

    def neighbour(self, vehicle: str, left: bool, ahead: bool) -> tuple[str, float]:
        """The nearest vehicle in the next lane and the distance to it [m]; ("", inf) where there is none."""
        found = libsumo.vehicle.getNeighbors(vehicle, (0 if left else 1) | (2 if ahead else 0))
        return min(found, key=lambda at: at[1], default=("", math.inf))

    def ignore_leaders(self, vehicles: Iterable[tuple[str, str]]) -> None:
        """From now on, the first vehicle of each pair does not react to the second as its leader."""
        for vehicle, leader in vehicles:
            libsumo.vehicle.setParameter(vehicle, "carFollowModel.ignoreIDs", leader)

    def ignore_requests(self, vehicles: Iterable[str]) -> None:
        """From now on, these vehicles do not slow down for others that want to change lanes."""
        for vehicle in vehicles:
            libsumo.vehicle.setParameter(vehicle, "laneChangeModel.lcCooperativeSpeed", "0")
