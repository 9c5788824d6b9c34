"""What happens at the take-over of a perturbed round: who is displaced, removed or made to do something.

It is decided from the last snapshot of the undisturbed history, for all policies alike, and then carried out step by
step in whatever branch drives the round.
"""

from collections.abc import Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Bool, Float

from cosim.loop.observation import Frame
from cosim.loop.round_recorder import Round
from cosim.loop.state_layouts import Layout
from cosim.perturb.background_vehicles import Plan, braking, cutter, cutting_in
from cosim.perturb.displaced_starts import (
    BRAKING,
    CAR_FOLLOWING,
    MERGE,
    Cars,
    Infeasible,
    displaced,
    hits_ahead,
    verdict,
)
from cosim.perturb.sensing_and_control import Setting, Signals, signals
from cosim.perturb.traffic_demand import GRAVITY
from cosim.spec.perturbations import LeaderBraking, LowFriction, NeighbourCutIn, Perturbation, RemoveThird
from cosim.spec.scenario import CarFollowing, Scenario
from cosim.sumo import Sumo
from cosim.world.episode import COLUMNS
from cosim.world.groups import SAME_LANE, Group, MergeLanes, order_of
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot, near, rows_of

PHANTOM_AHEAD = 500.0  # [m], where the phantom of a removed vehicle drives
_S, _D, _X, _Y, _HEADING, _V, _A = (COLUMNS.index(name) for name in ("s", "d", "x", "y", "heading", "v", "a"))


@dataclass(frozen=True)
class Change:
    """What happens to one group: its displaced start, a background vehicle's plan, and who becomes vehicle 2."""

    start: Cars
    moved: Bool[np.ndarray, " 3"]
    plan: Plan | None
    successor: str | None

    def has_arrived(self, now: Snapshot) -> bool:
        """Whether the successor is in the lane of vehicle 2."""
        if self.successor is None or self.successor not in now.ids:
            return False
        return abs(float(now.d[now.ids.index(self.successor)]) - float(self.start.d[2])) < SAME_LANE


