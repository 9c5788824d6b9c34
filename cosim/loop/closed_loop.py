"""The main loop: traffic runs, groups are found, a branch of the simulation drives them, traffic goes on.

Every round of groups is driven in a branch that shares its past with the trunk bit for bit, while the trunk leaves the
same groups to SUMO. So each driven group has its own counterpart, and every policy gets the same groups.
"""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context

from cosim.loop.driving import Driver, drive, start_round
from cosim.loop.intervention import Intervention, NoIntervention
from cosim.loop.own_policy import OwnPolicy
from cosim.loop.perturbed_round import intervention_for
from cosim.loop.round_recorder import Round
from cosim.loop.trunk import Progress, Trunk
from cosim.perturb.displaced_starts import Infeasible
from cosim.process.fork import CAN_FORK, Branch, fork
from cosim.process.guarded_calls import CallGuard, survive
from cosim.spec.scenario import Scenario
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SimulationInput, SumoFiles, prepare_simulation
from cosim.world.break_ups import compared
from cosim.world.episode import INTERRUPTED, Episode
from cosim.world.groups import Group
from cosim.world.snapshot import Snapshot


@dataclass(frozen=True)
class Outcome:
    """All episodes of a run, and the same groups left to SUMO, in the same order.

    `excluded` are the groups whose perturbed start is infeasible. `teleports` and `collisions` are of the trunk.
    """

    episodes: tuple[Episode, ...]
    left_to_sumo: tuple[Episode, ...]
    excluded: tuple[tuple[Group, Infeasible], ...]
    simulated: float
    """Simulated time [s]."""
    teleports: int
    """Vehicles that SUMO teleported."""
    collisions: int
    """Steps with a collision in SUMO's list."""


def run(
    scenario: Scenario,
    files: SumoFiles,
    driver: Driver | None,
    progress: Progress,
    *,
    forking: bool = CAN_FORK,
) -> Outcome:
    """Run a scenario until its number of episodes is reached or its time limit is over.

    Episodes that another vehicle ended (INTERRUPTED) are kept but do not count. With `driver=None` no vehicle is driven
    (the null run). Without `forking` every branch simulates the past again, from t = 0, in a process of its own; the
    results are the same.

    Perturbations of the traffic affect the trunk and the branches, all others the branches only. With perturbations and
    `driver=None` SUMO drives the perturbed groups in a branch.

    Raises InputError where the scenario does not fit its net or recording, SumoError where SUMO refuses.
    """
    inputs = prepare_simulation(scenario, files, scenario.time_limit)
    inputs.write()
    scenario = inputs.scenario
    driven: list[Episode] = []
    left: list[Episode] = []
    excluded: list[tuple[Group, Infeasible]] = []
    without_branches = driver is None and not scenario.perturbations
    counted = left if without_branches else driven
    with simulation(inputs) as running:
        trunk = Trunk(running, scenario)
        trunk.warm_up(progress)
        while (count := _count(counted)) < scenario.episodes and trunk.time < inputs.end:
            progress("episodes", count, scenario.episodes)
            history = trunk.observe_history()
            found = trunk.find_groups(history, limit=scenario.episodes - count)
            intervention = intervention_for(scenario, history[-1], found)
            excluded += intervention.excluded
            this_round = intervention.round
            if not this_round.groups:
                continue
            if without_branches:
                left += trunk.leave_to_sumo(history, this_round)
            elif forking:
                branch = _forked(running, history, intervention, driver)
                left += trunk.leave_to_sumo(history, this_round)
                driven += branch.result()
            else:
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                    branch = pool.submit(_drive_from_start, inputs, trunk.steps, this_round, driver)
                    left += trunk.leave_to_sumo(history, this_round)
                    driven += branch.result()
        progress("episodes", min(count, scenario.episodes), scenario.episodes)
        left = [compared(episode, episode) for episode in left]
        counted = [compared(*both) for both in zip(counted, left, strict=True)]
        return Outcome(tuple(counted), tuple(left), tuple(excluded), trunk.time, trunk.teleports, trunk.collisions)


def _forked(
    running: RunningSimulation,
    history: Sequence[Snapshot],
    intervention: Intervention | NoIntervention,
    driver: Driver | None,
) -> Branch[list[Episode]]:
    """Drive a round in a copy of this process. A policy of the user is not even called in this process."""
    if driver is not None and isinstance(own := driver.policy, OwnPolicy):

        def attempt(guard: CallGuard) -> list[Episode]:
            guarded = replace(driver, policy=replace(own, guard=guard))
            return drive(running.world, running.frame, start_round(running.frame, history, intervention, guarded))

        return fork(lambda: survive(attempt, own.limit))
    start = start_round(running.frame, history, intervention, driver)
    return fork(lambda: drive(running.world, running.frame, start))


def _drive_from_start(inputs: SimulationInput, steps: int, this_round: Round, driver: Driver | None) -> list[Episode]:
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
        intervention = intervention_for(scenario, history[-1], this_round)
        return drive(running.world, running.frame, start_round(running.frame, history, intervention, driver))


def _count(episodes: Sequence[Episode]) -> int:
    """How many episodes count."""
    return sum(episode.ending not in INTERRUPTED for episode in episodes)
