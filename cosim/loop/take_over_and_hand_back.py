"""Take-over, commands and hand-back: what is sent to SUMO for the vehicles that a policy drives.

`PolicyControl` is a policy in control of its vehicles. `SumoControl` stands for no policy: its methods do nothing. The
loop in `driving` treats both alike.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from cosim.loop import shadow_vehicles
from cosim.loop.membership import Membership
from cosim.loop.nearby_vehicles import Around
from cosim.loop.observation import GroupObservation
from cosim.loop.policy_runner import PolicyRunner
from cosim.loop.returning_vehicles import ReturningVehicles, stop_of
from cosim.loop.round_recorder import Round, RoundRecorder
from cosim.loop.state_layouts import Pose
from cosim.sumo import Sumo
from cosim.world.episode import COLUMNS, Ending, Event, EventKind, FilterUse
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot
from gri.core.graph import InteractionGraph

_A = COLUMNS.index("a")
CONTACT_BRAKING = 4.0, 8.0  # [m/s²] of the slower and the faster vehicle after a contact, so that they come apart


@dataclass(frozen=True)
class PolicyControl:
    """The control of a policy over the driven roles of a round; `name` is the driver's name in the tables.

    `returning` are the vehicles that were handed back and are not yet on their own, `commanded` are the poses that were
    commanded in each step so far, with the groups that were driven. `members` are those of groups that others may join.
    """

    name: str
    round: Round
    runner: PolicyRunner
    returning: ReturningVehicles
    members: Membership | None = None
    commanded: list[tuple[Pose, Sequence[int]]] = field(default_factory=list)

    @property
    def roles(self) -> tuple[int, ...]:
        """The roles under control."""
        return self.round.driven_roles

    @property
    def graphs(self) -> Sequence[tuple[float, InteractionGraph]]:
        """The graphs that the policy used, each with its time [s]."""
        return self.runner.graphs

    @property
    def sees_nearby(self) -> bool:
        """Whether the policy looks at the vehicles around its groups."""
        return self.runner.sees_nearby

    @property
    def failures(self) -> Mapping[int, str]:
        """Groups for which the policy has given no usable answer, and why."""
        return self.runner.failures

    def take_over(self, world: Sumo, recorder: RoundRecorder, time: float) -> None:
        """Take the driven vehicles of all groups from SUMO's drivers."""
        for g in recorder.active:
            vehicles = self.round.driven_ids(g)
            for vehicle in vehicles:
                world.take(vehicle)
            recorder.add(g, Event(time, EventKind.TAKEN, vehicles))

    def decide(self, now: Snapshot) -> None:
        """Let the policy decide on the next poses."""
        self.runner.decide(now)

    def filter_use(self, group: int, end: float) -> FilterUse | None:
        """How the safety filter was used in a group until its `end` [s]; None without one."""
        return self.runner.filter_use(group, end)

    def command(self, world: Sumo, road: RoadFrame, active: Sequence[int], now: Snapshot) -> None:
        """Tell SUMO the next poses of the driven vehicles of the active groups, and guide those handed back.

        A vehicle between two lanes becomes visible in both.
        """
        self.returning.command(world, road, now)
        if not active:
            return
        this_round, pose = self.round, self.runner.pose
        self.commanded.append((pose, active))
        places = [(g, role) for g in active for role in self._driven_roles(g)]
        vehicles = [this_round.groups[g].ids[role] for g, role in places]
        at = np.array([this_round.size * g + role for g, role in places])
        s, d, heading, v = (of.ravel()[at] for of in (pose.s, pose.d, pose.heading, pose.v))
        xy, along = road.to_world(s, d)
        lanes: dict[str, str] = {}
        if this_round.lanes is not None and 0 in this_round.driven_roles:
            for g in active:
                vehicle = this_round.groups[g].ids[0]
                lanes[vehicle] = shadow_vehicles.place(
                    world, road, vehicle, pose.of(g, 0), this_round.lanes, now, this_round.dt
                )
        world.command_all(vehicles, xy, along + road.side * heading, v, lanes)

    def _driven_roles(self, g: int) -> Sequence[int]:
        """The roles of a group that the policy drives at present."""
        roles = self.round.driven_roles
        return roles if self.members is None else [role for role in roles if self.members.driven[g, role]]

    def change_roles(
        self,
        world: Sumo,
        recorder: RoundRecorder,
        observation: GroupObservation,
        now: Snapshot,
        changed: Mapping[int, Sequence[int]],
    ) -> None:
        """Let the policy know of new members, and hand back the driven vehicles that lost their role.

        `observation` is that of the new members, as the policy gets it; `changed` are the roles by group.
        """
        assert self.members is not None
        pose = self.runner.pose
        for g, roles in changed.items():
            for role in roles:
                vehicle = self.members.ids[g][role]
                if vehicle:
                    recorder.add(g, Event(now.time, EventKind.JOINED, (vehicle,), f"as {role}"))
                old = self.round.groups[g].ids[role]
                if self.members.driven_until(g, role) == now.time and old in now.row_of:
                    lateral_speed = float(pose.v[g, role] * np.sin(pose.heading[g, role]))
                    self.returning.hand_back(world, old, float(pose.a[g, role]), lateral_speed, checked=True)
                    recorder.add(g, Event(now.time, EventKind.HANDED_BACK, (old,), "left the group"))
        lengths = {g: self.members.lengths(now, g) for g in changed}
        self.runner.change_roles(changed, self.members.ids, lengths, observation, self.members.driven.copy())

    def with_commanded_acceleration(self, observation: GroupObservation, active: Sequence[int]) -> GroupObservation:
        """The observation with the dynamics' acceleration of the driven vehicles."""
        return self.runner.with_commanded_acceleration(observation, active)

    def verify(self, observations: Sequence[GroupObservation], recorder: RoundRecorder) -> None:
        """Record driven vehicles that were not where they had been commanded to be; `observations` are of each step."""
        recorder.verify(observations, self.commanded)

    def hand_back(
        self,
        world: Sumo,
        road: RoadFrame,
        recorder: RoundRecorder,
        observation: GroupObservation,
        now: Snapshot,
        ended: Set[int],
    ) -> None:
        """Begin to hand the driven vehicles of the groups that ended back to SUMO's drivers, or to stop them."""
        pose = self.runner.pose
        for g in sorted(ended):
            ids, roles = self._ids(g), self._driven_roles(g)
            must_stop = self._must_stop(world, recorder, observation, now, g)
            for vehicle, braking in must_stop.items():
                a = observation.state[g, ids.index(vehicle), _A] if vehicle in ids else now.a[now.row_of[vehicle]]
                self.returning.stop(world, vehicle, stop_of(now, road, vehicle, float(a), braking))
            for role in roles:
                if ids[role] not in must_stop and observation.valid[g, role]:
                    lateral_speed = float(pose.v[g, role] * np.sin(pose.heading[g, role]))
                    a, checked = float(observation.state[g, role, _A]), recorder.endings[g] is not Ending.CONTACT
                    self.returning.hand_back(world, ids[role], a, lateral_speed, checked=checked)
                elif not observation.valid[g, role]:
                    world.remove_shadow(ids[role])
            driven = tuple(ids[role] for role in roles)
            recorder.add(g, Event(observation.time, EventKind.HANDED_BACK, driven, recorder.endings[g].value))

    def _must_stop(
        self, world: Sumo, recorder: RoundRecorder, observation: GroupObservation, now: Snapshot, g: int
    ) -> dict[str, float]:
        """The vehicles that must brake to a standstill where a group ended, with their braking [m/s²].

        These are both vehicles of a contact, vehicle 0 at the end of its lane, and driven vehicles beside the road. An
        outsider in contact stops too, unless others command it, as they do recorded vehicles.
        """
        ids, ending = self._ids(g), recorder.endings[g]
        driven = {ids[role] for role in self._driven_roles(g) if observation.valid[g, role]}
        must_stop = {v for v in driven if not now.lane[now.row_of[v]] or (ending is Ending.LANE_END and v == ids[0])}
        braking = {vehicle: world.drivers.braking(vehicle) for vehicle in sorted(must_stop)}
        for pair in recorder.touching.get(g, ()):
            by_speed = sorted(pair, key=lambda vehicle: now.v[now.row_of[vehicle]])
            for vehicle, value in zip(by_speed, CONTACT_BRAKING, strict=True):
                if vehicle in driven or not world.is_taken(vehicle):
                    braking[vehicle] = max(value, braking.get(vehicle, 0.0))
        return braking

    def _ids(self, g: int) -> Sequence[str]:
        """The present members of a group."""
        return self.round.groups[g].ids if self.members is None else self.members.ids[g]

    def observe(self, observation: GroupObservation, active: Sequence[int], around: Around | None = None) -> None:
        """Show the policy the new states, and the vehicles around."""
        self.runner.observe(observation, active, around)


