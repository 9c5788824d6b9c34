"""Steps of a round in the compiled core, where that is built and the round is one that it can drive.

As long as nothing happens, steps are made without Python. A step in which something may have happened is handed to
Python, which judges it as it does without the core. Vehicles on their way back to SUMO's drivers are commanded by
Python, and so are decisions that are more than a feed-forward policy and its dynamics. The results are the same, bit
for bit (tests/cosim/core/test_compiled_steps.py).
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from cosim.core import RoundCore, RoundFacts, Steps
from cosim.core.library import DECIDE, JUDGE, QUIET, REFUSED, library
from cosim.core.numpy_loops import loops
from cosim.loop.intervention import NoIntervention
from cosim.loop.nearby_vehicles import Around
from cosim.loop.observation import GroupObservation
from cosim.loop.round_recorder import RoundRecorder
from cosim.loop.round_start import Made, RoundStart, Seen, around_of
from cosim.loop.state_layouts import Layout, LongitudinalLayout, Pose
from cosim.loop.take_over_and_hand_back import Control, PolicyControl
from cosim.loop.vehicles_ahead import SpeedRecord
from cosim.spec.scenario import Merge
from cosim.sumo import Sumo
from cosim.world.road_frame import RoadFrame
from gri.core.dynamics import POINT_MASS_1D, transition_matrix
from gri.core.graph import InteractionGraph


def load_core() -> bool:
    """Whether there is a compiled core; loads it once, so that branches need not."""
    return library() is not None and loops() is not None


def compiled_steps(world: Sumo, road: RoadFrame, start: RoundStart, recorder: RoundRecorder) -> "CompiledSteps | None":
    """The compiled steps of a round, after its take-over; None where Python is to make them.

    They are for straight roads without perturbations, for vehicles driven by policies in states of a matrix.
    """
    if not load_core():
        return None
    intervention, control, this_round = start.intervention, start.control, start.round
    if not isinstance(intervention, NoIntervention) or not this_round.groups:
        return None
    if road.straight_line is None or road.places is not None or this_round.default_driver != "sumo":
        return None
    layout, lanes = control.runner.layout if isinstance(control, PolicyControl) else None, this_round.lanes
    matrix = transition_matrix(POINT_MASS_1D if layout is None else layout.dynamics, this_round.dt)
    if (layout and layout.lines is not None) or matrix is None or (lanes is not None and lanes.path is not None):
        return None
    is_merge, rows = isinstance(this_round.rule, Merge), start.observations[-1].rows
    facts = RoundFacts(
        dt=this_round.dt,
        road=road,
        is_euler=world.is_euler,
        members=this_round.vehicles,
        driven_roles=this_round.driven_roles,
        lanes=lanes if is_merge else None,
        has_third=this_round.has_third_vehicle,
        records_surroundings=this_round.records_surroundings,
        width=start.now.width[rows],
        matrix=matrix.T,
        every=control.runner.every if isinstance(control, PolicyControl) else 1,
        before=start.observations[-1].state,
        settle=this_round.rule.settle if isinstance(this_round.rule, Merge) else 0.0,
        steps_inside=recorder.steps_inside,
        others_join=start.members is not None,
        **_layout_facts(layout, rows.shape),
    )

    def change_shadow(group: int, wanted: int) -> None:
        vehicle = this_round.groups[group].ids[0]
        (world.add_shadow if wanted else world.remove_shadow)(vehicle)

    core = RoundCore(facts, change_shadow, world.before_step)
    core.start(start.now, world.known_ids)
    if intervention.ahead is not None:
        core.repeat(intervention.ahead.vehicles, intervention.ahead.steps)
    if intervention.recorded is not None:
        core.record_speeds(intervention.recorded.vehicles)
    if isinstance(control, PolicyControl):
        return CompiledDrive(world, road, start, control, intervention.recorded, core)
    return CompiledSteps(world, road, start, control, intervention.recorded, core)


def _layout_facts(layout: Layout | None, shape: tuple[int, ...]) -> dict:
    if layout is None:
        return {"offset": np.zeros(shape), "across": np.zeros(shape), "side": 1}
    side = 1 if isinstance(layout, LongitudinalLayout) else layout.side
    return {"offset": layout.offset, "across": _across(layout), "side": side}


def _across(layout: Layout) -> np.ndarray:
    return layout.lateral if isinstance(layout, LongitudinalLayout) else layout.target


@dataclass
class CompiledSteps:
    """The steps of a round; `drive` and `watch` do what those of `driving.PythonSteps` do, for many steps at once.

    Here nobody is driven. `recorded` takes the speeds of some vehicles.
    """

    world: Sumo
    road: RoadFrame
    start: RoundStart
    control: Control
    recorded: SpeedRecord | None
    core: RoundCore
    _changes: int = 0
    observes_members: ClassVar[bool] = True

    def drive(self, seen: Seen, recorder: RoundRecorder, most: int) -> Made | None:
        """Make `most` steps, or fewer; the last one is returned if something may have happened in it."""
        self._show_groups(seen, recorder)
        status, _, steps = self.core.advance(seen.steps, 0, most, decided=False, driving=False, judging=True)
        return self._made(seen, recorder, steps, something=status != QUIET or len(steps) == most)

    def watch(self, seen: Seen, recorder: RoundRecorder, most: int) -> None:
        """Make `most` steps without any driven group, or fewer."""
        self._show_groups(seen, recorder)
        status, _, steps = self.core.advance(seen.steps, 0, most, decided=False, driving=False, judging=False)
        made = self._made(seen, recorder, steps, something=status != QUIET)
        if made is not None:
            now, observation, recorded = made.observed
            seen.add(now, observation, recorded)
            recorder.look_for_contacts(now)

    def _show_groups(self, seen: Seen, recorder: RoundRecorder) -> None:
        """Tell the core which groups are active, and who their members are, where that has changed."""
        self.core.active[:] = False
        self.core.active[recorder.active] = True
        members = self.start.members
        if members is None or (changes := sum(map(len, members.changes))) == self._changes:
            return
        self._changes = changes
        offset, across = self._layout()
        self.core.change_members(members.ids, members.driven, offset, across, seen.observations[-1].state)

    def _layout(self) -> tuple[np.ndarray, np.ndarray]:
        """The offsets and places across the road of the present members, in model states; nobody asks for them here."""
        shape = self.core.driven.shape
        return np.zeros(shape), np.zeros(shape)

    def _made(self, seen: Seen, recorder: RoundRecorder, steps: Steps, *, something: bool) -> Made | None:
        """Add the steps in which nothing happened; the last one, if `something` may have happened in it."""
        report = self.world.after_other_steps(reported=something)
        if self.recorded is not None:
            self.recorded.add(steps.speeds)
        quiet = len(steps) - something
        for k, (now, recorded) in enumerate(steps.found[:quiet]):
            seen.add(now, _observation(steps, k), recorded)
        recorder.nothing_happened(quiet)
        if report is None:
            return None
        now, recorded = steps.found[-1]
        return Made((now, _observation(steps, quiet), recorded), report)


@dataclass
class CompiledDrive(CompiledSteps):
    """The steps of a round that a policy drives."""

    control: PolicyControl
    _graph: InteractionGraph | None = None
    _knows_policy: bool = False
    _guided_at: int = -1

    def drive(self, seen: Seen, recorder: RoundRecorder, most: int) -> Made | None:
        """Make `most` steps with the active groups driven, or fewer."""
        control, runner, active = self.control, self.control.runner, recorder.active
        self._show_groups(seen, recorder)
        by_core, last = self._let_core_decide(), most
        if not by_core and not runner.has_decided(seen.now):
            runner.decide(seen.now)
        decided = runner.has_decided(seen.now)
        if not by_core:
            last = 1
        elif (until_graph := runner.decisions_until_graph) is not None:
            last = min(most, until_graph + decided)
        if last == 0:  # the graph is inferred again before the next decision
            self._decide(seen)
            return None
        if self._guide_returning(seen):
            last = 1
        decisions = runner.hand_over(self.core)
        self._tell_who_is_taken()
        status, decisions, steps = self.core.advance(
            seen.steps, decisions, last, decided=decided, driving=True, judging=True
        )
        runner.take_back(self.core, decisions, steps.state)
        control.commanded.extend((Pose(*pose), active) for pose in steps.pose)
        if status == REFUSED:
            control.command(self.world, self.road, active, seen.now)  # says what is wrong
        failed = not runner.failures.keys().isdisjoint(active)
        something = len(steps) > 0 and (status == JUDGE or len(steps) == most or failed)
        made = self._made(seen, recorder, steps, something=something)
        if made is None and not by_core:
            members, observation = self.start.members, _observation(steps, len(steps) - 1)
            shown = observation if members is None else members.shown(observation, self.road)
            control.observe(shown, active, self._around(seen))
        if status == DECIDE:
            self._decide(seen)
        return made

    def _layout(self) -> tuple[np.ndarray, np.ndarray]:
        layout = self.control.runner.layout
        return layout.offset, _across(layout)

    def _decide(self, seen: Seen) -> None:
        """Let Python decide where the core has made the steps before."""
        if (around := self._around(seen)) is not None:
            self.control.runner.look_around(around)
        self.control.runner.decide(seen.now)

    def _around(self, seen: Seen) -> Around | None:
        if not self.control.sees_nearby:
            return None
        members = self.start.members
        return around_of(self.start.intervention, seen.now, members and members.ids)

    def watch(self, seen: Seen, recorder: RoundRecorder, most: int) -> None:
        """Make `most` steps without any driven group, or fewer; vehicles on their way back are guided."""
        most = 1 if self._guide_returning(seen) else most
        self._tell_who_is_taken()
        super().watch(seen, recorder, most)

    def _let_core_decide(self) -> bool:
        """Whether the core can decide; it is told about a graph that it does not know."""
        runner = self.control.runner
        if runner.graph is not self._graph or not self._knows_policy or runner.failures:
            numbers, self._graph = runner.numbers, runner.graph
            self._knows_policy = numbers is not None
            if numbers is not None:
                self.core.use(*numbers)
        return self._knows_policy

    def _guide_returning(self, seen: Seen) -> bool:
        """Command the vehicles on their way back, if there are any, once before each step."""
        returning = self.control.returning
        if returning.are_there and self._guided_at != seen.steps:
            self._guided_at = seen.steps
            returning.command(self.world, self.road, seen.now)
        return self._guided_at == seen.steps

    def _tell_who_is_taken(self) -> None:
        self.core.take(self.world.taken)
        if self.start.round.lanes is not None:
            self.core.shadowed[:] = [self.world.has_shadow(group.ids[0]) for group in self.start.round.groups]


def _observation(steps: Steps, k: int) -> GroupObservation:
    return GroupObservation(float(steps.time[k]), steps.observed[k], steps.valid[k], steps.rows[k])
