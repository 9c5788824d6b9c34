"""The last seconds of traffic on a stretch of road, as SUMO tells them."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from cosim.measures.relation_labels import NOBODY
from cosim.process.fork import Branch
from cosim.scenes.counterfactual_speeds import speeds_without_leader, speeds_without_requests
from cosim.scenes.lane_change_requests import Change, find_requests, new_follower, room
from cosim.sumo import Net, Sumo
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Driving, LaneChange

READ = ("lane", "position", "v", "leader", "gap")
FILLED_LATER = ("limit", "v_next", "unled", "unasked")
COLUMNS = (*READ, "asker", "target", "target_gap", "gave_way", "cut", "room", *FILLED_LATER)
COLUMN = {name: k for k, name in enumerate(COLUMNS)}
EMPTY = np.zeros(len(COLUMNS))
EMPTY[[COLUMN["asker"], COLUMN["target"], COLUMN["cut"]]] = NOBODY
EMPTY[COLUMN["room"]] = np.inf
MILLION = 1_000_000
AHEAD = 8  # moments that the simulation may be ahead of the copies that try interventions


class Numbers(dict[str, int]):
    """Vehicle k of the f-th flow, "flow.k", is number f million + k; "" is nobody."""

    def __init__(self, flows: Sequence[str]) -> None:
        super().__init__({"": NOBODY})
        self._flows = {name: MILLION * k for k, name in enumerate(flows)}

    def __missing__(self, vehicle: str) -> int:
        flow, _, k = vehicle.rpartition(".")
        self[vehicle] = number = self._flows[flow] + int(k)
        return number


@dataclass(frozen=True)
class BufferedStep:
    """All vehicles at one step of the scenes; what shows a simulation step later is filled in then."""

    index: int
    time: float
    ids: list[str]
    leaders: list[str]
    row: dict[int, int]
    """Of a vehicle's number."""
    values: Float[np.ndarray, "V F"]
    """`COLUMNS`: the fields of `DriverRecords`, SI units; `FILLED_LATER` are filled in where they are wanted."""
    changes: list[Change]
    """Since the moment before."""
    limits: list[float] = field(default_factory=list)
    """Of the lanes [m/s]."""

    def of(self, name: str) -> Float[np.ndarray, " V"]:
        """A column."""
        return self.values[:, COLUMN[name]]


@dataclass(frozen=True)
class Lane:
    """A lane: its centre as world points, how positions along it count, and where it lies."""

    edge: str
    shape: Float[np.ndarray, "P 2"]
    length: float
    centre: float
    """Mean lateral position d in the road frame [m]."""

    def points(self, position: Float[np.ndarray, " Q"]) -> Float[np.ndarray, "Q 2"]:
        """World points at positions along the lane [m]."""
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.shape, axis=0).T))])
        along = position * arc[-1] / self.length
        return np.stack([np.interp(along, arc, axis) for axis in self.shape.T], -1)


class RoadSection:
    """The lanes of a chain of edges between s = 0 and `reach` [m]."""

    def __init__(self, net: Net, road: RoadFrame, edges: Sequence[str], reach: float) -> None:
        strips = {name: net.strip(name, road) for name in net.lanes_of(edges)}
        self.names = [name for name, strip in strips.items() if strip.end > 0 and strip.begin < reach]
        self.lanes = [_lane(net, name, road) for name in self.names]
        self.centres = [lane.centre for lane in self.lanes]
        self.road = road


def _lane(net: Net, name: str, road: RoadFrame) -> Lane:
    shape = net.shape(name)
    return Lane(name.rpartition("_")[0], shape, net.length(name), float(road.to_road(shape)[1].mean()))