@dataclass(frozen=True)
class Intervention:
    """Everything that is done to a round. `task` has the feasible groups only, `changes` are in their order.

    `trace` are the snapshots after each driven or watched step, filled by whoever drives.
    """

    task: Round
    excluded: tuple[tuple[Group, Infeasible], ...]
    changes: tuple[Change, ...]
    perturbations: tuple[Perturbation, ...]
    seed: int
    trace: list[Snapshot] = field(default_factory=list)

    @property
    def third_gone(self) -> bool:
        return any(isinstance(spec, RemoveThird) for spec in self.perturbations)

    @property
    def vehicles(self) -> list[str]:
        """Whom to watch: the groups and those who are made to do something."""
        return [*self.task.vehicles, *(change.plan.vehicle for change in self.changes if change.plan is not None)]

    def signals(self, layout: Layout, history: Sequence[Frame]) -> Signals | None:
        """The perturbed channels of this round; None where they are as they are."""
        names = tuple(" ".join(group.ids) for group in self.task.groups)
        past = tuple(torch.from_numpy(layout.states(frame.state)) for frame in history[:-1])
        setting = Setting(layout.dynamics, self.task.dt, self.task.driven, self.seed, names, self.task.owned, past)
        return signals(self.perturbations, setting)

    def displace(self, frame: Frame) -> Frame:
        """The frame of the take-over with the displaced starts."""
        state = frame.state.copy()
        for g, change in enumerate(self.changes):
            state[g, :, _S], state[g, :, _V] = change.start.s, change.start.v
        return replace(frame, state=state)

    def begin(self, world: Sumo, driven: Sequence[int]) -> None:
        """Remove who is removed and take who is to be commanded; `driven` are the roles that a policy drives."""
        for group, change in zip(self.task.groups, self.changes, strict=True):
            if self.third_gone:
                world.remove(group.ids[2])
            for vehicle in self._pushed(group, change, driven):
                world.take(vehicle)
            if change.plan is not None:
                world.take(change.plan.vehicle)

    def command(self, world: Sumo, road: RoadFrame, step: int, driven: Sequence[int], now: Snapshot) -> None:
        """Command, before a step, all that are neither SUMO's nor the policy's; hand back whose part is over."""
        there = set(now.ids)
        for group, change in zip(self.task.groups, self.changes, strict=True):
            for vehicle, role in self._pushed(group, change, driven).items():
                s, d, v = (float(value[role]) for value in (change.start.s, change.start.d, change.start.v))
                if step == 0:
                    _place(world, road, vehicle, s + v * self.task.dt, d, 0.0, v)
                elif step == 1 and vehicle in there:
                    world.release(vehicle)
            plan = change.plan
            if plan is not None and plan.vehicle in there:
                if step < len(plan.s):
                    pose = (float(value[step]) for value in (plan.s, plan.d, plan.heading, plan.v))
                    _place(world, road, plan.vehicle, *pose)
                elif step == len(plan.s):
                    world.release(plan.vehicle)

    def _pushed(self, group: Group, change: Change, driven: Sequence[int]) -> dict[str, int]:
        """Displaced vehicles that no policy drives: commanded for one step and SUMO's again. Role by id."""
        return {group.ids[r]: r for r in range(3) if change.moved[r] and r not in driven}

    def see(self, now: Snapshot, road: RoadFrame) -> Frame:
        """The groups as they are after a step: who has cut in is vehicle 2, who was removed is a phantom."""
        self.trace.append(now.only(near(now.s, now.d, rows_of(now.ids, self.vehicles))))
        arrived = [change.has_arrived(now) for change in self.changes]
        groups = [
            replace(group, ids=(*group.ids[:2], change.successor)) if there else group
            for group, change, there in zip(self.task.groups, self.changes, arrived, strict=True)
        ]
        frame = Frame.of(now, groups)
        return self._phantoms(frame, road) if self.third_gone else frame

    def _phantoms(self, frame: Frame, road: RoadFrame) -> Frame:
        state, valid = frame.state.copy(), frame.valid.copy()
        for g, (group, change) in enumerate(zip(self.task.groups, self.changes, strict=True)):
            s, d, v = (value[2:] for value in (change.start.s, change.start.d, change.start.v))
            s = s + PHANTOM_AHEAD + v * (frame.time - group.time)
            xy, heading = road.to_world(s, d)
            state[g, 2, [_S, _D, _X, _Y, _HEADING, _V, _A]] = s[0], d[0], *xy[0], heading[0], v[0], 0.0
            valid[g, 2] = True
        return replace(frame, state=state, valid=valid)

    def show(self, frame: Frame, now: Snapshot) -> Frame:
        """The frame as the policy is shown it, which goes by the lengths of the take-over."""
        if not any(change.successor for change in self.changes):
            return frame
        state = frame.state.copy()
        for g, change in enumerate(self.changes):
            if change.successor is not None and change.has_arrived(now):
                state[g, 2, _S] += change.start.length[2] - now.length[now.ids.index(change.successor)]
        return replace(frame, state=state)


def _place(world: Sumo, road: RoadFrame, vehicle: str, s: float, d: float, heading: float, v: float) -> None:
    xy, along = road.to_world(np.array([s]), np.array([d]))
    world.command(vehicle, float(xy[0, 0]), float(xy[0, 1]), float(along[0]) + heading, v)


