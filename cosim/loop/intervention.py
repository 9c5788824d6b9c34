"""Carrying out what perturbations do to a round, step by step, in whatever branch drives it.

`Intervention` does what `perturbed_round.plan_intervention` has planned. `NoIntervention` leaves a round as it is. The
loop in `driving` treats both alike.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cosim.loop.observation import GroupObservation
from cosim.loop.round_recorder import Round
from cosim.loop.state_layouts import Layout
from cosim.loop.vehicles_ahead import SpeedRecord, vehicles_ahead
from cosim.perturb.background_vehicles import PosePlan
from cosim.perturb.displaced_starts import Infeasible, VehicleStates
from cosim.perturb.sensing_and_control import RoundSetting, SensingAndControl, sensing_and_control
from cosim.spec.perturbations import Perturbation, RemoveThird
from cosim.sumo import Sumo
from cosim.world.episode import COLUMNS, CUTTER
from cosim.world.groups import SAME_LANE, Group
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot, is_near, rows_of
from cosim.world.surroundings import REACH, Instant

Observed = tuple[Snapshot, GroupObservation, Snapshot | Instant]
"""The vehicles near a round, its groups, and the vehicles to record."""

PHANTOM_AHEAD = 500.0  # [m], where the phantom of a removed vehicle drives
_S, _D, _X, _Y, _HEADING, _V, _A = (COLUMNS.index(name) for name in ("s", "d", "x", "y", "heading", "v", "a"))


@dataclass(frozen=True)
class GroupChange:
    """What happens to one group at its take-over.

    `start` are the states from which it starts, `moved` says which of its vehicles are displaced or have another speed,
    `plan` is what a background vehicle does, `successor` is the vehicle that cuts in and becomes the leader.
    """

    start: VehicleStates
    moved: Bool[np.ndarray, " N"]
    plan: PosePlan | None
    successor: str | None

    def has_arrived(self, now: Snapshot) -> bool:
        """Whether the successor is in the lane of the leader."""
        if self.successor is None or self.successor not in now.ids:
            return False
        return abs(float(now.d[now.ids.index(self.successor)]) - float(self.start.d[-1])) < SAME_LANE


@dataclass(frozen=True)
class Intervention:
    """Everything that perturbations do to a round.

    `round` has the feasible groups only, `changes` are in their order, `excluded` are the other groups with reasons.
    `snapshots` are the vehicles near the round after each driven or watched step; `observe` adds to them. The vehicles
    of `ahead` repeat the speeds they had in the trunk.
    """

    round: Round
    excluded: tuple[tuple[Group, Infeasible], ...]
    changes: tuple[GroupChange, ...]
    perturbations: tuple[Perturbation, ...]
    seed: int
    snapshots: list[Snapshot] = field(default_factory=list)
    ahead: SpeedRecord | None = None

    @property
    def removes_third(self) -> bool:
        """Whether vehicle 2 of every group is removed."""
        return any(isinstance(spec, RemoveThird) for spec in self.perturbations)

    @property
    def vehicles(self) -> list[str]:
        """The vehicles to observe: the groups and the background vehicles that follow a plan."""
        return [*self.round.vehicles, *(change.plan.vehicle for change in self.changes if change.plan is not None)]

    def names(self, g: int) -> dict[str, str]:
        """The names of a group's vehicles by their ids: their roles, and CUTTER for a successor of the leader."""
        found = roles_by_id(self.round.groups[g])
        successor = self.changes[g].successor
        return found if successor is None else found | {successor: CUTTER}

    def members(self, g: int, now: Snapshot) -> tuple[str, ...]:
        """The ids of a group by role: those of two vehicles if vehicle 2 was removed, with a successor that arrived."""
        ids, change = self.round.groups[g].ids, self.changes[g]
        if self.removes_third:
            return ids[:2]
        return (*ids[:-1], change.successor) if change.successor and change.has_arrived(now) else ids

    def repeating(self, speeds: SpeedRecord | None, now: Snapshot) -> "Intervention":
        """The same, in which the vehicles ahead repeat their speeds, but for those that a perturbation changes."""
        if speeds is None or not self.round.groups:
            return self
        changed = {self.round.groups[g].leader for g, change in enumerate(self.changes) if change.moved[-1]}
        changed |= {change.plan.vehicle for change in self.changes if change.plan is not None}
        return replace(self, ahead=speeds.of({*vehicles_ahead(self.round.groups, now)} - changed))

    def channels(self, layout: Layout, road: RoadFrame, history_steps: int, predicts: bool) -> SensingAndControl:
        """The perturbed sensors and actuators of this round, history included, and a state predictor if asked for."""
        names = tuple(" ".join(group.ids) for group in self.round.groups)

        def curvature(state: Tensor) -> Tensor:
            pose = layout.pose(state.numpy())
            return torch.from_numpy(road.curvature_at(pose.s.ravel(), pose.d.ravel()).reshape(pose.s.shape))

        setting = RoundSetting(
            dynamics=layout.dynamics,
            dt=self.round.dt,
            steps=history_steps + self.round.driven_steps,
            seed=self.seed,
            names=names,
            driven_roles=self.round.driven_roles,
            curvature=curvature,
            size=self.round.size,
            predicts=predicts,
        )
        return sensing_and_control(self.perturbations, setting)

    def displaced_start(self, observation: GroupObservation) -> GroupObservation:
        """The observation of the take-over with the displaced starts."""
        state = observation.state.copy()
        for g, change in enumerate(self.changes):
            state[g, :, _S], state[g, :, _V] = change.start.s, change.start.v
        return replace(observation, state=state)

    def begin(self, world: Sumo, driven_roles: Sequence[int]) -> None:
        """Remove vehicles and take those that are to be commanded; a policy drives the `driven_roles`."""
        for group, change in zip(self.round.groups, self.changes, strict=True):
            if self.removes_third:
                world.remove(group.leader)
            for vehicle in self._displaced_vehicles(group, change, driven_roles):
                world.take(vehicle)
            if change.plan is not None:
                world.take(change.plan.vehicle)

    def command(self, world: Sumo, road: RoadFrame, step: int, driven_roles: Sequence[int], now: Snapshot) -> None:
        """Command, before a step, the displaced and planned vehicles that no policy drives.

        A displaced vehicle is handed back after one step, a planned one at the end of its plan.
        """
        if self.ahead is not None:
            self.ahead.repeat(world, step)
        present = set(now.ids)
        for group, change in zip(self.round.groups, self.changes, strict=True):
            for vehicle, role in self._displaced_vehicles(group, change, driven_roles).items():
                s, d, v = (float(value[role]) for value in (change.start.s, change.start.d, change.start.v))
                if step == 0:
                    _place(world, road, vehicle, s + v * self.round.dt, d, 0.0, v)
                elif step == 1 and vehicle in present:
                    world.release(vehicle)
            plan = change.plan
            if plan is not None and plan.vehicle in present:
                if step < len(plan.s):
                    pose = (float(value[step]) for value in (plan.s, plan.d, plan.heading, plan.v))
                    _place(world, road, plan.vehicle, *pose)
                elif step == len(plan.s):
                    world.release(plan.vehicle)

    def _displaced_vehicles(self, group: Group, change: GroupChange, driven_roles: Sequence[int]) -> dict[str, int]:
        """Displaced vehicles that no policy drives, with their roles."""
        return {group.ids[r]: r for r in range(len(group.ids)) if change.moved[r] and r not in driven_roles}

    def observe(
        self,
        world: Sumo,
        road: RoadFrame,
        before: GroupObservation,
        snapshot: Snapshot,
        members: Sequence[str] | None = None,
    ) -> Observed:
        """The vehicles near the round after a step, its groups, and the vehicles to record.

        `before` and `snapshot` are from one step earlier. A vehicle that has cut in is the leader of its group. A
        removed vehicle 2 is a phantom.
        """
        del members
        now, recorded = _read(world, road, self.round, self.vehicles, lambda: self._places(before, snapshot))
        self.snapshots.append(now.only(is_near(now.s, now.d, rows_of(now.ids, self.vehicles))))
        arrived = [change.has_arrived(now) for change in self.changes]
        groups = [
            replace(group, ids=(*group.ids[:-1], change.successor)) if there else group
            for group, change, there in zip(self.round.groups, self.changes, arrived, strict=True)
        ]
        observation = GroupObservation.of(now, groups)
        if self.removes_third:
            observation = self._with_substitute_leader(observation, road)
        return now, observation, recorded

    def _places(self, before: GroupObservation, snapshot: Snapshot) -> Float[np.ndarray, "G N"]:
        """s [m] of the vehicles of each group, of its background vehicle, and of its displaced start."""
        places = before.state[..., _S]
        planned = [
            -1 if change.plan is None else snapshot.row_of.get(change.plan.vehicle, -1) for change in self.changes
        ]
        background = [places[g, -1] if row < 0 else snapshot.s[row] for g, row in enumerate(planned)]
        starts = np.stack([change.start.s for change in self.changes]) if not self.snapshots else places
        return np.column_stack([places, background, starts])

    def _with_substitute_leader(self, observation: GroupObservation, road: RoadFrame) -> GroupObservation:
        """The observation with vehicle 2 far ahead at the speed it had at the take-over."""
        state, valid = observation.state.copy(), observation.valid.copy()
        for g, (group, change) in enumerate(zip(self.round.groups, self.changes, strict=True)):
            s, d, v = (value[2:] for value in (change.start.s, change.start.d, change.start.v))
            s = s + PHANTOM_AHEAD + v * (observation.time - group.time)
            xy, heading = road.to_world(s, d)
            state[g, 2, [_S, _D, _X, _Y, _HEADING, _V, _A]] = s[0], d[0], *xy[0], heading[0], v[0], 0.0
            valid[g, 2] = True
        return replace(observation, state=state, valid=valid)

    def shown_to_policy(self, observation: GroupObservation, now: Snapshot) -> GroupObservation:
        """The observation as the policy gets it.

        A policy's states use the vehicle lengths of the take-over, so the position of a successor is shifted by the
        difference of the lengths.
        """
        if not any(change.successor for change in self.changes):
            return observation
        state = observation.state.copy()
        for g, change in enumerate(self.changes):
            if change.successor is not None and change.has_arrived(now):
                state[g, -1, _S] += change.start.length[-1] - now.length[now.ids.index(change.successor)]
        return replace(observation, state=state)


