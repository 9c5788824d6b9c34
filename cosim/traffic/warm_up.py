"""The warm-up of a simulation: steps in which nothing is read or recorded. Needs SUMO and numpy, but no torch."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cosim.spec.scenario import Scenario
from cosim.sumo import Sumo
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SimulationInput, SumoFiles, prepare_simulation
from cosim.world.backlog import Backlog

Progress = Callable[[str, int, int], None]
"""Called with (what is done, how much is done, of how much)."""
CHUNKS = 50  # how often progress is reported


@dataclass(frozen=True)
class WarmUp:
    """What a trunk has behind it when it begins: its steps, its time [s] and the vehicles outside the net."""

    steps: int
    time: float
    backlog: Backlog


@dataclass(frozen=True)
class WarmTraffic:
    """A simulation at the end of its warm-up: what SUMO was started with, what runs, and what is behind it."""

    inputs: SimulationInput
    running: RunningSimulation
    behind: WarmUp


@contextmanager
def warm_traffic(scenario: Scenario, files: SumoFiles, progress: Progress) -> Iterator[WarmTraffic]:
    """Start the traffic of a scenario and run its warm-up.

    Raises `InputError` where the scenario does not fit its net or recording, `SumoError` where SUMO refuses.
    """
    inputs = prepare_simulation(scenario, files, scenario.time_limit)
    inputs.write()
    with simulation(inputs) as running:
        yield WarmTraffic(inputs, running, warm_up(running.world, inputs.scenario, progress))


def warm_up(world: Sumo, scenario: Scenario, progress: Progress) -> WarmUp:
    """Run a simulation that has just been started until the end of its warm-up."""
    total = scenario.steps(scenario.traffic.warm_up)
    time, backlog = 0.0, Backlog()
    for k in range(total):
        if k % max(total // CHUNKS, 1) == 0:
            progress("warm-up", k, total)
            backlog = backlog.updated(world.waiting(), time)
        time = world.step().time
    backlog = backlog.updated(world.waiting(), time)
    progress("warm-up", total, total)
    return WarmUp(total, time, backlog)