def prepare(scenario: Scenario, now: Snapshot, task: Round) -> Intervention:
    """Decide what the scenario's perturbations do to the groups of a round, and which starts are infeasible."""
    friction = min((s.intensity for s in scenario.perturbations if isinstance(s, LowFriction)), default=np.inf)
    changes, groups, excluded = [], [], []
    busy = set(task.vehicles)
    for group in task.groups:
        found = _change(scenario, now, task, group, busy, min(BRAKING, friction * GRAVITY))
        if isinstance(found, Change):
            busy |= {found.successor} if found.successor is not None else set()
            groups.append(group)
            changes.append(found)
        else:
            excluded.append((group, found))
    third = not any(isinstance(spec, RemoveThird) for spec in scenario.perturbations)
    return Intervention(
        task=replace(task, groups=tuple(groups), third=third),
        excluded=tuple(excluded),
        changes=tuple(changes),
        perturbations=scenario.perturbations,
        seed=scenario.seed,
    )


def _change(
    scenario: Scenario, now: Snapshot, task: Round, group: Group, busy: Set[str], hardest: float
) -> Change | Infeasible:
    """What happens to one group, or why it cannot; who is `busy` cannot be made to cut in."""
    rows = np.array([now.ids.index(vehicle) for vehicle in group.ids])
    everyone = Cars(now.s, now.d, now.v, now.length, now.width)
    outside = ~np.isin(np.arange(len(now.ids)), rows)
    before, others = _take(everyone, rows), everyone[outside]
    rule = CAR_FOLLOWING if isinstance(task.rule, CarFollowing) else MERGE
    after = displaced(before, scenario.perturbations, rule)
    gone = any(isinstance(spec, RemoveThird) for spec in scenario.perturbations)
    reason = verdict(
        before,
        after,
        others,
        present=np.array([True, True, not gone]),
        span=_span(scenario.road.length, task.lanes),
        rule=rule,
        braking=hardest,
    )
    if reason is not None:
        return reason
    names = [vehicle for vehicle, free in zip(now.ids, outside, strict=True) if free]
    plan, successor = None, None
    for spec in scenario.perturbations:
        match spec:
            case LeaderBraking() if spec.intensity > 0:
                s, d, v = (float(value[2]) for value in (after.s, after.d, after.v))
                plan = braking(group.ids[2], s, d, v, spec, task.dt)
            case NeighbourCutIn():
                behind = order_of(task.rule)[1]
                free = np.array([vehicle not in busy for vehicle in names])
                row = cutter(after, behind, others[free], spec)
                if row is None:
                    return Infeasible.NO_NEIGHBOUR
                row = int(np.flatnonzero(free)[row])
                successor = names[row]
                own = float(others.s[row]), float(others.d[row]), float(others.v[row])
                plan = cutting_in(successor, own, float(after.d[2]), float(after.v[behind]), spec, task.dt)
    if plan is not None and _hits(plan, after, everyone, now, task.dt, hardest):
        return Infeasible.UNAVOIDABLE
    return Change(after, (before.s != after.s) | (before.v != after.v), plan, successor)


def _take(cars: Cars, rows: np.ndarray) -> Cars:
    return Cars(cars.s[rows], cars.d[rows], cars.v[rows], cars.length[rows], cars.width[rows])


def _span(length: float, lanes: MergeLanes | None) -> Float[np.ndarray, "3 2"]:
    """Where along the road each vehicle can start; the one that merges on the lane that ends."""
    span = np.array([[0.0, length]] * 3)
    if lanes is not None:
        span[0] = lanes.source.begin, lanes.source.end
    return span


def _hits(plan: Plan, group: Cars, everyone: Cars, now: Snapshot, dt: float, hardest: float) -> bool:
    """Whether a vehicle of the group in the plan's lane cannot but run into the planned vehicle."""
    row = now.ids.index(plan.vehicle)
    length, width = everyone.length[row], everyone.width[row]
    speeds = np.concatenate([[everyone.v[row]], plan.v])
    for role in (0, 1):
        in_lane = abs(group.d[role] - plan.d[-1]) < 0.5 * (group.width[role] + width)
        gap = float(everyone.s[row] - length - group.s[role])
        if in_lane and gap > 0 and hits_ahead(gap, float(group.v[role]), speeds, dt, hardest):
            return True
    return False
