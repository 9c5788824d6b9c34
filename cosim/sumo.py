"""The only door to libsumo: start, step, read, command, close.

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
from typing import TypeVar

import libsumo
import numpy as np
from jaxtyping import Float

from cosim.frames import RoadFrame, heading_of, sumo_angle_of, without_straight_vertices
from cosim.snapshot import LANE_AHEAD, Around, Character, Driving, Snapshot, StepReport, Strip, near, rows_of

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
_LEADER_RANGE = 100.0  # [m] within which leaders are told

# libsumo's own functions without their Python wrappers, for what is asked of every vehicle in every step: half the time
_raw = libsumo._libsumo
_position, _speed = _raw.vehicle_getLanePosition, _raw.vehicle_getSpeed
_point, _angle, _acceleration = _raw.vehicle_getPosition, _raw.vehicle_getAngle, _raw.vehicle_getAcceleration
_vehicles = _raw.lane_getLastStepVehicleIDs
_lane, _set_speed, _move = _raw.vehicle_getLaneID, _raw.vehicle_setSpeed, _raw.vehicle_moveToXY
T = TypeVar("T")
_NATIVE_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)


class SumoError(RuntimeError):
    """SUMO refused or failed; the message is SUMO's own."""


# ids, world points [V, 2], s and d of some vehicles
_Positions = tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]


class Sumo:
    """The running simulation. Obtained from `sumo(...)` only."""

    def __init__(self) -> None:
        self._sizes = _Kept(lambda v: (libsumo.vehicle.getLength(v), libsumo.vehicle.getWidth(v)))
        self._sized: tuple[tuple[str, ...], np.ndarray, np.ndarray] = ((), np.empty(0), np.empty(0))
        self._least_gaps = _Kept(libsumo.vehicle.getMinGap)
        self._modes: dict[str, tuple[int, int]] = {}  # (speed mode, lane-change mode) before take-over
        self._twins: set[str] = set()  # vehicles that have one
        self._rings: list[Around] = []  # what the last snapshots around vehicles found, see _RINGS
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
            rings.append(Around(around, lane_ahead, ids, now))
        return ids, xy, s, d

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
        """What a driver's lane-change model thought of one side in the last step (`cosim.snapshot.LaneChange`)."""
        return libsumo.vehicle.getLaneChangeState(vehicle, 1 if left else -1)[0]

    def must_leave(self, vehicle: str) -> bool:
        """Whether a vehicle's lane does not take it along its route; it depends on lane and route alone."""
        own = libsumo.vehicle.getLaneID(vehicle)
        return any(lane == own and offset != 0 for lane, _, _, offset, *_ in libsumo.vehicle.getBestLanes(vehicle))

    def speeds(self, vehicles: Sequence[str]) -> list[float]:
        """Speed [m/s] of each vehicle, nan where it is gone."""
        there = set(libsumo.vehicle.getIDList())
        return [libsumo.vehicle.getSpeed(v) if v in there else math.nan for v in vehicles]

    def limits(self, lanes: Sequence[str]) -> list[float]:
        """Speed limit [m/s] of each lane as it is now."""
        return [libsumo.lane.getMaxSpeed(lane) for lane in lanes]

    def character(self, vehicle: str) -> Character:
        """What does not change about a vehicle and its driver."""
        api = libsumo.vehicle
        return Character(
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

    def shape(self, lane: str) -> Float[np.ndarray, "P 2"]:
        """World points of the centre of a lane."""
        return np.array(libsumo.lane.getShape(lane), dtype=float)

    def lane_length(self, lane: str) -> float:
        """Length [m] of a lane as positions along it count; its shape may be longer or shorter."""
        return libsumo.lane.getLength(lane)

    def lanes_of(self, edges: Sequence[str]) -> list[str]:
        """Lanes of these edges, those that lead into them and, where the net has them, those of junctions between."""
        lanes = libsumo.lane.getIDList()
        wanted = {lane for lane in lanes if lane.rpartition("_")[0] in edges}
        leading = {lane: [link for link in libsumo.lane.getLinks(lane) if link[0] in wanted] for lane in lanes}
        between = {link[4] for links in leading.values() for link in links if link[4]}
        return sorted(wanted | between | {lane for lane, links in leading.items() if links and lane[0] != ":"})

    def route(self, vehicle: str) -> tuple[str, ...]:
        """Edges of a vehicle's route."""
        return tuple(libsumo.vehicle.getRoute(vehicle))

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

    def place_twin(self, vehicle: str, x: float, y: float, heading: float, speed: float, lane: str) -> None:
        """Put a copy of the vehicle on a lane, for others to see; no snapshot, report or count shows it."""
        twin, api = _TWIN + vehicle, libsumo.vehicle
        if vehicle not in self._twins:
            api.add(twin, api.getRouteID(vehicle), api.getTypeID(vehicle))
            api.setSpeedMode(twin, _NO_CHECKS)
            api.setLaneChangeMode(twin, _NO_CHANGES)
            self._twins.add(vehicle)
        self.command(twin, x, y, heading, speed, lane)

    def remove_twin(self, vehicle: str) -> None:
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

    def waiting(self) -> int:
        """How many vehicles should have entered the net and could not yet."""
        return len(_real(libsumo.simulation.getPendingVehicles()))

    def lane_count(self, edge: str) -> int:
        """Number of lanes of an edge."""
        return int(libsumo.edge.getLaneNumber(edge))

    def edges(self) -> frozenset[str]:
        """Ids of all edges and lanes of the net."""
        return frozenset(libsumo.edge.getIDList()) | frozenset(libsumo.lane.getIDList())

    def road(self, edges: Sequence[str], origin: str) -> RoadFrame:
        """The road frame of a chain of edges: along the centre of its leftmost lane, s = 0 where `origin` begins."""
        points: list[tuple[float, float]] = []
        start = 0
        for edge in edges:
            shape = libsumo.lane.getShape(f"{edge}_{libsumo.edge.getLaneNumber(edge) - 1}")
            if edge == origin:
                start = max(len(points) - 1, 0) if points and _meet(points[-1], shape[0]) else len(points)
            points += [point for k, point in enumerate(shape) if k or not points or not _meet(points[-1], point)]
        line = np.array(points, dtype=float)
        before = np.diff(line[: start + 1], axis=0)
        return RoadFrame(without_straight_vertices(line), float(np.hypot(before[:, 0], before[:, 1]).sum()))

    def strip(self, lane: str, road: RoadFrame) -> Strip:
        """Where a lane lies in the road frame; it must run along the road."""
        s, d = road.to_road(np.array(libsumo.lane.getShape(lane), dtype=float))
        return Strip(lane, float(s[0]), float(s[-1]), float(d[-1]), libsumo.lane.getWidth(lane))

    def _close(self) -> None:
        if self._commanded:  # closing and restarting with a pending moveToXY crashes SUMO
            libsumo.simulationStep()
        libsumo.close()


class _Kept(dict[str, T]):
    """What does not change about vehicles; asked once."""

    def __init__(self, ask: Callable[[str], T]) -> None:
        super().__init__()
        self._ask = ask

    def __missing__(self, vehicle: str) -> T:
        self[vehicle] = found = self._ask(vehicle)
        return found


def _meet(end: tuple[float, float], begin: tuple[float, float]) -> bool:
    """Whether the lanes of two edges join here; net files round to centimetres, and in a bend the lanes may overlap."""
    return math.dist(end, begin) < 0.1


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
