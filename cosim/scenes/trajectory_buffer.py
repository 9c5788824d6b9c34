"""The last seconds of traffic on a road section, as SUMO reports it."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from cosim.measures.relation_labels import NO_VEHICLE
from cosim.process.fork import Branch
from cosim.scenes.counterfactual_speeds import speeds_without_leader, speeds_without_requests
from cosim.scenes.lane_change_requests import LaneChangeEvent, find_requests, follower_row, secure_gap_margin
from cosim.sumo import Net, Sumo
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import LaneChange, LaneTraffic

READ_FROM_SUMO = ("lane", "position", "v", "leader", "gap")
FILLED_LATER = ("limit", "v_next", "effect_of_leader", "effect_of_requests")
COLUMNS = (
    *READ_FROM_SUMO, "requester", "target", "target_gap", "cooperative_change", "new_follower", "new_follower_margin",
    *FILLED_LATER,
)  # fmt: skip
COLUMN = {name: k for k, name in enumerate(COLUMNS)}
DEFAULTS = np.zeros(len(COLUMNS))
DEFAULTS[[COLUMN["requester"], COLUMN["target"], COLUMN["new_follower"]]] = NO_VEHICLE
DEFAULTS[COLUMN["new_follower_margin"]] = np.inf
NUMBERS_PER_FLOW = 1_000_000
MAX_PENDING_STEPS = 8  # that the simulation may be ahead of the copies in which interventions run


class VehicleNumbers(dict[str, int]):
    """Numbers of vehicle ids: "flow.k" of the f-th flow is number f million + k; "" is `NO_VEHICLE`."""

    def __init__(self, flows: Sequence[str]) -> None:
        super().__init__({"": NO_VEHICLE})
        self._first_number = {name: NUMBERS_PER_FLOW * k for k, name in enumerate(flows)}

    def __missing__(self, vehicle: str) -> int:
        flow, _, k = vehicle.rpartition(".")
        self[vehicle] = number = self._first_number[flow] + int(k)
        return number


@dataclass(frozen=True)
class BufferedStep:
    """All V vehicles at one step of the scenes. What shows only one simulation step later is filled in then."""

    index: int
    time: float
    """[s]"""
    ids: list[str]
    leaders: list[str]
    row_of: dict[int, int]
    """Vehicle number -> row."""
    values: Float[np.ndarray, "V F"]
    """The F columns `COLUMNS`: fields of `DriverRecords`, SI units; `FILLED_LATER` are set where they are needed."""
    changes: list[LaneChangeEvent]
    """Lane changes since the step before."""
    limits: list[float] = field(default_factory=list)
    """Speed limits of the lanes [m/s]."""

    def column(self, name: str) -> Float[np.ndarray, " V"]:
        return self.values[:, COLUMN[name]]


@dataclass(frozen=True)
class Lane:
    """A lane of one edge: its centre line as world points [m], its length in SUMO [m], its lateral position [m]."""

    edge: str
    shape: Float[np.ndarray, "P 2"]
    length: float
    centre: float
    """Mean lateral position d in the road frame [m]."""

    def points(self, position: Float[np.ndarray, " Q"]) -> Float[np.ndarray, "Q 2"]:
        """World points [m] at positions along the lane [m]."""
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.shape, axis=0).T))])
        along = position * arc[-1] / self.length
        return np.stack([np.interp(along, arc, axis) for axis in self.shape.T], -1)


class RoadSection:
    """The lanes of a chain of edges between s = 0 and s = `length` [m]."""

    def __init__(self, net: Net, road: RoadFrame, edges: Sequence[str], length: float) -> None:
        strips = {name: net.strip(name, road) for name in net.lanes_of(edges)}
        self.names = [name for name, strip in strips.items() if strip.end > 0 and strip.begin < length]
        self.lanes = [_lane(net, name, road) for name in self.names]
        self.centres = [lane.centre for lane in self.lanes]
        self.road = road


def _lane(net: Net, name: str, road: RoadFrame) -> Lane:
    shape = net.shape(name)
    return Lane(name.rpartition("_")[0], shape, net.length(name), float(road.to_road(shape)[1].mean()))


class TrajectoryBuffer:
    """Steps the simulation and keeps the last `length` steps, which are `stride` simulation steps of `dt` [s] apart.

    With `gold`, two interventions start at every step: without leaders, and without requests to make room.
    """

    def __init__(
        self,
        world: Sumo,
        section: RoadSection,
        numbers: VehicleNumbers,
        *,
        length: int,
        dt: float,
        stride: int,
        gold: bool,
    ) -> None:
        self.world, self.section, self.numbers = world, section, numbers
        self.dt, self.stride, self.gold = dt, stride, gold
        self.steps: deque[BufferedStep] = deque(maxlen=length)
        self._lane_of: dict[str, int] = {}
        self._pending: deque[tuple[BufferedStep, dict[str, Branch[list[float]]]]] = deque()
        self._must_change: set[str] = set()  # vehicles that must leave their lane to stay on their route
        self._requested: set[str] = set()  # vehicles that were asked to make room at the step before
        self.count = 0
        """Steps so far."""

    def advance(self) -> BufferedStep:
        """Go on to the next step of the scenes and return it."""
        changes: list[LaneChangeEvent] = []
        before = self.steps[-1] if self.steps else None
        for k in range(self.stride):
            first = before if k == 0 else None
            if first and self.gold:
                self._pending.append((first, self._start_interventions(first)))
            report = self.world.step()
            driving = self.world.drivers.read_lanes(self.section.names)
            if first and (self.gold or self.stride > 1):  # else the speeds of the next step say it
                v = dict(zip(driving.ids, driving.v, strict=True))
                first.values[:, COLUMN["v_next"]] = [v.get(vehicle, np.nan) for vehicle in first.ids]
            changes += self._lane_changes(driving)
        step = self._buffered_step(report.time, driving, changes)
        for change in changes:
            self._record_lane_change(step, before, driving, change)
        self.await_interventions(MAX_PENDING_STEPS)
        self.steps.append(step)
        self.count += 1
        return step

    def _start_interventions(self, now: BufferedStep) -> dict[str, Branch[list[float]]]:
        """Start the copies that find the speeds one simulation step later after each intervention."""
        leaders = [(vehicle, leader) for vehicle, leader in zip(now.ids, now.leaders, strict=True) if leader]
        asked = [now.ids[row] for row in np.flatnonzero(now.column("requester") != NO_VEHICLE)]
        branches = {"effect_of_leader": speeds_without_leader(self.world, now.ids, leaders)}
        if asked:
            branches["effect_of_requests"] = speeds_without_requests(self.world, now.ids, asked)
        return branches

    def await_interventions(self, pending: int = 0) -> None:
        """Wait for the results of interventions until at most `pending` steps are without theirs."""
        while len(self._pending) > pending:
            step, branches = self._pending.popleft()
            for name, branch in branches.items():
                step.values[:, COLUMN[name]] = (step.column("v_next") - branch.result()) / self.dt

    def _lane_changes(self, driving: LaneTraffic) -> list[LaneChangeEvent]:
        """Lane changes on the same edge since the last simulation step."""
        lanes, before, changes = self.section.lanes, self._lane_of, []
        now = dict(zip(driving.ids, driving.lane, strict=True))
        for vehicle in [vehicle for vehicle, lane in now.items() if before.get(vehicle) != lane]:
            if self.world.drivers.must_change_lane(vehicle):
                self._must_change.add(vehicle)
            else:
                self._must_change.discard(vehicle)
            source, target = before.get(vehicle), now[vehicle]
            if source is not None and lanes[source].edge == lanes[target].edge:
                state = self.world.drivers.lane_change_state(vehicle, lanes[target].centre > lanes[source].centre)
                follower = follower_row(driving, vehicle, self.section.centres)
                name = "" if follower is None else driving.ids[follower]
                changes.append(LaneChangeEvent(vehicle, source, target, state, name))
        self._must_change &= now.keys()
        self._lane_of = now
        return changes

    def _buffered_step(self, time: float, driving: LaneTraffic, changes: list[LaneChangeEvent]) -> BufferedStep:
        numbers, count = self.numbers, len(driving.ids)
        leaders = [*map(numbers.__getitem__, driving.leader)]
        values = np.empty((count, len(COLUMNS)))
        values[:] = DEFAULTS
        read = [driving.lane, driving.position, driving.v, leaders, driving.gap]
        values[:, : len(READ_FROM_SUMO)] = np.array(read, dtype=float).T
        candidates = self._must_change | self._requested
        requests = find_requests(
            self.world.drivers,
            driving,
            [driving.row_of[vehicle] for vehicle in candidates if vehicle in driving.row_of],
        )
        self._requested = {driving.ids[row] for row in requests.requesters}
        for row, requester in requests.requesters.items():
            values[row, COLUMN["requester"]] = numbers[requester]
        for row, (target, gap) in requests.targets.items():
            values[row, COLUMN["target"]], values[row, COLUMN["target_gap"]] = numbers[target], gap
        row_of = dict(zip(map(numbers.__getitem__, driving.ids), range(count), strict=True))
        limits = self.world.net.limits(self.section.names)
        return BufferedStep(self.count, time, driving.ids, driving.leader, row_of, values, changes, limits)

    def _record_lane_change(
        self, step: BufferedStep, before: BufferedStep | None, driving: LaneTraffic, change: LaneChangeEvent
    ) -> None:
        """Record the new follower of a lane change, and whether the change was made to help another vehicle."""
        number = self.numbers[change.vehicle]
        if change.state & LaneChange.COOPERATIVE and before is not None and number in before.row_of:
            before.values[before.row_of[number], COLUMN["cooperative_change"]] = 1.0
        follower = follower_row(driving, change.vehicle, self.section.centres)
        if follower is not None:
            own = step.row_of[number]
            margin = secure_gap_margin(self.world.drivers, driving, follower, own)
            step.values[own, COLUMN["new_follower"]] = self.numbers[driving.ids[follower]]
            step.values[own, COLUMN["new_follower_margin"]] = margin