@dataclass(frozen=True)
class SumoControl:
    """No policy: SUMO, or the recording, moves every vehicle of a round; `name` says which of both."""

    name: str
    roles: ClassVar[tuple[int, ...]] = ()
    sees_nearby: ClassVar[bool] = False
    graphs: ClassVar[Sequence[tuple[float, InteractionGraph]]] = ()
    failures: ClassVar[Mapping[int, str]] = MappingProxyType({})

    def take_over(self, world: Sumo, recorder: RoundRecorder, time: float) -> None:
        """Take no vehicle."""

    def decide(self, now: Snapshot) -> None:
        """Decide nothing."""

    def filter_use(self, group: int, end: float) -> FilterUse | None:
        """No filter."""
        del group, end

    def command(self, world: Sumo, road: RoadFrame, active: Sequence[int], now: Snapshot) -> None:
        """Command nothing."""

    def with_commanded_acceleration(self, observation: GroupObservation, active: Sequence[int]) -> GroupObservation:
        """The observation as it is."""
        del active
        return observation

    def change_roles(
        self,
        world: Sumo,
        recorder: RoundRecorder,
        observation: GroupObservation,
        now: Snapshot,
        changed: Mapping[int, Sequence[int]],
    ) -> None:
        """Nobody has to be told."""

    def verify(self, observations: Sequence[GroupObservation], recorder: RoundRecorder) -> None:
        """Nothing was commanded."""

    def hand_back(
        self,
        world: Sumo,
        road: RoadFrame,
        recorder: RoundRecorder,
        observation: GroupObservation,
        now: Snapshot,
        ended: Set[int],
    ) -> None:
        """Hand nothing back."""

    def observe(self, observation: GroupObservation, active: Sequence[int], around: Around | None = None) -> None:
        """Show nothing to any policy."""


@dataclass(frozen=True)
class SumoDriverControl(SumoControl):
    """SUMO's drivers in the place of recorded ones, from the take-over on; they keep their lanes."""

    round: Round

    def take_over(self, world: Sumo, recorder: RoundRecorder, time: float) -> None:
        """Give the driven vehicles of all groups to SUMO's drivers."""
        for g in recorder.active:
            vehicles = self.round.driven_ids(g)
            for vehicle in vehicles:
                world.release(vehicle)
                world.forbid_lane_changes(vehicle)
            recorder.add(g, Event(time, EventKind.TAKEN, vehicles))

    def hand_back(
        self,
        world: Sumo,
        road: RoadFrame,
        recorder: RoundRecorder,
        observation: GroupObservation,
        now: Snapshot,
        ended: Set[int],
    ) -> None:
        """Take note of the end; SUMO's drivers go on."""
        for g in sorted(ended):
            event = Event(observation.time, EventKind.HANDED_BACK, self.round.driven_ids(g), recorder.endings[g].value)
            recorder.add(g, event)


Control = PolicyControl | SumoControl
