"""The last seconds of traffic on a road section, as SUMO reports it."""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from cosim.measures.relation_labels import NO_VEHICLE
from cosim.process.fork import Branch
from cosim.scenes.counterfactual_speeds import speeds_without_leader, speeds_without_requests
from cosim.scenes.driver_models import decision_steps, model_of
from cosim.scenes.lane_change_requests import LaneChangeEvent, find_requests, follower_row, secure_gap_margin
from cosim.scenes.last_decisions import LastDecisions
from cosim.spec.demand import CarFollowingModel
from cosim.sumo import CachedVehicleValues, Net, Sumo
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import LaneChange, LaneTraffic

READ_FROM_SUMO = ("lane", "position", "v", "leader", "gap")
EFFECTS = ("effect_of_leader", "effect_of_requests")
FILLED_LATER = ("limit", "v_next", *EFFECTS, "decision_known")
COLUMNS = (
    *READ_FROM_SUMO, "requester", "target", "target_gap", "cooperative_change", "new_follower", "new_follower_margin",
    *FILLED_LATER,
)  # fmt: skip
COLUMN = {name: k for k, name in enumerate(COLUMNS)}
DEFAULTS = np.zeros(len(COLUMNS))
DEFAULTS[[COLUMN["requester"], COLUMN["target"], COLUMN["new_follower"]]] = NO_VEHICLE
DEFAULTS[COLUMN["new_follower_margin"]] = np.inf
DEFAULTS[COLUMN["decision_known"]] = 1.0
NUMBERS_PER_FLOW = 1_000_000
MAX_PENDING_STEPS = 8  # that the simulation may be ahead of the copies in which interventions run


class VehicleNumbers(dict[str, int]):
    """Numbers of vehicle ids: "flow.k" of the f-th flow is number f million + k; "" is `NO_VEHICLE`.

    Vehicles of no such flow are numbered after the last flow, in the order in which they are first seen.
    """

    def __init__(self, flows: Sequence[str]) -> None:
        super().__init__({"": NO_VEHICLE})
        self._first_number = {name: NUMBERS_PER_FLOW * k for k, name in enumerate(flows)}
        self._others = 0

    def __missing__(self, vehicle: str) -> int:
        flow, _, k = vehicle.rpartition(".")
        if flow in self._first_number and k.isdigit():
            number = self._first_number[flow] + int(k)
        else:
            number = NUMBERS_PER_FLOW * len(self._first_number) + self._others
            self._others += 1
        self[vehicle] = number
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


@dataclass(frozen=True)
class _Intervention:
    """What was changed in copies of one simulation step, for V vehicles; `step` is None between two buffered steps."""

    step: BufferedStep | None
    ids: list[str]
    causes: dict[str, np.ndarray]
    """[V] Number of the leader or requester, by the column of its effect."""
    decision_steps: dict[str, np.ndarray]
    """[V] Simulation steps between two decisions, by the column of the effect."""
    branches: dict[str, Branch[list[float]]]
    v_next: list[float]
    """Speed one simulation step later without an intervention [m/s]; nan where the vehicle left the road section."""


def _speeds_of(ids: Sequence[str], driving: LaneTraffic) -> list[float]:
    """Speed of each vehicle [m/s]; nan where it left the road section."""
    v = dict(zip(driving.ids, driving.v, strict=True))
    return [v.get(vehicle, np.nan) for vehicle in ids]


