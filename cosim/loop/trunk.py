"""The trunk: the undisturbed traffic, in which groups are found and left to SUMO."""

from collections import deque
from collections.abc import Callable, Sequence

from cosim.loop.driving import drive, start_round
from cosim.loop.intervention import NoIntervention
from cosim.loop.round_recorder import Round
from cosim.spec.scenario import Scenario
from cosim.traffic.running_simulation import RunningSimulation
from cosim.world.episode import Episode
from cosim.world.groups import find_groups
from cosim.world.snapshot import Snapshot

Progress = Callable[[str, int, int], None]
"""Called with (what is done, how much is done, of how much)."""
BETWEEN_ATTEMPTS = 1.0  # [s] between two attempts to find groups
WARM_UP_CHUNKS = 50  # how often progress is reported during the warm-up


class Trunk:
    """Steps the undisturbed traffic, and remembers the vehicles it took for groups and what SUMO reported.

    `steps` and `time` [s] count from the start of the simulation, `teleports` are vehicles, `collisions` are steps with
    a collision in SUMO's list.
    """

    def __init__(self, running: RunningSimulation, scenario: Scenario) -> None:
        self._running, self._scenario = running, scenario
        self._used: set[str] = set()
        self._history: deque[Snapshot] = deque(maxlen=scenario.steps(scenario.history))
        self.steps, self.time, self.teleports, self.collisions = 0, 0.0, 0, 0

    def _step(self) -> None:
        report = self._running.world.step()
        self.steps, self.time = self.steps + 1, report.time
        self.teleports += len(report.teleported)
        self.collisions += bool(report.collisions)

    def warm_up(self, progress: Progress) -> None:
        """Run until the end of the warm-up."""
        total = self._scenario.steps(self._scenario.traffic.warm_up)
        for k in range(total):
            if k % max(total // WARM_UP_CHUNKS, 1) == 0:
                progress("warm-up", k, total)
            self._step()
        progress("warm-up", total, total)

    def observe_history(self) -> tuple[Snapshot, ...]:
        """Run on until a history is complete, and return it.

        At first, and after each round, that takes the scenario's rest and a whole history. Otherwise the history moves
        on by `BETWEEN_ATTEMPTS`.
        """
        steps = self._scenario.steps
        wanted = steps(self._scenario.history)
        if not self._history:
            for _ in range(steps(self._scenario.rest)):
                self._step()
        for _ in range(max(wanted - len(self._history), steps(BETWEEN_ATTEMPTS), 1)):
            self._step()
            self._history.append(self._running.world.snapshot(self._running.frame))
        return tuple(self._history)

    def find_groups(self, history: Sequence[Snapshot], limit: int) -> Round:
        """The next round: at most `limit` groups with enough road ahead, of vehicles that were in no group before."""
        scenario, now = self._scenario, history[-1]
        main_road = set(scenario.road.edges)
        reach = now.s + now.v * scenario.horizon
        inside = [v for v, s in zip(now.ids, reach, strict=True) if s <= scenario.road.length]
        staying = {v for v in inside if v not in self._used and set(self._running.world.route(v)[1:]) <= main_road}
        if self._running.recorded is not None:
            staying &= self._running.recorded.present_for(scenario.horizon)
        groups = find_groups(
            history,
            scenario.group,
            zone=(0.0, scenario.road.length),
            eligible=frozenset(staying),
            limit=min(limit, scenario.groups_at_once),
        )
        self._used |= {vehicle for group in groups for vehicle in group.ids}
        return Round(
            groups=tuple(groups),
            rule=scenario.group,
            driven_roles=scenario.driven,
            driven_steps=scenario.steps(scenario.horizon),
            watched_steps=scenario.steps(scenario.watch),
            dt=scenario.step,
            lanes=self._running.lanes,
            default_driver="sumo" if self._running.recorded is None else "recorded",
            reads_all=scenario.surroundings,
        )

    def leave_to_sumo(self, history: Sequence[Snapshot], this_round: Round) -> list[Episode]:
        """Record a round that no policy drives; the next history begins after it."""
        running = self._running
        start = start_round(running.frame, history, NoIntervention(this_round), driver=None)
        episodes = drive(running.world, running.frame, start)
        self.steps += len(episodes[0].time) - len(history)
        self._history.clear()
        self.time = float(episodes[0].time[-1])
        return episodes
