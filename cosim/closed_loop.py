"""The main loop: traffic runs, groups are found, a branch of the simulation drives them, traffic goes on.

Every round of groups is driven in a branch that shares its past with the trunk bit for bit, while the trunk leaves the
same groups to SUMO. So each driven group has its own counterpart, and whoever drives gets the same groups.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from cosim.branch import CAN_FORK, fork
from cosim.driving import Round, drive
from cosim.episode import INTERRUPTED, Episode
from cosim.frames import RoadFrame
from cosim.groups import select
from cosim.scenario import Scenario
from cosim.sumo import Snapshot, Sumo, sumo
from cosim.traffic import arguments, route_file
from gri.errors import InputError
from gri.policy import Policy

Tell = Callable[[str, int, int], None]  # (what, done, of)
WARM_UP_CHUNKS = 50  # how often progress is told during the warm-up


@dataclass(frozen=True)
class Files:
    """What SUMO reads and writes: the net, the route file and the log of its messages."""

    net: Path
    routes: Path
    log: Path


@dataclass(frozen=True)
class Outcome:
    """All episodes of a run, and the same groups left to SUMO, in the same order."""

    episodes: tuple[Episode, ...]
    left_to_sumo: tuple[Episode, ...]
    simulated: float  # [s] of simulated time
    teleports: int  # of any vehicle in the trunk
    collisions: int  # steps with a collision in SUMO's list, in the trunk


@dataclass(frozen=True)
class RunningRoad:
    """A running simulation and its road."""

    world: Sumo
    frame: RoadFrame


def run(
    scenario: Scenario,
    files: Files,
    policy: Policy | None,
    driver: str,
    tell: Tell,
    *,
    forking: bool = CAN_FORK,
) -> Outcome:
    """Run a scenario until its number of episodes is reached or its time limit is over.

    Episodes that something else ended (INTERRUPTED) are kept but do not count. With `policy=None` nobody is driven:
    the null run. Without `forking` every branch replays the past from t = 0 in a process of its own; the results are
    the same.
    """
    end = scenario.traffic.warm_up + scenario.time_limit
    files.routes.write_text(route_file(scenario.traffic, scenario.seed, end))
    driven: list[Episode] = []
    left: list[Episode] = []
    with simulation(scenario, files) as road:
        trunk = Trunk(road, scenario)
        trunk.warm_up(tell)
        while (count := _counted(driven if policy else left)) < scenario.episodes and trunk.time < end:
            tell("episodes", count, scenario.episodes)
            history = trunk.watch()
            task = trunk.find(history, limit=scenario.episodes - count)
            if not task.groups:
                continue
            if policy is None:
                left += trunk.leave(history, task)
            elif forking:
                branch = fork(lambda: drive(road.world, road.frame, history, task, policy, driver))  # noqa: B023
                left += trunk.leave(history, task)
                driven += branch.result()
            else:
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                    replay = pool.submit(_replay, scenario, files, trunk.steps, task, policy, driver)
                    left += trunk.leave(history, task)
                    driven += replay.result()
        tell("episodes", min(count, scenario.episodes), scenario.episodes)
        return Outcome(
            tuple(left if policy is None else driven),
            tuple(left),
            trunk.time,
            trunk.teleports,
            trunk.collisions,
        )


class Trunk:
    """The undisturbed traffic: steps on, remembers what it saw go wrong, and which vehicles were taken already."""

    def __init__(self, road: RunningRoad, scenario: Scenario) -> None:
        self._road, self._scenario = road, scenario
        self._used: set[str] = set()
        self.steps, self.time, self.teleports, self.collisions = 0, 0.0, 0, 0

    def _step(self) -> None:
        report = self._road.world.step()
        self.steps, self.time = self.steps + 1, report.time
        self.teleports += len(report.teleported)
        self.collisions += bool(report.collisions)

    def warm_up(self, tell: Tell) -> None:
        """Run until the end of the warm-up."""
        total = self._scenario.steps(self._scenario.traffic.warm_up)
        for k in range(total):
            if k % max(total // WARM_UP_CHUNKS, 1) == 0:
                tell("warm-up", k, total)
            self._step()
        tell("warm-up", total, total)

    def watch(self) -> list[Snapshot]:
        """Let the traffic rest from the last round, then watch it for the length of the history."""
        for _ in range(self._scenario.steps(self._scenario.rest)):
            self._step()
        history = []
        for _ in range(self._scenario.steps(self._scenario.history)):
            self._step()
            history.append(self._road.world.snapshot(self._road.frame))
        return history

    def find(self, history: Sequence[Snapshot], limit: int) -> Round:
        """The next round: groups with enough road ahead whose vehicles nobody took before."""
        scenario, now = self._scenario, history[-1]
        main = set(scenario.road.edges)
        reach = now.s + now.v * scenario.horizon
        inside = [v for v, s in zip(now.ids, reach, strict=True) if s <= scenario.road.length]
        staying = {v for v in inside if v not in self._used and set(self._road.world.route(v)[1:]) <= main}
        groups = select(
            history,
            scenario.group,
            zone=(0.0, scenario.road.length),
            eligible=frozenset(staying),
            limit=min(limit, scenario.groups_at_once),
        )
        self._used |= {vehicle for group in groups for vehicle in group.ids}
        steps = scenario.steps
        return Round(tuple(groups), steps(scenario.horizon), steps(scenario.watch), scenario.step)

    def leave(self, history: Sequence[Snapshot], task: Round) -> list[Episode]:
        """Leave a round to SUMO and record it."""
        episodes = drive(self._road.world, self._road.frame, history, task, None, "sumo")
        self.steps += task.driven + task.watched
        self.time = float(episodes[0].time[-1])
        return episodes


def _replay(scenario: Scenario, files: Files, steps: int, task: Round, policy: Policy, driver: str) -> list[Episode]:
    """Drive a round that begins after so many steps, in a simulation of its own."""
    watched = scenario.steps(scenario.history)
    with simulation(scenario, files) as road:
        for _ in range(steps - watched):
            road.world.step()
        history = []
        for _ in range(watched):
            road.world.step()
            history.append(road.world.snapshot(road.frame))
        return drive(road.world, road.frame, history, task, policy, driver)


@contextmanager
def simulation(scenario: Scenario, files: Files) -> Iterator[RunningRoad]:
    """Start SUMO, check the scenario against its net, and set the speed limits."""
    with sumo(arguments(scenario, str(files.net), str(files.routes), str(files.log)), files.log) as world:
        known = world.edges()
        for what, names in (
            ("road.edges", scenario.road.edges),
            ("traffic.speed_limits", scenario.traffic.speed_limits),
        ):
            if missing := [name for name in names if name not in known]:
                raise InputError(f"{what}: the net {files.net} has no edge {missing[0]!r}")
        for edge, limit in scenario.traffic.speed_limits.items():
            world.limit_speed(edge, limit)
        yield RunningRoad(world, world.road(scenario.road.edges, scenario.road.origin))


def _counted(episodes: Sequence[Episode]) -> int:
    return sum(episode.ending not in INTERRUPTED for episode in episodes)