@dataclass(frozen=True)
class NoIntervention:
    """A round without perturbations: nothing is displaced, removed or planned.

    The vehicles of `ahead` repeat the speeds they had in the trunk. In the trunk, `recorded` records them.
    """

    round: Round
    ahead: SpeedRecord | None = None
    recorded: SpeedRecord | None = None
    excluded: ClassVar[tuple[tuple[Group, Infeasible], ...]] = ()

    def names(self, g: int) -> dict[str, str]:
        """The names of a group's vehicles by their ids: their roles."""
        return roles_by_id(self.round.groups[g])

    def members(self, g: int, now: Snapshot) -> tuple[str, ...]:
        """The ids of a group by role."""
        del now
        return self.round.groups[g].ids

    def repeating(self, speeds: SpeedRecord | None, now: Snapshot) -> "NoIntervention":
        """The same, in which the vehicles ahead repeat their speeds."""
        return self if speeds is None else replace(self, ahead=speeds.of({*vehicles_ahead(self.round.groups, now)}))

    def channels(self, layout: Layout, road: RoadFrame, history_steps: int, predicts: bool) -> SensingAndControl:
        """Perfect sensors and actuators."""
        del road, history_steps, predicts
        return SensingAndControl(layout.dynamics, view_of=(0,) * self.round.size)

    def displaced_start(self, observation: GroupObservation) -> GroupObservation:
        """The observation as it is."""
        return observation

    def begin(self, world: Sumo, driven_roles: Sequence[int]) -> None:
        """Change nothing."""

    def command(self, world: Sumo, road: RoadFrame, step: int, driven_roles: Sequence[int], now: Snapshot) -> None:
        """Let the vehicles ahead repeat their speeds."""
        del road, driven_roles, now
        if self.ahead is not None:
            self.ahead.repeat(world, step)

    def observe(
        self,
        world: Sumo,
        road: RoadFrame,
        before: GroupObservation,
        snapshot: Snapshot,
        members: Sequence[str] | None = None,
    ) -> Observed:
        """The vehicles near the round after a step, its groups, and the vehicles to record.

        `before` and `snapshot` are from one step earlier, `members` are those of groups that others may join.
        """
        del snapshot
        if self.recorded is not None:
            self.recorded.record(world)
        now, recorded = _read(world, road, self.round, self.round.vehicles, lambda: before.state[..., _S])
        of = self.round.vehicles if members is None else members
        return now, GroupObservation.of_vehicles(now, of, len(self.round.groups)), recorded

    def shown_to_policy(self, observation: GroupObservation, now: Snapshot) -> GroupObservation:
        """The observation as it is."""
        del now
        return observation


def _read(
    world: Sumo,
    road: RoadFrame,
    this_round: Round,
    vehicles: Sequence[str],
    places: Callable[[], Float[np.ndarray, "G N"]],
) -> tuple[Snapshot, Snapshot | Instant]:
    """The vehicles near to the given ones, and those to record: if the round records its surroundings, all within REACH
    of the `places` [m] of each group, and some more.
    """
    if this_round.records_surroundings:
        return world.near_and_recorded(road, vehicles, lambda: _spans(places()))
    now = world.snapshot(road, vehicles)
    return now, now


def _spans(s: Float[np.ndarray, "G N"]) -> Float[np.ndarray, "G 2"]:
    return np.stack([s.min(axis=1) - REACH, s.max(axis=1) + REACH], axis=1)


def roles_by_id(group: Group) -> dict[str, str]:
    """The roles of a group's vehicles by their ids."""
    return {vehicle: str(role) for role, vehicle in enumerate(group.ids)}


def _place(world: Sumo, road: RoadFrame, vehicle: str, s: float, d: float, heading: float, v: float) -> None:
    xy, along = road.to_world(np.array([s]), np.array([d]))
    world.command(vehicle, float(xy[0, 0]), float(xy[0, 1]), float(along[0]) + road.side * heading, v)
