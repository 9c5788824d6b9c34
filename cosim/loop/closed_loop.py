"""The main loop: traffic runs, groups are found, branches of the simulation drive them, traffic goes on.

Every round of groups is driven in branches that share their past with the trunk bit for bit, while the trunk leaves the
same groups to SUMO. So each driven group has its own counterpart, and every policy gets the same groups. The groups of
one branch are isolated from each other, and the vehicles ahead of them move as in the trunk.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

from cosim.loop.branches import Branch, SumoCounts
from cosim.loop.driving import Driver
from cosim.loop.perturbed_round import intervention_for
from cosim.loop.trunk_courses import Course, OwnCourse
from cosim.perturb.displaced_starts import Infeasible
from cosim.perturb.effects import Effect
from cosim.process.fork import CAN_FORK
from cosim.spec.scenario import Scenario
from cosim.traffic.simulation_input import SumoFiles
from cosim.traffic.warm_up import Progress, WarmTraffic, warm_traffic
from cosim.world.backlog import Backlog
from cosim.world.break_ups import compared
from cosim.world.episode import Episode
from cosim.world.group_search import GroupSearch
from cosim.world.groups import Group, isolated


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
    course = OwnCourse(warm, progress, forking=forking)
    return follow(course, warm.inputs.scenario, driver, progress)


def follow(course: Course, scenario: Scenario, driver: Driver | None, progress: Progress) -> Outcome:
    """Go along the course of a trunk, and drive every round of it in branches."""
    left: list[Episode] = []
    driven: dict[Group, Episode] = {}
    excluded: list[tuple[Group, Infeasible]] = []
    branches: list[Branch] = []
    in_branches = SumoCounts()
    effects: list[Effect] = []
    without_branches = driver is None and not scenario.perturbations
    while (take_over := course.next()) is not None:
        now, found = take_over.now, take_over.found
        rounds = [dataclasses.replace(found, groups=groups) for groups in isolated(found.groups, now)]
        planned = [(asked, intervention_for(scenario, now, asked)) for asked in rounds]
        excluded += [pair for _, intervention in planned for pair in intervention.excluded]
        feasible = {group for _, intervention in planned for group in intervention.round.groups}
        if feasible:
            in_branches += _collect(branches, driven, effects)  # they ran while the trunk went on
            branches = [
                course.branch(asked, intervention, driver)
                for asked, intervention in planned
                if intervention.round.groups and not without_branches
            ]
        episodes, speeds = course.leave(tuple(group for group in found.groups if group in feasible))
        left += episodes
        for branch in branches if feasible else ():
            branch.go_on(speeds)
    progress("episodes", len(left), scenario.episodes)
    in_branches += _collect(branches, driven, effects)
    left = [compared(episode, episode) for episode in left]
    end = course.end
    return Outcome(
        episodes=tuple(left if without_branches else (compared(driven[own.group], own) for own in left)),
        left_to_sumo=tuple(left),
        excluded=tuple(excluded),
        search=end.search,
        simulated=end.time,
        trunk=end.counts,
        branches=in_branches,
        backlog=end.backlog,
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
