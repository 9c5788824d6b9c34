"""The course of a trunk, from take-over to take-over: run here, or shared with other runs.

A trunk goes on in the same way for every policy, as no policy touches it. It depends on the scenario without its
policy, and on the groups that are left to SUMO in each round: those with a feasible start, which perturbations can
change. So the courses of runs with one warm-up are a tree. Each of its branchings is an instant at which groups were
found. A process waits there (`cosim.process.frozen_process`). Copies of it drive rounds for any run, and one copy goes
on for every choice of groups that some run has. So a counterpart is computed once for all runs that have it.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from cosim.loop.branches import Branch, BranchResult, SumoCounts, drive_branch, forked, replayed
from cosim.loop.driving import Driver, RoundStart, start_round
from cosim.loop.intervention import Intervention, NoIntervention
from cosim.loop.round_recorder import Round
from cosim.loop.trunk import TakeOver, Trunk
from cosim.loop.vehicles_ahead import SpeedRecord
from cosim.process.fork import BranchError, fork
from cosim.process.frozen_process import FrozenError, FrozenProcess, Handler, freeze
from cosim.spec.scenario import Replay, Scenario
from cosim.traffic.running_simulation import RunningSimulation
from cosim.traffic.warm_up import Progress, WarmTraffic
from cosim.world.backlog import Backlog
from cosim.world.episode import Episode
from cosim.world.group_search import GroupSearch
from cosim.world.groups import Group
from cosim.world.safety import safety_measures
from gri.errors import InputError


@dataclass(frozen=True)
class CourseEnd:
    """What a trunk has seen so far: time [s], searches for groups, what SUMO reported, vehicles outside the net."""

    time: float
    search: GroupSearch
    counts: SumoCounts
    backlog: Backlog


class OwnCourse:
    """A trunk that is run in this process: `next`, any number of `branch`, `leave`, and again."""

    def __init__(self, warm: WarmTraffic, progress: Progress, *, forking: bool) -> None:
        self._inputs, self._running, self._progress, self._forking = warm.inputs, warm.running, progress, forking
        self._trunk = Trunk(warm.running, warm.inputs.scenario, warm.behind)
        self._left = 0
        background = warm.inputs.scenario.background
        self._overlap = isinstance(background, Replay) and background.overlap
        if self._overlap and not forking:
            raise InputError("background.overlap: rounds that overlap need fork, which this system lacks; leave it out")
        self._now: TakeOver | None = None

    def next(self) -> TakeOver | None:
        """The next instant with groups; None at the end."""
        self._now = self._trunk.next_take_over(self._left, self._inputs.end, self._progress)
        return self._now

    def branch(self, asked: Round, intervention: Intervention | NoIntervention, driver: Driver | None) -> Branch:
        """A branch at that instant, in which the intervention's part of the round `asked` is driven."""
        assert self._now is not None
        if self._forking:
            return forked(self._running, self._now.history, intervention, driver)
        return replayed(self._inputs, self._trunk.steps, asked, driver)

    def leave(self, groups: tuple[Group, ...]) -> tuple[list[Episode], SpeedRecord]:
        """These groups of that instant left to SUMO, and the speeds ahead of them."""
        assert self._now is not None
        trunk, now = self._trunk, self._now
        self._left += len(groups)
        if self._overlap:  # the trunk itself goes on to the next round
            return fork(lambda: _leave(trunk, now, groups)).result()
        return _leave(trunk, now, groups)

    @property
    def end(self) -> CourseEnd:
        """What the trunk has seen so far."""
        return _end_of(self._trunk, self._running)


def _leave(trunk: Trunk, now: TakeOver, groups: tuple[Group, ...]) -> tuple[list[Episode], SpeedRecord]:
    if not groups:  # no start is feasible: the trunk looks for others
        return [], SpeedRecord(())
    return trunk.leave_to_sumo(now.history, replace(now.found, groups=groups))


def _end_of(trunk: Trunk, running: RunningSimulation) -> CourseEnd:
    counts = SumoCounts(running.world.teleports, running.world.collision_steps)
    return CourseEnd(trunk.time, trunk.search, counts, trunk.backlog)


Messages = Callable[[], AbstractContextManager[list[bytes]]]
"""Keeps what SUMO says meanwhile out of its log, and puts it into the list."""
DriverOf = Callable[[Scenario], Driver | None]


@dataclass(frozen=True)
class _Drive:
    """A question to a waiting process: to drive a round for the run of a scenario."""

    scenario: Scenario
    intervention: Intervention | NoIntervention
    speeds: SpeedRecord