class TrajectoryBuffer:
    """Steps the simulation and keeps the last `length` steps, which are `stride` simulation steps of `dt` [s] apart.

    With `gold`, two interventions start at every step: without leaders, and without requests to make room. If a driver
    does not decide at every simulation step, interventions also start between two buffered steps. `models` are the
    car-following models of the vehicle classes.
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
        models: Mapping[str, CarFollowingModel],
    ) -> None:
        self.world, self.section, self.numbers = world, section, numbers
        self.dt, self.stride, self.gold, self.models = dt, stride, gold, models
        self.steps: deque[BufferedStep] = deque(maxlen=length)
        self._lane_of: dict[str, int] = {}
        self._pending: deque[_Intervention] = deque()
        self._decision_steps = CachedVehicleValues(self._steps_per_decision)
        self._last_decisions = {name: LastDecisions() for name in EFFECTS}
        self._must_change: set[str] = set()  # vehicles that must leave their lane to stay on their route
        self._requested: set[str] = set()  # vehicles that were asked to make room at the step before
        self.count = 0
        """Steps so far."""

    def advance(self) -> BufferedStep:
        """Go on to the next step of the scenes and return it."""
        changes: list[LaneChangeEvent] = []
        now = before = self.steps[-1] if self.steps else None
        between = self.gold and self.stride > 1 and before is not None and self._some_decide_rarely(before.ids)
        for k in range(self.stride):
            first = before if k == 0 else None
            waiting = self._intervene(now, first) if now and self.gold and (first or between) else None
            report = self.world.step()
            driving = self.world.drivers.read_lanes(self.section.names)
            if first and (self.gold or self.stride > 1):  # else the speeds of the next step say it
                first.values[:, COLUMN["v_next"]] = _speeds_of(first.ids, driving)
            if waiting:
                waiting.v_next[:] = _speeds_of(waiting.ids, driving)
            changes += self._lane_changes(driving)
            if between and k + 1 < self.stride:
                now = self._buffered_step(report.time, driving, [])
        step = self._buffered_step(report.time, driving, changes)
        for change in changes:
            self._record_lane_change(step, before, driving, change)
        self.await_interventions(MAX_PENDING_STEPS)
        self.steps.append(step)
        self.count += 1
        return step

    def _steps_per_decision(self, vehicle: str) -> dict[str, int]:
        driver = self.world.drivers.parameters(vehicle)
        return decision_steps(driver, model_of(driver, self.models), self.dt)

    def _some_decide_rarely(self, ids: Sequence[str]) -> bool:
        """Whether a driver does not decide at every simulation step."""
        return any(max(self._decision_steps[vehicle].values()) > 1 for vehicle in ids)

    def _intervene(self, now: BufferedStep, buffered: BufferedStep | None) -> _Intervention:
        """Start the copies that find the speeds one simulation step later after each intervention."""
        leaders = [(vehicle, leader) for vehicle, leader in zip(now.ids, now.leaders, strict=True) if leader]
        asked = [now.ids[row] for row in np.flatnonzero(now.column("requester") != NO_VEHICLE)]
        branches = {"effect_of_leader": speeds_without_leader(self.world, now.ids, leaders)}
        if asked:
            branches["effect_of_requests"] = speeds_without_requests(self.world, now.ids, asked)
        causes = {
            effect: now.column(name).astype(int) for effect, name in zip(EFFECTS, ("leader", "requester"), strict=True)
        }
        rates = [self._decision_steps[vehicle] for vehicle in now.ids]
        steps = {name: np.array([rate[name] for rate in rates], int) for name in EFFECTS}
        waiting = _Intervention(buffered, now.ids, causes, steps, branches, [])
        self._pending.append(waiting)
        return waiting

    def await_interventions(self, pending: int = 0) -> None:
        """Wait for the results of interventions until at most `pending` of them are without theirs."""
        while len(self._pending) > pending:
            done = self._pending.popleft()
            vehicle = np.array([self.numbers[name] for name in done.ids], int)
            for name in EFFECTS:
                effect = np.zeros(len(done.ids))
                if name in done.branches:
                    effect = (np.array(done.v_next) - np.array(done.branches[name].result())) / self.dt
                effect, known = self._last_decisions[name].update(
                    vehicle, done.causes[name], effect, done.decision_steps[name]
                )
                if done.step is not None:
                    done.step.values[:, COLUMN[name]] = effect
                    done.step.values[:, COLUMN["decision_known"]] *= known

    def _lane_changes(self, driving: LaneTraffic) -> list[LaneChangeEvent]:
        """Lane changes on the same edge since the last simulation step."""
        lanes, before, changes = self.section.lanes, self._lane_of, []
        now = dict(zip(driving.ids, driving.lane, strict=True))
        for vehicle in [vehicle for vehicle, lane in now.items() if before.get(vehicle) != lane]:
            if self.world.drivers.way_in_lane(vehicle) < math.inf:
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
