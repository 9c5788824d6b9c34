"""Branches: copies of the simulation in which a round is driven, from its take-over on."""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

from cosim.loop.drive_effects import drive_and_measure
from cosim.loop.driving import Driver, RoundStart, start_round
from cosim.loop.intervention import Intervention, NoIntervention
from cosim.loop.own_policy import OwnPolicy
from cosim.loop.perturbed_round import intervention_for
from cosim.loop.round_recorder import Round
from cosim.loop.vehicles_ahead import SpeedRecord
from cosim.perturb.effects import Effect
from cosim.process.fork import fork_and_send
from cosim.process.guarded_calls import CallGuard, survive
from cosim.traffic.reacting_vehicles import Release
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SimulationInput
from cosim.world.episode import Episode, Event, EventKind
from cosim.world.snapshot import Snapshot
from gri.processes import end_with_parent


@dataclass(frozen=True)
class SumoCounts:
    """What SUMO reported: teleported vehicles, and steps with a collision in its list."""

    teleports: int = 0
    collision_steps: int = 0

    def __add__(self, other: "SumoCounts") -> "SumoCounts":
        return SumoCounts(self.teleports + other.teleports, self.collision_steps + other.collision_steps)


BranchResult = tuple[list[Episode], SumoCounts, list[Effect]]
"""The episodes of a round, what SUMO reported, and what the perturbations reached."""


@dataclass(frozen=True)
class Branch:
    """A branch at its take-over: `go_on` gives it the speeds of the vehicles ahead, `result` waits for its end."""

    go_on: Callable[[SpeedRecord], None]
    result: Callable[[], BranchResult]


def forked(
    running: RunningSimulation,
    history: Sequence[Snapshot],
    intervention: Intervention | NoIntervention,
    driver: Driver | None,
) -> Branch:
    """A copy of this process in which a round is driven. A policy of the user is not even called in this process."""
    if driver is not None and isinstance(own := driver.policy, OwnPolicy):

        def go(speeds: SpeedRecord) -> BranchResult:
            def attempt(guard: CallGuard) -> BranchResult:
                guarded = dataclasses.replace(driver, policy=dataclasses.replace(own, guard=guard))
                return drive_branch(running, start_round(running.frame, history, intervention, guarded), speeds)

            return survive(attempt, own.limit)

    else:
        start = start_round(running.frame, history, intervention, driver)

        def go(speeds: SpeedRecord) -> BranchResult:
            return drive_branch(running, start, speeds)

    branch, send = fork_and_send(go)
    return Branch(send, branch.result)


def replayed(inputs: SimulationInput, steps: int, asked: Round, driver: Driver | None) -> Branch:
    """A branch in a process of its own, which simulates the first `steps` again."""
    results: list[BranchResult] = []

    def go_on(speeds: SpeedRecord) -> None:
        with ProcessPoolExecutor(1, get_context("spawn"), end_with_parent) as pool:
            results.append(pool.submit(_drive_from_start, inputs, steps, asked, driver, speeds).result())

    return Branch(go_on, lambda: results[0])


def drive_branch(running: RunningSimulation, start: RoundStart, speeds: SpeedRecord) -> BranchResult:
    """Drive a round whose vehicles ahead repeat the given speeds; also what SUMO reported meanwhile."""
    intervention = start.intervention.repeating(speeds, start.now)
    world = running.world
    teleports, collision_steps = world.teleports, world.collision_steps
    episodes, reached = drive_and_measure(world, running.frame, dataclasses.replace(start, intervention=intervention))
    if running.recorded is not None:
        episodes = [_with_releases(episode, running.recorded.releases) for episode in episodes]
    return episodes, SumoCounts(world.teleports - teleports, world.collision_steps - collision_steps), reached


def _with_releases(episode: Episode, releases: Sequence[Release]) -> Episode:
    """The episode with the recorded vehicles that were released because of its vehicles."""
    mine = [release for release in releases if release.root in episode.group.ids]
    found = [Event(r.time, EventKind.RELEASED, (r.vehicle,), f"behind {r.ahead}") for r in mine]
    return dataclasses.replace(episode, events=tuple(sorted([*episode.events, *found], key=lambda event: event.time)))


def _drive_from_start(
    inputs: SimulationInput, steps: int, asked: Round, driver: Driver | None, speeds: SpeedRecord
) -> BranchResult:
    """Simulate the first `steps` again, the last of which are the history, and drive the round that begins then."""
    scenario = inputs.scenario
    history_steps = scenario.steps(scenario.history)
    with simulation(inputs) as running:
        for _ in range(steps - history_steps):
            running.world.step()
        history = []
        for _ in range(history_steps):
            running.world.step()
            history.append(running.world.snapshot(running.frame))
        intervention = intervention_for(scenario, history[-1], asked)
        return drive_branch(running, start_round(running.frame, history, intervention, driver), speeds)
