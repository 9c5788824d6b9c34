"""Drives the groups of one round: all of them in one model call per step.

The same function records a round that is left to SUMO, so that both sides of a comparison are measured alike. See
docs/coupling.md for what a command does and when.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import torch

from cosim.loop.compiled_steps import compiled_steps, load_core
from cosim.loop.graph_source import (
    graph_from_source,
    keep_where_unknown,
    on_same_pairs,
    reacting_in_doubt,
    smoothed,
    with_edges,
)
from cosim.loop.guard import guard_of
from cosim.loop.intervention import Intervention, NoIntervention
from cosim.loop.membership import Membership
from cosim.loop.observation import GroupObservation
from cosim.loop.policy_runner import PolicyRunner
from cosim.loop.returning_vehicles import ReturningVehicles
from cosim.loop.round_recorder import Round, RoundRecorder, hard_braking
from cosim.loop.round_start import Made, RoundStart, Seen, around_of
from cosim.loop.state_layouts import layout_of
from cosim.loop.take_over_and_hand_back import Control, PolicyControl, SumoControl, SumoDriverControl
from cosim.spec.scenario import AFTERMATH, GraphSource, Inferred, RssFilter
from cosim.sumo import Sumo
from cosim.world.break_ups import lane_entries, with_cause
from cosim.world.contacts import contacts_of
from cosim.world.episode import COLUMNS, Contact, Episode, Event, EventKind
from cosim.world.groups import expected_graph, order_of
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot
from cosim.world.surroundings import Surroundings
from gri.core.graph import EdgeType, InteractionGraph, pairs
from gri.core.policy import Policy
from gri.networks.next_ahead import FollowsNextAhead
from gri.reference_drivers.drivers import DriverName

_S = COLUMNS.index("s")


@dataclass(frozen=True)
class Driver:
    """A policy with its name and the source of its graph, which is inferred again every `reinfer` steps (0: never).

    `policy` None: SUMO's drivers, in the place of recorded ones. A `reference` driver brakes on top of the policy;
    `safety` is the filter of its actions. A driver that `predicts` makes up for the latency of perturbed sensors
    (`cosim.perturb.state_predictor`). It drives `without` the edges of these pairs (sender, receiver), whatever it
    infers.
    """

    name: str
    policy: Policy | None
    graph: GraphSource = field(default_factory=Inferred)
    reinfer: int = 0
    reference: DriverName | None = None
    safety: RssFilter | None = None
    predicts: bool = False
    without: frozenset[tuple[int, int]] = frozenset()


@torch.inference_mode()
def start_round(
    road: RoadFrame,
    history: Sequence[Snapshot],
    intervention: Intervention | NoIntervention,
    driver: Driver | None,
) -> RoundStart:
    """Prepare to drive the intervention's round from the last snapshot of the history on; the world is not changed.

    The policy infers its graph and decides on the first step. Done here, before a branch, this is done only once, and
    the branch need not touch all of torch. With `driver=None` SUMO (or the recording) drives.
    """
    this_round, now = intervention.round, history[-1]
    observations = tuple(GroupObservation.of(snapshot, this_round.groups) for snapshot in history)
    latest = observations[-1]
    assert latest.valid.all(), "a group was selected with a vehicle that is not there"
    members = Membership(this_round) if this_round.others_join else None
    if driver is None:
        return RoundStart(SumoControl(this_round.default_driver), intervention, now, observations, members)
    if driver.policy is None:
        return RoundStart(SumoDriverControl(driver.name, this_round), intervention, now, observations, members)
    layout = layout_of(this_round.rule, road, latest.state, now.length[latest.rows], this_round.lanes)
    policy = driver.policy
    if driver.without and isinstance(policy, FollowsNextAhead):
        policy = policy.without(driver.without)
    runner = PolicyRunner(
        policy,
        layout,
        observations,
        intervention.displaced_start(latest),
        driven_roles=this_round.driven_roles,
        dt=this_round.dt,
        override_graph=partial(
            _graph_to_use,
            source=driver.graph,
            without=driver.without,
            this_round=this_round,
            elapsed=driver.reinfer * this_round.dt,
            window=driver.policy.history_steps * driver.policy.dt,
        ),
        reinfer_steps=driver.reinfer,
        channels=intervention.channels(layout, road, len(observations), predicts=driver.predicts),
        around=around_of(intervention, now),
        guard=guard_of(driver.reference, driver.safety, this_round),
        with_newcomers=partial(_with_newcomers, source=driver.graph, without=driver.without, this_round=this_round),
    )
    runner.decide(now)
    load_core()
    returning = ReturningVehicles(this_round.dt, this_round.lanes)
    control = PolicyControl(driver.name, this_round, runner, returning, members)
    return RoundStart(control, intervention, now, observations, members)


def _graph_to_use(
    graph: InteractionGraph,
    last: InteractionGraph | None,
    source: GraphSource,
    without: frozenset[tuple[int, int]],
    this_round: Round,
    elapsed: float,
    window: float,
) -> InteractionGraph:
    known = graph
    if last is not None:
        known = smoothed(graph, last, source, elapsed, window, this_round.driven_roles)
        known = keep_where_unknown(known, last, source)
    known = graph_from_source(known, source, this_round.rule, this_round.has_third_vehicle)
    known = reacting_in_doubt(known, source, this_round.driven_roles)
    return with_edges(known, dict.fromkeys(without, EdgeType.NONE), this_round.size)


def _with_newcomers(
    graph: InteractionGraph,
    roles: Collection[int],
    source: GraphSource,
    without: frozenset[tuple[int, int]],
    this_round: Round,
) -> InteractionGraph:
    """The graph in which those who have these roles now are related as the roles are by the group rule.

    What a newcomer did before it joined is no evidence of how the group reacts to it.
    """
    expected = expected_graph(this_round.rule)
    if not {*expected.values()} <= {*graph.vocabulary}:  # a model whose types have no meaning
        return graph
    touched = [pair for pair in pairs(this_round.size) if not {*pair}.isdisjoint(roles)]
    graph = with_edges(graph, {pair: expected.get(pair, EdgeType.NONE) for pair in touched}, this_round.size)
    graph = graph_from_source(graph, source, this_round.rule, this_round.has_third_vehicle)
    return with_edges(graph, dict.fromkeys(without, EdgeType.NONE), this_round.size)


@dataclass(frozen=True)
class PythonSteps:
    """The steps of a round, one by one: the reference for `compiled_steps.CompiledSteps`."""

    world: Sumo
    road: RoadFrame
    start: RoundStart

    @property
    def observes_members(self) -> bool:
        """Whether a step is observed with those who had the roles before it, rather than with the planned ones."""
        return isinstance(self.start.intervention, NoIntervention)

    def drive(self, seen: Seen, recorder: RoundRecorder, most: int) -> Made:
        """Make a step with the active groups driven."""
        del most
        control, active = self.start.control, recorder.active
        control.decide(seen.now)
        control.command(self.world, self.road, active, seen.now)
        made = self._step(seen)
        now, observation, recorded = made.observed
        return replace(made, observed=(now, control.with_commanded_acceleration(observation, active), recorded))

    def watch(self, seen: Seen, recorder: RoundRecorder, most: int) -> None:
        """Make a step without any driven group."""
        del most
        self.start.control.command(self.world, self.road, (), seen.now)
        now, observation, recorded = self._step(seen).observed
        if self.start.members is not None:  # those who had the roles at the end
            observation = self.start.members.observe(now)
        seen.add(now, observation, recorded)
        recorder.look_for_contacts(now)

    def _step(self, seen: Seen) -> Made:
        intervention, members = self.start.intervention, self.start.members
        intervention.command(self.world, self.road, seen.steps, self.start.control.roles, seen.now)
        report = self.world.step()
        ids = members.vehicles if members is not None and self.observes_members else None
        return Made(intervention.observe(self.world, self.road, seen.observations[-1], seen.now, ids), report)


@torch.inference_mode()
def drive(world: Sumo, road: RoadFrame, start: RoundStart) -> list[Episode]:
    """Drive (or only record) the groups of a round until all have ended, then watch them; one Episode per group."""
    this_round, control, intervention, members = start.round, start.control, start.intervention, start.members
    seen = Seen.at_start(start)
    rows = start.observations[-1].rows
    length, width = start.now.length[rows], start.now.width[rows]
    recorder = RoundRecorder(this_round, width, members)
    control.take_over(world, recorder, start.now.time)
    intervention.begin(world, control.roles)
    steps = compiled_steps(world, road, start, recorder) or PythonSteps(world, road, start)
    while recorder.active:
        active = recorder.active
        made = steps.drive(seen, recorder, this_round.driven_steps - seen.steps)
        if made is None:  # nothing happened
            continue
        (now, observation, recorded), report, before = made.observed, made.report, seen.observations[-1]
        shown, changed = None, {}
        if members is not None:
            changed = members.update(now, active)
            if changed or not steps.observes_members:
                observation = control.with_commanded_acceleration(members.observe(now), active)
            shown = members.shown(observation, road)
        recorder.judge(observation, before, now, report, last=seen.steps + 1 == this_round.driven_steps)
        recorder.end_failed(control.failures, before.time, now.time)
        if changed and shown is not None:
            control.change_roles(world, recorder, shown, now, changed)
        control.hand_back(world, road, recorder, observation, now, ended=set(active) - set(recorder.active))
        if shown is None:
            shown = intervention.shown_to_policy(observation, now)
        around = around_of(intervention, now, members and members.ids) if control.sees_nearby else None
        control.observe(shown, recorder.active, around)
        seen.add(now, observation, recorded)
    driven = seen.steps
    control.verify(seen.observations[len(start.observations) :], recorder)
    while (left := driven + this_round.watched_steps - seen.steps) > 0:
        steps.watch(seen, recorder, left)
    episodes = _episodes(recorder, control, seen.observations, Surroundings.of(seen.around), length, width)
    if members is not None:
        episodes = [
            replace(episode, role_changes=tuple(changes))
            for episode, changes in zip(episodes, members.changes, strict=True)
        ]
    return _judged(episodes, start, seen.trace, recorder.contacts)


def _judged(
    episodes: Sequence[Episode],
    start: RoundStart,
    trace: Sequence[Snapshot],
    touching: Sequence[np.ndarray],
) -> list[Episode]:
    """The episodes with their contacts, and with what broke them up; `trace` are the snapshots after the take-over.

    `touching` are the rows of vehicles in contact in each of them.
    """
    intervention, takeover = start.intervention, start.now
    names = [intervention.names(g) for g in range(len(episodes))]
    ends, found = [episode.end for episode in episodes], []
    entries = lane_entries(takeover, trace, [[*of] for of in names], ends)
    for g, contacts in enumerate(contacts_of(trace, names, ends, touching)):
        events = [Event(c.time, EventKind.CONTACT, c.vehicles, _detail(c)) for c in contacts]
        events = tuple(sorted([*events, *episodes[g].events], key=lambda event: event.time))
        episode = replace(episodes[g], contacts=contacts, lane_entries=entries[g], events=events)
        at_the_end = next(now for now in trace if now.time >= ends[g] - 1e-6)
        ids = intervention.members(g, at_the_end) if start.members is None else start.members.ids[g]
        found.append(with_cause(episode, ids, takeover, trace))
    return found


def _detail(contact: Contact) -> str:
    return f"{contact.who} at {contact.speed_difference:.2f} m/s" + ", after hand-back" * contact.after_hand_back


def _episodes(
    recorder: RoundRecorder,
    control: Control,
    observations: Sequence[GroupObservation],
    around: Surroundings,
    length: np.ndarray,
    width: np.ndarray,
) -> list[Episode]:
    """One episode per group, with its part of what is `around`; `length` and `width` [m] are of shape (G, N)."""
    this_round = recorder.round
    time = np.array([observation.time for observation in observations])
    state = np.stack([observation.state for observation in observations], axis=1)
    valid = np.stack([observation.valid for observation in observations], axis=1)
    members = slice(this_round.size if this_round.has_third_vehicle else 2)
    episodes = []
    for g, group in enumerate(this_round.groups):
        end = recorder.ends[g]
        graphs = [(at, graph) for at, graph in control.graphs if at <= end]
        braking = hard_braking(observations, g, group, recorder.driven_to_the_end(g), end)
        episode = Episode(
            driver=control.name,
            group=group,
            time=time,
            state=state[g],
            valid=valid[g],
            driven=recorder.driven(time, g, control.roles),
            length=length[g],
            width=width[g],
            order=order_of(this_round.rule),
            graph=_graph_over_time([graph for _, graph in graphs], g),
            graph_time=np.array([at for at, _ in graphs]),
            ending=recorder.endings[g],
            end=end,
            events=tuple(recorder.events[g]) + braking,
            judged_roles=this_round.driven_roles,
            surroundings=around.near(time, state[g, :, members, _S], group.time, end + AFTERMATH),
            filter_use=control.filter_use(g, end),
        )
        episodes.append(episode)
    return episodes


def _graph_over_time(graphs: Sequence[InteractionGraph], g: int) -> InteractionGraph | None:
    """The graphs of one group as one graph with a row per time; None where there are none."""
    if not graphs:
        return None
    graphs = on_same_pairs(graphs)
    scores = [graph.unknown[g] for graph in graphs if graph.unknown is not None]
    unknown = torch.stack(scores) if len(scores) == len(graphs) else None
    logits = torch.stack([graph.logits[g] for graph in graphs])
    doubted = None
    if any(graph.in_doubt is not None for graph in graphs):
        nowhere = torch.zeros(logits.shape[1], dtype=torch.bool)
        doubted = torch.stack([nowhere if graph.in_doubt is None else graph.in_doubt[g] for graph in graphs])
    return replace(graphs[0], logits=logits, unknown=unknown, in_doubt=doubted)