@dataclass(frozen=True)
class _Start:
    """A round that is ready to be driven, and the speeds of the vehicles ahead."""

    start: RoundStart
    speeds: SpeedRecord


@dataclass(frozen=True)
class _Left:
    """The answer to the other question, to leave groups to SUMO: these, the next take-over, and what SUMO said.

    The take-over has the last snapshot of its history only.
    """

    episodes: list[Episode]
    speeds: SpeedRecord
    following: TakeOver | None
    end: CourseEnd
    said: bytes


class CourseLost(RuntimeError):
    """A shared course cannot be gone along; the run goes along one of its own."""


class SharedCourse:
    """The course of a trunk that waiting processes share, for the run of one scenario.

    A policy is made from the scenario, where it drives. `said` is what SUMO has said so far.
    """

    def __init__(self, root: FrozenProcess, scenario: Scenario) -> None:
        self._scenario, self.said = scenario, b""
        self._at: FrozenProcess | None = root
        self._go_on(())

    def _go_on(self, groups: tuple[Group, ...]) -> _Left:
        assert self._at is not None
        try:
            left, self._at = self._at.ask(groups, key=tuple(group.ids for group in groups))
        except FrozenError as error:
            raise CourseLost(str(error)) from None
        self._left: _Left = left
        self.said += left.said
        if left.following is not None and self._at is None:
            raise CourseLost("too many processes wait already")
        return left

    def next(self) -> TakeOver | None:
        """The next instant with groups; None at the end."""
        return self._left.following

    def branch(self, asked: Round, intervention: Intervention | NoIntervention, driver: Driver | None) -> Branch:
        """A branch at that instant, in which the intervention's part of the round `asked` is driven."""
        del asked, driver
        at, known = self._at, []
        assert at is not None

        def result() -> BranchResult:
            try:
                (driven, said), _ = at.ask(_Drive(self._scenario, intervention, known[0]))
            except FrozenError as error:
                raise BranchError(f"the branched simulation failed:\n{error}") from None
            self.said += said
            return driven

        return Branch(known.append, result)

    def leave(self, groups: tuple[Group, ...]) -> tuple[list[Episode], SpeedRecord]:
        """These groups of that instant left to SUMO, and the speeds ahead of them."""
        left = self._go_on(groups)
        return left.episodes, left.speeds

    @property
    def end(self) -> CourseEnd:
        """What the trunk has seen so far."""
        return self._left.end


Course = OwnCourse | SharedCourse


def share_trunk(
    warm: WarmTraffic, driver_of: DriverOf, messages: Messages, may_wait: Callable[[], bool]
) -> FrozenProcess:
    """A process that waits at the end of a warm-up, from which `SharedCourse` begins.

    `driver_of` makes the driver of a scenario; it is called where that drives. `may_wait` says whether one more process
    may wait.
    """
    trunk = Trunk(warm.running, warm.inputs.scenario, warm.behind)

    def handler_at(now: TakeOver | None, before: int) -> Handler:
        """Answers at a take-over, or at the end of the warm-up; `before` groups have been left to SUMO."""

        def started(question: _Drive | tuple[Group, ...]) -> _Start | tuple[Group, ...]:
            """A drive with its start, for which the world is not changed."""
            if not isinstance(question, _Drive):
                return question
            assert now is not None
            driver = driver_of(question.scenario)
            return _Start(start_round(warm.running.frame, now.history, question.intervention, driver), question.speeds)

        def handle(question: _Drive | _Start | tuple[Group, ...]) -> tuple[object, Handler | None]:
            with messages() as said:
                if isinstance(question, _Drive):  # it could not be prepared: here the error is told
                    question = started(question)
                if isinstance(question, _Start):
                    driven = drive_branch(warm.running, question.start, question.speeds)
                else:
                    episodes, speeds = ([], SpeedRecord(())) if now is None else _leave(trunk, now, question)
                    behind = before + len(question)
                    following = trunk.next_take_over(behind, warm.inputs.end, lambda *_: None)
            if isinstance(question, _Start):
                return (driven, b"".join(said)), None
            episodes = [replace(episode, safety=safety_measures(episode)) for episode in episodes]
            shown = None if following is None else replace(following, history=following.history[-1:])
            answer = _Left(episodes, speeds, shown, _end_of(trunk, warm.running), b"".join(said))
            return answer, None if following is None or not may_wait() else handler_at(following, behind)

        return Handler(handle, started)

    return freeze(handler_at(None, 0))