class TrajectoryBuffer:
    """Steps the simulation and remembers the last `length` moments, which are `every` steps of `step` [s] apart.

    With `gold`, every moment is also tried without leaders and without requests.
    """

    def __init__(
        self, world: Sumo, stretch: RoadSection, numbers: Numbers, *, length: int, step: float, every: int, gold: bool
    ) -> None:
        self.world, self.stretch, self.numbers = world, stretch, numbers
        self.step, self.every, self.gold = step, every, gold
        self.moments: deque[BufferedStep] = deque(maxlen=length)
        self._lane_of: dict[str, int] = {}
        self._tries: deque[tuple[BufferedStep, dict[str, Branch[list[float]]]]] = deque()
        self._restless: set[str] = set()  # vehicles that must leave their lane to go their way
        self._asked: set[str] = set()  # who was asked to make room at the moment before
        self.count = 0
        """Moments so far."""

    def advance(self) -> BufferedStep:
        """Go on to the next moment."""
        changes: list[Change] = []
        before = self.moments[-1] if self.moments else None
        for k in range(self.every):
            first = before if k == 0 else None
            if first and self.gold:
                self._tries.append((first, self._try(first)))
            report = self.world.step()
            driving = self.world.drivers.driving(self.stretch.names)
            if first and (self.gold or self.every > 1):  # else the next moment says it
                v = dict(zip(driving.ids, driving.v, strict=True))
                first.values[:, COLUMN["v_next"]] = [v.get(vehicle, np.nan) for vehicle in first.ids]
            changes += self._changes(driving)
        moment = self._moment(report.time, driving, changes)
        for change in changes:
            self._mark(moment, before, driving, change)
        self.settle(AHEAD)
        self.moments.append(moment)
        self.count += 1
        return moment

    def _try(self, now: BufferedStep) -> dict[str, Branch[list[float]]]:
        """Begin to find out the speeds one step later after each intervention."""
        leaders = [(vehicle, leader) for vehicle, leader in zip(now.ids, now.leaders, strict=True) if leader]
        asked = [now.ids[row] for row in np.flatnonzero(now.of("asker") != NOBODY)]
        tries = {"unled": speeds_without_leader(self.world, now.ids, leaders)}
        return tries | ({"unasked": speeds_without_requests(self.world, now.ids, asked)} if asked else {})

    def settle(self, ahead: int = 0) -> None:
        """Wait for what interventions do, of all moments but the last few."""
        while len(self._tries) > ahead:
            moment, tries = self._tries.popleft()
            for name, branch in tries.items():
                moment.values[:, COLUMN[name]] = (moment.of("v_next") - branch.result()) / self.step

    def _changes(self, driving: Driving) -> list[Change]:
        """Lane changes on the same edge since the last reading."""
        lanes, before, changes = self.stretch.lanes, self._lane_of, []
        now = dict(zip(driving.ids, driving.lane, strict=True))
        for vehicle in [vehicle for vehicle, lane in now.items() if before.get(vehicle) != lane]:
            (self._restless.add if self.world.drivers.must_leave(vehicle) else self._restless.discard)(vehicle)
            source, target = before.get(vehicle), now[vehicle]
            if source is not None and lanes[source].edge == lanes[target].edge:
                state = self.world.drivers.lane_change_state(vehicle, lanes[target].centre > lanes[source].centre)
                behind = new_follower(driving, vehicle, self.stretch.centres)
                name = "" if behind is None else driving.ids[behind]
                changes.append(Change(vehicle, source, target, state, name))
        self._restless &= now.keys()
        self._lane_of = now
        return changes

    def _moment(self, time: float, driving: Driving, changes: list[Change]) -> BufferedStep:
        numbers, count = self.numbers, len(driving.ids)
        leaders = [*map(numbers.__getitem__, driving.leader)]
        values = np.empty((count, len(COLUMNS)))
        values[:] = EMPTY
        read = [driving.lane, driving.position, driving.v, leaders, driving.gap]
        values[:, : len(READ)] = np.array(read, dtype=float).T
        concerned = self._restless | self._asked
        wanted = find_requests(
            self.world.drivers, driving, [driving.where[vehicle] for vehicle in concerned if vehicle in driving.where]
        )
        self._asked = {driving.ids[row] for row in wanted.askers}
        for row, asker in wanted.askers.items():
            values[row, COLUMN["asker"]] = numbers[asker]
        for row, (target, gap) in wanted.targets.items():
            values[row, COLUMN["target"]], values[row, COLUMN["target_gap"]] = numbers[target], gap
        row_of = dict(zip(map(numbers.__getitem__, driving.ids), range(count), strict=True))
        limits = self.world.net.limits(self.stretch.names)
        return BufferedStep(self.count, time, driving.ids, driving.leader, row_of, values, changes, limits)

    def _mark(self, moment: BufferedStep, before: BufferedStep | None, driving: Driving, change: Change) -> None:
        """What a lane change did to who drives behind it now, and whether it was made for somebody."""
        number = self.numbers[change.vehicle]
        if change.state & LaneChange.COOPERATIVE and before is not None and number in before.row:
            before.values[before.row[number], COLUMN["gave_way"]] = 1.0
        behind = new_follower(driving, change.vehicle, self.stretch.centres)
        if behind is not None:
            own = moment.row[number]
            moment.values[own, COLUMN["cut"]] = self.numbers[driving.ids[behind]]
            moment.values[own, COLUMN["room"]] = room(self.world.drivers, driving, behind, own)
