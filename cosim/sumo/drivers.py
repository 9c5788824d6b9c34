"""What SUMO says of its drivers: who they are, whom they see, what they want; and telling them whom not to heed."""

import math
from collections.abc import Iterable, Sequence

import libsumo

from cosim.sumo.cache import CachedAnswers
from cosim.world.snapshot import DriverParameters, Driving

_raw = libsumo._libsumo  # without the Python wrappers, for what is asked of every vehicle in every step
_position, _speed, _vehicles = _raw.vehicle_getLanePosition, _raw.vehicle_getSpeed, _raw.lane_getLastStepVehicleIDs
_LEADER_RANGE = 100.0  # [m] within which leaders are told


class Drivers:
    """SUMO's drivers in the running simulation; `sizes` are (length, width) of vehicles [m]."""

    def __init__(self, sizes: CachedAnswers[tuple[float, float]]) -> None:
        self._sizes = sizes
        self._least_gaps = CachedAnswers(libsumo.vehicle.getMinGap)

    def driving(self, lanes: Sequence[str]) -> Driving:
        """Read the vehicles on these lanes and what SUMO says of their drivers; shadows of no kind, no twins."""
        on = [*map(_vehicles, lanes)]
        ids = [v for of_lane in on for v in of_lane]
        position = [*map(_position, ids)]
        leader = [v for of_lane in on if of_lane for v in (*of_lane[1:], "")]  # who is ahead comes later
        ahead, sizes, least = [*position[1:], 0.0], self._sizes, self._least_gaps
        gap = [
            p - sizes[other][0] - own - least[v] if other else math.inf
            for v, other, own, p in zip(ids, leader, position, ahead, strict=True)
        ]
        for row in [row for row, other in enumerate(leader) if not other]:
            leader[row], gap[row] = libsumo.vehicle.getLeader(ids[row], _LEADER_RANGE) or ("", math.inf)
        return Driving(
            ids=ids,
            lane=[k for k, of_lane in enumerate(on) for _ in of_lane],
            position=position,
            v=[*map(_speed, ids)],
            leader=leader,
            gap=gap,
        )

    def lane_change_state(self, vehicle: str, left: bool) -> int:
        """What a driver's lane-change model thought of one side in the last step (`LaneChange`)."""
        return libsumo.vehicle.getLaneChangeState(vehicle, 1 if left else -1)[0]

    def must_leave(self, vehicle: str) -> bool:
        """Whether a vehicle's lane does not take it along its route; it depends on lane and route alone."""
        own = libsumo.vehicle.getLaneID(vehicle)
        return any(lane == own and offset != 0 for lane, _, _, offset, *_ in libsumo.vehicle.getBestLanes(vehicle))

    def speeds(self, vehicles: Sequence[str]) -> list[float]:
        """Speed [m/s] of each vehicle, nan where it is gone."""
        there = set(libsumo.vehicle.getIDList())
        return [libsumo.vehicle.getSpeed(v) if v in there else math.nan for v in vehicles]

    def character(self, vehicle: str) -> DriverParameters:
        """What does not change about a vehicle and its driver."""
        api = libsumo.vehicle
        return DriverParameters(
            kind=api.getTypeID(vehicle),
            length=api.getLength(vehicle),
            width=api.getWidth(vehicle),
            acceleration=api.getAccel(vehicle),
            imperfection=api.getImperfection(vehicle),
            speed_factor=api.getSpeedFactor(vehicle),
            max_speed=api.getMaxSpeed(vehicle),
        )

    def braking(self, vehicle: str) -> float:
        """How hard a vehicle may brake [m/s²]."""
        return libsumo.vehicle.getDecel(vehicle)

    def follow_speed(self, vehicle: str, v: float, gap: float, v_leader: float, braking: float) -> float:
        """Speed [m/s] that a driver's car-following model allows at speed v, so far behind a leader.

        `braking` [m/s²] is what the leader is able to. Krauss and IDM answer from these numbers alone, so that this may
        be asked later, as long as the vehicle is there.
        """
        return libsumo.vehicle.getFollowSpeed(vehicle, v, gap, v_leader, braking)

    def secure_gap(self, vehicle: str, v: float, leader: str, v_leader: float, braking: float) -> float:
        """Gap [m] beyond its least one that a driver holds to be secure behind a leader."""
        return libsumo.vehicle.getSecureGap(vehicle, v, v_leader, braking, leader)

    def neighbour(self, vehicle: str, left: bool, ahead: bool) -> tuple[str, float]:
        """The nearest vehicle in the next lane and the distance to it [m]; ("", inf) where there is none."""
        found = libsumo.vehicle.getNeighbors(vehicle, (0 if left else 1) | (2 if ahead else 0))
        return min(found, key=lambda at: at[1], default=("", math.inf))

    def ignore(self, vehicles: Iterable[tuple[str, str]]) -> None:
        """From now on, the first vehicle of each pair does not see the second as its leader."""
        for vehicle, leader in vehicles:
            libsumo.vehicle.setParameter(vehicle, "carFollowModel.ignoreIDs", leader)

    def ignore_requests(self, vehicles: Iterable[str]) -> None:
        """From now on, these vehicles do not slow down for others that want to change lanes."""
        for vehicle in vehicles:
            libsumo.vehicle.setParameter(vehicle, "laneChangeModel.lcCooperativeSpeed", "0")
