"""Take-over, commands and hand-back: what is sent to SUMO for the vehicles that a policy drives.

`PolicyControl` is a policy in control of its vehicles. `SumoControl` stands for no policy: its methods do nothing. The
loop in `driving` treats both alike.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

from cosim.loop import shadow_vehicles
from cosim.loop.observation import GroupObservation
from cosim.loop.policy_runner import PolicyRunner
from cosim.loop.round_recorder import Round, RoundRecorder
from cosim.sumo import Sumo
from cosim.world.episode import Event, EventKind
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot
from gri.core.graph import InteractionGraph


@dataclass(frozen=True)
class PolicyControl:
    """The control of a policy over the driven roles of a round; `name` is the driver's name in the tables."""

    name: str
    round: Round
    runner: PolicyRunner

    @property
    def roles(self) -> tuple[int, ...]:
        """The roles under control."""
        return self.round.driven_roles

    @property
    def graphs(self) -> Sequence[tuple[float, InteractionGraph]]:
        """The graphs that the policy used, each with its time [s]."""
        return self.runner.graphs

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

    def decide(self, time: float) -> None:
        """Let the policy decide on the next poses."""
        self.runner.decide(time)

    def command(self, world: Sumo, road: RoadFrame, active: Sequence[int], now: Snapshot) -> None:
        """Tell SUMO the next poses of the driven vehicles; a vehicle between two lanes becomes visible in both."""
        this_round, pose = self.round, self.runner.pose
        xy, along = road.to_world(pose.s.ravel(), pose.d.ravel())
        points, headings, speeds = xy.tolist(), (along + pose.heading.ravel()).tolist(), pose.v.ravel().tolist()
        for g in active:
            for role in this_round.driven_roles:
                vehicle, lane, k = this_round.groups[g].ids[role], "", 3 * g + role
                if this_round.lanes is not None and role == 0:
                    lane = shadow_vehicles.place(
                        world, road, vehicle, pose.of(g, role), this_round.lanes, now, this_round.dt
                    )
                world.command(vehicle, points[k][0], points[k][1], headings[k], speeds[k], lane)

    def verify(self, observation: GroupObservation, active: Sequence[int], recorder: RoundRecorder) -> GroupObservation:
        """Record driven vehicles that are not where they were commanded to be.

        Returns the observation with the dynamics' acceleration of the driven vehicles.
        """
        recorder.verify(observation, self.runner.pose)
        return self.runner.with_commanded_acceleration(observation, active)

    def hand_back(self, world: Sumo, recorder: RoundRecorder, observation: GroupObservation, ended: Set[int]) -> None:
        """Hand the driven vehicles of the groups that ended back to SUMO's drivers, at once."""
        for g in sorted(ended):
            ids = self.round.groups[g].ids
            for role in self.round.driven_roles:
                world.remove_shadow(ids[role])
                if observation.valid[g, role]:
                    world.release(ids[role])
            event = Event(observation.time, EventKind.HANDED_BACK, self.round.driven_ids(g), recorder.endings[g].value)
            recorder.add(g, event)

    def observe(self, observation: GroupObservation, active: Sequence[int]) -> None:
        """Show the policy the new states."""
        self.runner.observe(observation, active)


@dataclass(frozen=True)
class SumoControl:
    """No policy: SUMO, or the recording, moves every vehicle of a round; `name` says which of both."""

    name: str
    roles: ClassVar[tuple[int, ...]] = ()
    graphs: ClassVar[Sequence[tuple[float, InteractionGraph]]] = ()
    failures: ClassVar[Mapping[int, str]] = MappingProxyType({})

    def take_over(self, world: Sumo, recorder: RoundRecorder, time: float) -> None:
        """Take no vehicle."""

    def decide(self, time: float) -> None:
        """Decide nothing."""

    def command(self, world: Sumo, road: RoadFrame, active: Sequence[int], now: Snapshot) -> None:
        """Command nothing."""

    def verify(self, observation: GroupObservation, active: Sequence[int], recorder: RoundRecorder) -> GroupObservation:
        """The observation as it is."""
        del active, recorder
        return observation

    def hand_back(self, world: Sumo, recorder: RoundRecorder, observation: GroupObservation, ended: Set[int]) -> None:
        """Hand nothing back."""

    def observe(self, observation: GroupObservation, active: Sequence[int]) -> None:
        """Show nothing to any policy."""


Control = PolicyControl | SumoControl
