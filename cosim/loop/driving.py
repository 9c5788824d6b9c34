"""Driving the groups of one round: all of them in one model call per step.

The same function records a round that is left to SUMO (`driver=None`), so that both sides of a comparison are measured
alike. See docs/coupling.md for what a command does and when.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import torch

from cosim.loop import shadow_vehicles
from cosim.loop.graph_source import graph_from_source
from cosim.loop.observation import Frame
from cosim.loop.perturbed_round import Intervention
from cosim.loop.policy_runner import PolicyRunner
from cosim.loop.round_recorder import Record, Round, hard_braking
from cosim.loop.state_layouts import Pose, layout_of
from cosim.spec.scenario import GraphSource, Inferred
from cosim.sumo import Sumo
from cosim.world.episode import COLUMNS, Episode
from cosim.world.groups import order_of
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot
from gri.core.graph import InteractionGraph
from gri.core.policy import Policy

_S = COLUMNS.index("s")


@dataclass(frozen=True)
class Driver:
    """A policy with its name and the graph it is to go by, inferred anew every `reinfer` steps (0: never)."""

    name: str
    policy: Policy
    graph: GraphSource = field(default_factory=Inferred)
    reinfer: int = 0


@dataclass(frozen=True)
class Start:
    """A round about to be driven, or only watched: what was seen of it, the policy at the wheel, its first poses.

    It is used up by driving it; branches of the process may share it.
    """

    task: Round
    driver: Driver | None
    intervention: Intervention | None
    now: Snapshot
    frames: tuple[Frame, ...]
    pilot: PolicyRunner | None
    pose: Pose | None


@torch.inference_mode()
def start(
    road: RoadFrame,
    history: Sequence[Snapshot],
    task: Round,
    driver: Driver | None,
    intervention: Intervention | None = None,
) -> Start:
    """Make ready to drive from the last snapshot of the history on; the world stays as it is.

    What is done here, before a branch, need not be done in it, where all of torch would have to be touched first. An
    intervention displaces its starts after the policy has inferred its graph; the `task` is the intervention's own.
    """
    frames, now = tuple(Frame.of(snapshot, task.groups) for snapshot in history), history[-1]
    assert frames[-1].valid.all(), "a group was selected with a vehicle that is not there"
    pilot = None
    if driver is not None:
        layout = layout_of(task.rule, road, frames[-1].state, now.length[frames[-1].rows])
        overrule = partial(graph_from_source, source=driver.graph, rule=task.rule, third=task.third)
        signals = None if intervention is None else intervention.signals(layout, frames)
        pilot = PolicyRunner(driver.policy, layout, frames, task.owned, task.dt, overrule, driver.reinfer, signals)
        if intervention is not None:
            pilot.place(intervention.displace(frames[-1]))
    return Start(task, driver, intervention, now, frames, pilot, None if pilot is None else pilot.decide(now.time))


@torch.inference_mode()
def drive(world: Sumo, road: RoadFrame, begin: Start) -> list[Episode]:
    """Drive (or only watch) the groups of a round; one Episode per group.

    An intervention happens between the start and the first step.
    """
    task, pilot, intervention, now, frames = begin.task, begin.pilot, begin.intervention, begin.now, [*begin.frames]
    length, width = now.length[frames[-1].rows], now.width[frames[-1].rows]
    record, roles = Record(task, width), () if pilot is None else task.owned
    if pilot is not None:
        record.take_over(world, now.time)
    if intervention is not None:
        intervention.begin(world, roles)
    k = ended = 0
    while k < ended + task.watched or record.active:
        active, pose = record.active, None
        if pilot is not None and active:
            pose = begin.pose if k == 0 and begin.pose is not None else pilot.decide(now.time)
            _command(world, road, task, active, pose, now)
        if intervention is not None:
            intervention.command(world, road, k, roles, now)
        report = world.step()
        if intervention is None:
            now = world.snapshot(road, task.vehicles, _between(frames[-1]))
        else:
            now = world.snapshot(road, intervention.vehicles)
        frame = Frame.of(now, task.groups) if intervention is None else intervention.see(now, road)
        if pilot is not None and pose is not None:
            record.verify(frame, pose)
            frame = pilot.stamp(frame, active)
        k += 1
        record.judge(frame, frames[-1], now, report, last=k == task.driven)
        ended = k if active else ended
        if pilot is not None:
            record.hand_back(world, frame, ended=set(active) - set(record.active))
            pilot.observe(frame if intervention is None else intervention.show(frame, now), record.active)
        frames.append(frame.carried_on(frames[-1]))
    time = np.array([frame.time for frame in frames])
    state, valid = (np.stack([getattr(frame, name) for frame in frames], axis=1) for name in ("state", "valid"))
    return [
        Episode(
            driver=task.undriven if begin.driver is None else begin.driver.name,
            group=group,
            time=time,
            state=state[g],
            valid=valid[g],
            driven=record.driven(time, g) & (pilot is not None),
            length=length[g],
            width=width[g],
            order=order_of(task.rule),
            graph=_graph(pilot, g, record.ends[g]),
            graph_time=np.array([at for at, _ in _graphs(pilot, record.ends[g])]),
            ending=record.endings[g],
            end=record.ends[g],
            events=tuple(record.events[g]) + hard_braking(frames, g, group, task.owned, record.ends[g]),
        )
        for g, group in enumerate(task.groups)
    ]


def _command(world: Sumo, road: RoadFrame, task: Round, active: Sequence[int], pose: Pose, now: Snapshot) -> None:
    """Tell SUMO where the owned vehicles will be, and make those between two lanes visible in both."""
    xy, along = road.to_world(pose.s.ravel(), pose.d.ravel())
    points, headings, speeds = xy.tolist(), (along + pose.heading.ravel()).tolist(), pose.v.ravel().tolist()
    for g in active:
        for role in task.owned:
            vehicle, lane, k = task.groups[g].ids[role], "", 3 * g + role
            if task.lanes is not None and role == 0:
                lane = shadow_vehicles.place(world, road, vehicle, pose.of(g, role), task.lanes, now, task.dt)
            world.command(vehicle, points[k][0], points[k][1], headings[k], speeds[k], lane)


def _between(frame: Frame) -> float:
    """How far [m] along their lane whoever is between two vehicles of a group is from the nearer one a step later."""
    gap = np.diff(np.sort(frame.state[..., _S], axis=1), axis=1).max()
    return 10.0 * math.ceil(gap / 20.0) + 10.0


def _graphs(pilot: PolicyRunner | None, end: float) -> list[tuple[float, InteractionGraph]]:
    """What a pilot went by until a group ended."""
    return [] if pilot is None else [(time, graph) for time, graph in pilot.graphs if time <= end]


def _graph(pilot: PolicyRunner | None, g: int, end: float) -> InteractionGraph | None:
    """One group's graphs, a row for each time they were inferred."""
    found = [graph for _, graph in _graphs(pilot, end)]
    if not found:
        return None
    return InteractionGraph(torch.stack([graph.logits[g] for graph in found]), found[0].vocabulary)
