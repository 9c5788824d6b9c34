"""The trunk: the undisturbed traffic, in which groups are found and left to SUMO."""

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from cosim.loop.driving import drive, start_round
from cosim.loop.intervention import NoIntervention
from cosim.loop.round_recorder import Round
from cosim.loop.vehicles_ahead import SpeedRecord, vehicles_ahead
from cosim.spec.scenario import Scenario
from cosim.traffic.running_simulation import RunningSimulation
from cosim.traffic.warm_up import Progress, WarmUp
from cosim.world.episode import Episode
from cosim.world.group_search import GroupSearch, search_groups
from cosim.world.snapshot import Snapshot

BETWEEN_ATTEMPTS = 1.0  # [s] between two attempts to find groups
FASTEST = 70.0  # [m/s], of any vehicle


@dataclass(frozen=True)
class TakeOver:
    """An instant at which groups were found: the history up to it, and the round of these groups."""

    history: tuple[Snapshot, ...]
    found: Round

    @property
    def now(self) -> Snapshot:
        """The traffic at the take-over."""
        return self.history[-1]


class Trunk:
    """Steps the undisturbed traffic, and remembers the vehicles it took for groups and why there were not more.

    It begins where a warm-up (`cosim.traffic.warm_up`) has ended. `steps` and `time` [s] count from the start of the
    simulation. `search` is the sum of all searches for groups, `backlog` the vehicles outside the net when they were
    counted last.
    """

    def __init__(self, running: RunningSimulation, scenario: Scenario, begin: WarmUp) -> None:
        self._running, self._scenario = running, scenario
        self._used: set[str] = set()
        self._history: deque[Snapshot] = deque(maxlen=scenario.steps(scenario.history))
        self.steps, self.time, self.backlog = begin.steps, begin.time, begin.backlog
        self.search = GroupSearch()

    def _step(self) -> None:
        report = self._running.world.step()
        self.steps, self.time = self.steps + 1, report.time

    def _count_waiting(self) -> None:
        self.backlog = self.backlog.updated(self._running.world.waiting(), self.time)

    def observe_history(self) -> tuple[Snapshot, ...]:
        """Run on until a history is complete, and return it.

        At first, and after each round, that takes the scenario's rest and a whole history. Otherwise the history moves
        on by `BETWEEN_ATTEMPTS`. Its last snapshot has all vehicles, the others have those that could be in a group.
        """
        scenario, running, steps = self._scenario, self._running, self._scenario.steps
        way = FASTEST * scenario.history
        span = -way, scenario.road.length + way
        wanted = steps(scenario.history)
        if not self._history:
            for _ in range(steps(scenario.rest)):
                self._step()
        more = max(wanted - len(self._history), steps(BETWEEN_ATTEMPTS), 1)
        for k in range(more):
            self._step()
            self._history.append(running.world.snapshot(running.frame, span=None if k == more - 1 else span))
        self._count_waiting()
        return tuple(self._history)

    def next_take_over(self, left: int, end: float, progress: Progress) -> TakeOver | None:
        """Go on to the next instant with groups, when `left` groups have been left to SUMO.

        None when there are as many as the scenario has episodes, or at the `end` [s].
        """
        episodes = self._scenario.episodes
        while left < episodes and self.time < end:
            progress("episodes", left, episodes)
            history = self.observe_history()
            found = self.find_groups(history, limit=episodes - left)
            if found.groups:
                return TakeOver(history, found)
        return None

    def find_groups(self, history: Sequence[Snapshot], limit: int) -> Round:
        """The next round: at most `limit` groups with enough road ahead, of vehicles that were in no group before."""
        scenario = self._scenario
        found = search_groups(
            history,
            scenario.group,
            zone=(0.0, scenario.road.length),
            barred=self._barred(history[-1]),
            limit=min(limit, scenario.groups_at_once),
            lanes=self._running.lanes,
        )
        groups = found.groups
        self.search += found
        self._used |= {vehicle for group in groups for vehicle in group.ids}
        return Round(
            groups=groups,
            rule=scenario.group,
            driven_roles=scenario.driven_roles,
            driven_steps=scenario.steps(scenario.horizon),
            watched_steps=scenario.steps(scenario.watch),
            dt=scenario.step,
            lanes=self._running.lanes,
            default_driver="sumo" if self._running.recorded is None else "recorded",
            records_surroundings=scenario.surroundings,
        )

    def _barred(self, now: Snapshot) -> dict[str, str]:
        """The vehicles inside the study area that cannot be in a group, each with the reason."""
        scenario, barred, lanes = self._scenario, {}, self._running.lanes
        ramp = {lane.rpartition("_")[0] for lane in lanes.source_ids} if lanes and lanes.path else set()
        recorded = self._running.recorded
        lasting = None if recorded is None else recorded.present_for(scenario.horizon)
        reach = now.s + now.v * scenario.horizon
        for vehicle, s, until in zip(now.ids, now.s.tolist(), reach.tolist(), strict=True):
            if not 0 <= s <= scenario.road.length:
                continue
            if vehicle in self._used:
                barred[vehicle] = "in an earlier group"
            elif until > scenario.road.length:
                barred[vehicle] = "too near to the end of the study area for the horizon"
            elif not _stays_on(scenario.road.edges, self._running.world.route_ahead(vehicle), ramp):
                barred[vehicle] = "not on the main road, or leaving it"
            elif lasting is not None and vehicle not in lasting:
                barred[vehicle] = "recorded for less than the horizon"
        return barred

    def leave_to_sumo(self, history: Sequence[Snapshot], this_round: Round) -> tuple[list[Episode], SpeedRecord]:
        """Record a round that no policy drives, and the speeds ahead of it; the next history begins after it."""
        running, now = self._running, history[-1]
        speeds = SpeedRecord(vehicles_ahead(this_round.groups, now) if running.recorded is None else ())
        start = start_round(running.frame, history, NoIntervention(this_round, recorded=speeds), driver=None)
        episodes = drive(running.world, running.frame, start)
        self.steps += len(episodes[0].time) - len(history)
        self._history.clear()
        self.time = float(episodes[0].time[-1])
        return episodes, speeds


def _stays_on(road: Sequence[str], route_ahead: Sequence[str], ramp: Collection[str]) -> bool:
    """Whether a vehicle is on the main road, or a ramp to it, and stays there until its end, whatever follows."""
    end = route_ahead.index(road[-1]) + 1 if road[-1] in route_ahead else len(route_ahead)
    return bool(route_ahead) and set(route_ahead[:end]) <= {*road, *ramp}
