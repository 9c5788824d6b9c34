"""The main loop: traffic runs, groups are found, branches of the simulation drive them, traffic goes on.

Every round of groups is driven in branches that share their past with the trunk bit for bit, while the trunk leaves the
same groups to SUMO. So each driven group has its own counterpart, and every policy gets the same groups. The groups of
one branch are isolated from each other, and the vehicles ahead of them move as in the trunk.
"""

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
from cosim.loop.trunk import Trunk
from cosim.loop.vehicles_ahead import SpeedRecord
from cosim.perturb.displaced_starts import Infeasible
from cosim.perturb.effects import Effect
from cosim.process.fork import CAN_FORK, fork, fork_and_send
from cosim.process.guarded_calls import CallGuard, survive
from cosim.spec.scenario import Replay, Scenario
from cosim.traffic.reacting_vehicles import Release
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SimulationInput, SumoFiles
from cosim.traffic.warm_up import Progress, WarmTraffic, warm_traffic
from cosim.world.backlog import Backlog
from cosim.world.break_ups import compared
from cosim.world.episode import Episode, Event, EventKind
from cosim.world.group_search import GroupSearch
from cosim.world.groups import Group, isolated
from cosim.world.snapshot import Snapshot
from gri.errors import InputError
from gri.processes import end_with_parent


@dataclass(frozen=True)
class SumoCounts:
    """What SUMO reported: teleported vehicles, and steps with a collision in its list."""

    teleports: int = 0
    collision_steps: int = 0

    def __add__(self, other: "SumoCounts") -> "SumoCounts":
        return SumoCounts(self.teleports + other.teleports, self.collision_steps + other.collision_steps)


@dataclass(frozen=True)
class Outcome:
    """All episodes of a run, and the same groups left to SUMO, in the same order.

    `excluded` are the groups whose perturbed start is infeasible. `search` says which groups were found and which rules
    the other candidates failed.
    """

    episodes: tuple[Episode, ...]
    left_to_sumo: tuple[Episode, ...]
    excluded: tuple[tuple[Group, Infeasible], ...]
    search: GroupSearch
    simulated: float
    """Simulated time [s]."""
    trunk: SumoCounts
    """In all steps of the trunk, the rounds left to SUMO included."""
    branches: SumoCounts
    """In all branches, from their take-overs on."""
    backlog: Backlog
    """Vehicles that could not enter the net."""
    effects: tuple[Effect, ...] = ()
    """What the perturbations reached in each driven group; those of the traffic are measured elsewhere."""


BranchResult = tuple[list[Episode], SumoCounts, list[Effect]]
"""The episodes of a round, what SUMO reported, and what the perturbations reached."""


@dataclass(frozen=True)
class Branch:
    """A branch at its take-over: `go_on` gives it the speeds of the vehicles ahead, `result` waits for its end."""

    go_on: Callable[[SpeedRecord], None]
    result: Callable[[], BranchResult]


def run(
    scenario: Scenario,
    files: SumoFiles,
    driver: Driver | None,
    progress: Progress,
    *,
    forking: bool = CAN_FORK,
) -> Outcome:
    """Run a scenario until its number of episodes has begun or its time limit is over.

    Every feasible start counts, however its drive ends, so all policies get the same starts. With `driver=None` no
    vehicle is driven (the null run). Without `forking` every branch simulates the past again, from t = 0, in a process
    of its own; the results are the same.

    Perturbations of the traffic affect the trunk and the branches, all others the branches only. With perturbations and
    `driver=None` SUMO drives the perturbed groups in a branch.

    Raises InputError where the scenario does not fit its net or recording, SumoError where SUMO refuses.
    """
    with warm_traffic(scenario, files, progress) as warm:
        return run_on(warm, driver, progress, forking=forking)


