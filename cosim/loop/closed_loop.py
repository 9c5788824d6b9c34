"""The main loop: traffic runs, groups are found, a branch of the simulation drives them, traffic goes on.

Every round of groups is driven in a branch that shares its past with the trunk bit for bit, while the trunk leaves the
same groups to SUMO. So each driven group has its own counterpart, and whoever drives gets the same groups.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from msgspec.structs import replace

from cosim.loop.driving import Driver, drive, start
from cosim.loop.perturbed_round import prepare
from cosim.loop.round_recorder import Round
from cosim.perturb.displaced_starts import Infeasible
from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.process.fork import CAN_FORK, fork
from cosim.spec.scenario import Merge, Replay, Scenario
from cosim.sumo import Sumo, sumo
from cosim.traffic.replay import Player, tracks_of, without_demand
from cosim.traffic.route_file import arguments, route_file, sign_file
from cosim.world.episode import INTERRUPTED, Episode
from cosim.world.groups import Group, MergeLanes, select, target_lane
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot
from gri.errors import InputError

Tell = Callable[[str, int, int], None]  # (what, done, of)
LOOK_EVERY = 1.0  # [s] between two attempts to find groups
WARM_UP_CHUNKS = 50  # how often progress is told during the warm-up


@dataclass(frozen=True)
class Files:
    """What SUMO reads and writes: the net, the route file and the log of its messages."""

    net: Path
    routes: Path
    log: Path

    @property
    def signs(self) -> Path:
        """Of variable speed signs, beside the route file."""
        return self.routes.with_suffix(".signs.xml")


@dataclass(frozen=True)
class Outcome:
    """All episodes of a run, and the same groups left to SUMO, in the same order."""

    episodes: tuple[Episode, ...]
    left_to_sumo: tuple[Episode, ...]
    excluded: tuple[tuple[Group, Infeasible], ...]  # whose perturbed start is infeasible
    simulated: float  # [s] of simulated time
    teleports: int  # of any vehicle in the trunk
    collisions: int  # steps with a collision in SUMO's list, in the trunk


@dataclass(frozen=True)
class RunningSimulation:
    """A running simulation, its road, where merges take place on it, and who moves recorded vehicles, if any."""

    world: Sumo
    frame: RoadFrame
    lanes: MergeLanes | None
    player: Player | None


def run(
    scenario: Scenario,
    files: Files,
    driver: Driver | None,
    tell: Tell,
    *,
    forking: bool = CAN_FORK,
) -> Outcome:
    """Run a scenario until its number of episodes is reached or its time limit is over.

    Episodes that something else ended (INTERRUPTED) are kept but do not count. With `driver=None` nobody is driven:
    the null run. Without `forking` every branch replays the past from t = 0 in a process of its own; the results are
    the same. Perturbations of the traffic concern everybody, all others the branch only: what is left to SUMO in the
    trunk is undisturbed, and with `driver=None` SUMO drives the perturbed groups, too, in a branch.
    """
    scenario = prepared(scenario)
    end = scenario.traffic.warm_up + scenario.time_limit
    files.routes.write_text(route_file(perturbed_traffic(scenario).traffic, scenario.seed, end))
    driven: list[Episode] = []
    left: list[Episode] = []
    excluded: list[tuple[Group, Infeasible]] = []
    nothing_done = driver is None and not scenario.perturbations
    with simulation(scenario, files) as road:
        end = end if road.player is None else min(end, road.player.end)
        trunk = Trunk(road, scenario)
        trunk.warm_up(tell)
        while (count := _counted(left if nothing_done else driven)) < scenario.episodes and trunk.time < end:
            tell("episodes", count, scenario.episodes)
            history = trunk.look()
            task = trunk.find(history, limit=scenario.episodes - count)
            intervention = prepare(scenario, history[-1], task) if scenario.perturbations else None
            if intervention is not None:
                task = intervention.task
                excluded += intervention.excluded
            if not task.groups:
                continue
            if nothing_done:
                left += trunk.leave(history, task)
            elif forking:
                begin = start(road.frame, history, task, driver, intervention)
                branch = fork(lambda: drive(road.world, road.frame, begin))  # noqa: B023
                left += trunk.leave(history, task)
                driven += branch.result()
            else:
                with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                    replay = pool.submit(_replay, scenario, files, trunk.steps, task, driver)
                    left += trunk.leave(history, task)
                    driven += replay.result()
        tell("episodes", min(count, scenario.episodes), scenario.episodes)
        return Outcome(
            tuple(left if nothing_done else driven),
            tuple(left),
            tuple(excluded),
            trunk.time,
            trunk.teleports,
            trunk.collisions,
        )


class Trunk:
    """The undisturbed traffic: steps on, remembers what it saw go wrong, and which vehicles were taken already."""

    def __init__(self, road: RunningSimulation, scenario: Scenario) -> None:
        self._road, self._scenario = road, scenario
        self._used: set[str] = set()
        self._seen: deque[Snapshot] = deque(maxlen=scenario.steps(scenario.history))
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

    def look(self) -> tuple[Snapshot, ...]:
        """A whole history: after a rest at first and after each round, else `LOOK_EVERY` later than the last one."""
        steps = self._scenario.steps
        wanted = steps(self._scenario.history)
        if not self._seen:
            for _ in range(steps(self._scenario.rest)):
                self._step()
        for _ in range(max(wanted - len(self._seen), steps(LOOK_EVERY), 1)):
            self._step()
            self._seen.append(self._road.world.snapshot(self._road.frame))
        return tuple(self._seen)

    def find(self, history: Sequence[Snapshot], limit: int) -> Round:
        """The next round: groups with enough road ahead whose vehicles nobody took before."""
        scenario, now = self._scenario, history[-1]
        main = set(scenario.road.edges)
        reach = now.s + now.v * scenario.horizon
        inside = [v for v, s in zip(now.ids, reach, strict=True) if s <= scenario.road.length]
        staying = {v for v in inside if v not in self._used and set(self._road.world.route(v)[1:]) <= main}
        if self._road.player is not None:
            staying &= self._road.player.lasting(scenario.horizon)
        groups = select(
            history,
            scenario.group,
            zone=(0.0, scenario.road.length),
            eligible=frozenset(staying),
            limit=min(limit, scenario.groups_at_once),
        )
        self._used |= {vehicle for group in groups for vehicle in group.ids}
        steps = scenario.steps
        return Round(
            groups=tuple(groups),
            rule=scenario.group,
            owned=scenario.driven,
            driven=steps(scenario.horizon),
            watched=steps(scenario.watch),
            dt=scenario.step,
            lanes=self._road.lanes,
            undriven="sumo" if self._road.player is None else "recorded",
        )

    def leave(self, history: Sequence[Snapshot], task: Round) -> list[Episode]:
        """Leave a round to SUMO and record it."""
        episodes = drive(self._road.world, self._road.frame, start(self._road.frame, history, task, None))
        self.steps += len(episodes[0].time) - len(history)
        self._seen.clear()  # what was seen before the round is no history any more
        self.time = float(episodes[0].time[-1])
        return episodes


def _replay(scenario: Scenario, files: Files, steps: int, task: Round, driver: Driver | None) -> list[Episode]:
    """Drive a round that begins after so many steps, in a simulation of its own."""
    watched = scenario.steps(scenario.history)
    with simulation(scenario, files) as road:
        for _ in range(steps - watched):
            road.world.step()
        history = []
        for _ in range(watched):
            road.world.step()
            history.append(road.world.snapshot(road.frame))
        intervention = prepare(scenario, history[-1], task) if scenario.perturbations else None
        return drive(road.world, road.frame, start(road.frame, history, task, driver, intervention))


def prepared(scenario: Scenario) -> Scenario:
    """The scenario as it is simulated: where a recording is played, the traffic has no demand of its own."""
    if not isinstance(scenario.background, Replay):
        return scenario
    return replace(scenario, traffic=without_demand(scenario.traffic))


@contextmanager
def simulation(scenario: Scenario, files: Files) -> Iterator[RunningSimulation]:
    """Start SUMO and check the scenario against its net."""
    files.signs.write_text(sign_file(scenario.traffic))
    paths = (str(path) for path in (files.net, files.routes, files.signs, files.log))
    with sumo(arguments(scenario, *paths), files.log) as world:
        known = world.net.edges()
        if missing := [edge for edge in scenario.road.edges if edge not in known]:
            raise InputError(f"road.edges: the net {files.net} has no edge {missing[0]!r}")
        frame = world.net.road(scenario.road.edges, scenario.road.origin)
        player = None
        if isinstance(scenario.background, Replay):
            tracks = tracks_of(scenario.background, scenario.step)
            player = Player(world, frame, tracks, scenario.step, scenario.background, scenario.traffic)
            world.before_step = player
        yield RunningSimulation(world, frame, _merge_lanes(world, frame, scenario), player)


def _merge_lanes(world: Sumo, road: RoadFrame, scenario: Scenario) -> MergeLanes | None:
    """Where a merge rule's lanes lie; None for other rules."""
    rule = scenario.group
    if not isinstance(rule, Merge):
        return None
    known = world.net.edges()
    for lane in (rule.lane, target_lane(rule)):
        if lane not in known:
            raise InputError(f"group.lane: got {rule.lane!r}, but the net has no lane {lane!r}; name the ending lane")
    return MergeLanes(world.net.strip(rule.lane, road), world.net.strip(target_lane(rule), road))


def _counted(episodes: Sequence[Episode]) -> int:
    return sum(episode.ending not in INTERRUPTED for episode in episodes)