def run_on(warm: WarmTraffic, driver: Driver | None, progress: Progress, *, forking: bool = CAN_FORK) -> Outcome:
    """`run`, from the end of the warm-up on."""
    inputs, running, scenario = warm.inputs, warm.running, warm.inputs.scenario
    trunk = Trunk(running, scenario, warm.behind)
    left: list[Episode] = []
    driven: dict[Group, Episode] = {}
    excluded: list[tuple[Group, Infeasible]] = []
    branches: list[Branch] = []
    in_branches = SumoCounts()
    effects: list[Effect] = []
    without_branches = driver is None and not scenario.perturbations
    overlap = isinstance(scenario.background, Replay) and scenario.background.overlap
    if overlap and not forking:
        raise InputError("background.overlap: rounds that overlap need fork, which this system lacks; leave it out")
    while len(left) < scenario.episodes and trunk.time < inputs.end:
        progress("episodes", len(left), scenario.episodes)
        history = trunk.observe_history()
        found = trunk.find_groups(history, limit=scenario.episodes - len(left))
        rounds = [dataclasses.replace(found, groups=groups) for groups in isolated(found.groups, history[-1])]
        planned = [(asked, intervention_for(scenario, history[-1], asked)) for asked in rounds]
        excluded += [pair for _, intervention in planned for pair in intervention.excluded]
        feasible = {group for _, intervention in planned for group in intervention.round.groups}
        if not feasible:
            continue
        in_branches += _collect(branches, driven, effects)  # they ran while the trunk went on
        branches = [
            _forked(running, history, intervention, driver)
            if forking
            else _replayed(inputs, trunk.steps, asked, driver)
            for asked, intervention in planned
            if intervention.round.groups and not without_branches
        ]
        together = tuple(group for group in found.groups if group in feasible)
        this_round = dataclasses.replace(found, groups=together)
        if overlap:
            episodes, speeds = fork(lambda: trunk.leave_to_sumo(history, this_round)).result()  # noqa: B023
        else:
            episodes, speeds = trunk.leave_to_sumo(history, this_round)
        left += episodes
        for branch in branches:
            branch.go_on(speeds)
    progress("episodes", len(left), scenario.episodes)
    in_branches += _collect(branches, driven, effects)
    left = [compared(episode, episode) for episode in left]
    return Outcome(
        episodes=tuple(left if without_branches else (compared(driven[own.group], own) for own in left)),
        left_to_sumo=tuple(left),
        excluded=tuple(excluded),
        search=trunk.search,
        simulated=trunk.time,
        trunk=SumoCounts(running.world.teleports, running.world.collision_steps),
        branches=in_branches,
        backlog=trunk.backlog,
        effects=tuple(effects),
    )


def _collect(branches: Sequence[Branch], driven: dict[Group, Episode], effects: list[Effect]) -> SumoCounts:
    """Wait for the branches, add to the episodes `driven` and the `effects`, and return what SUMO reported in them."""
    total = SumoCounts()
    for branch in branches:
        episodes, counts, reached = branch.result()
        effects += reached
        driven |= {episode.group: episode for episode in episodes}
        total += counts
    return total


def _forked(
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
                return _drive(running, start_round(running.frame, history, intervention, guarded), speeds)

            return survive(attempt, own.limit)

    else:
        start = start_round(running.frame, history, intervention, driver)

        def go(speeds: SpeedRecord) -> BranchResult:
            return _drive(running, start, speeds)

    branch, send = fork_and_send(go)
    return Branch(send, branch.result)


def _replayed(inputs: SimulationInput, steps: int, asked: Round, driver: Driver | None) -> Branch:
    results: list[BranchResult] = []

    def go_on(speeds: SpeedRecord) -> None:
        with ProcessPoolExecutor(1, get_context("spawn"), end_with_parent) as pool:
            results.append(pool.submit(_drive_from_start, inputs, steps, asked, driver, speeds).result())

    return Branch(go_on, lambda: results[0])


def _drive(running: RunningSimulation, start: RoundStart, speeds: SpeedRecord) -> BranchResult:
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
        return _drive(running, start_round(running.frame, history, intervention, driver), speeds)
