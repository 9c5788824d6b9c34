"""What fits and what does not, before a scenario runs: one finding per part of it."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from cosim.runs.policy_loading import driver_of
from cosim.spec.input_files import find_net
from cosim.spec.scenario import Merge, Scenario, UserPolicy, policy_name
from cosim.sumo import SumoError
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.scratch_files import scratch_files
from cosim.traffic.simulation_input import prepare_simulation
from gri.errors import InputError

LOOK = 60.0  # [s] of traffic that is simulated at most
TIGHTEST_BEND = 1e-4  # [1/m], below which a road counts as straight
LONGEST_GAP = 5.0  # [m] without a lane; SUMO keeps a car on a lane that is within half the widths of both, 2.5 m
ROOM_TO_MERGE = 40.0  # [m] of the ending lane after the zone, below which there is a warning
Tell = Callable[[str, int, int], None]


class Verdict(StrEnum):
    """Whether a part of a scenario fits; with an ERROR it cannot run."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Finding:
    """What was found about one part of a scenario, in one line."""

    verdict: Verdict
    text: str


def check_scenario(scenario: Scenario, tell: Tell) -> list[Finding]:
    """Start SUMO with a scenario, simulate a minute at most, and tell what fits. Runs in a worker process."""
    findings = [_policy(scenario)]
    with scratch_files(find_net(scenario.net)) as files:
        try:
            inputs = prepare_simulation(scenario, files, LOOK)
            inputs.write()
            with simulation(inputs) as running:
                findings += [*_road(running, scenario), *_group(running, scenario)]
                findings += _traffic(running, inputs.scenario, tell)
        except (InputError, SumoError) as error:
            findings.append(Finding(Verdict.ERROR, str(error)))
    return findings


def _policy(scenario: Scenario) -> Finding:
    name = policy_name(scenario.policy)
    if isinstance(scenario.policy, UserPolicy):
        return Finding(Verdict.OK, f"policy: {name}, your own; it is called when the scenario runs")
    try:
        driver = driver_of(scenario)
    except InputError as error:
        return Finding(Verdict.ERROR, str(error))
    if driver is None or driver.policy is None:
        return Finding(Verdict.OK, "policy: SUMO drives the groups")
    return Finding(
        Verdict.OK, f"policy: {name} fits and acts every {driver.policy.dt:g} s, SUMO every {scenario.step:g} s"
    )


def _road(running: RunningSimulation, scenario: Scenario) -> Iterator[Finding]:
    net, road, edges = running.world.net, running.frame, scenario.road.edges
    count = sorted({net.lane_count(edge) for edge in edges})
    lanes = f"{count[0]} to {count[-1]}" if len(count) > 1 else f"{count[0]}"
    s = np.arange(-road.origin, road.end, 5.0)
    bend = float(np.abs(road.curvature_at(s, np.zeros(len(s)))).max())
    form = "straight" if bend < TIGHTEST_BEND else f"bends of {1 / bend:.0f} m radius or more"
    side = ", traffic on the left" if road.mirrored else ""
    length = f"{road.origin + road.end:.0f} m of edges, {scenario.road.length:g} m of study area"
    yield Finding(Verdict.OK, f"road: {' → '.join(edges)}: {length}, {lanes} lanes, {form}{side}")
    others = len(net.lanes) - len(road.places if road.places is not None else net.lanes)
    if others:
        yield Finding(Verdict.OK, f"world: {others} lanes on other roads or levels are left out")
    for edge, other in pairwise(edges):
        if (gap := net.gap_after(edge, other)) > LONGEST_GAP:
            yield Finding(
                Verdict.WARNING,
                f"net: there is no lane on the {gap:.0f} m from {edge} to {other}; SUMO takes a driven vehicle off the"
                " road there, and its drive ends as off_road. Build the net with internal links (netconvert without"
                " --no-internal-links)",
            )
    limit = max(net.limits([f"{edge}_0" for edge in edges]))
    if (way := limit * scenario.horizon) > scenario.road.length:
        yield Finding(
            Verdict.WARNING,
            f"horizon: at {limit:.0f} m/s a vehicle drives {way:.0f} m in {scenario.horizon:g} s, more than the study"
            " area; no group at that speed fits. Lower horizon or give a longer road",
        )


def _group(running: RunningSimulation, scenario: Scenario) -> Iterator[Finding]:
    rule, lanes = scenario.group, running.lanes
    if not isinstance(rule, Merge) or lanes is None:
        yield Finding(Verdict.OK, "group: three vehicles one behind the other in one lane of the road")
        return
    source, left = lanes.source, (lanes.side > 0) != running.frame.mirrored
    way = f"to the {'left' if left else 'right'} into {lanes.target.lane}"
    yield Finding(
        Verdict.OK,
        f"group: from {source.lane} (s = {source.begin:.0f} to {source.end:.0f} m) vehicles merge {way}",
    )
    if not lanes.ends:
        yield Finding(Verdict.WARNING, f"group.lane: {source.lane} goes on along the road; nobody has to merge there")
    begin, end = rule.zone
    if end <= source.begin or begin >= source.end:
        yield Finding(
            Verdict.ERROR,
            f"group.zone: got {[begin, end]}, but the lane is at s = {source.begin:.0f} to {source.end:.0f} m; give a"
            " range within",
        )
    elif end > source.end - ROOM_TO_MERGE:
        yield Finding(
            Verdict.WARNING,
            f"group.zone: its end {end:g} m leaves {source.end - end:.0f} m to merge; end it {ROOM_TO_MERGE:g} m"
            " or more before the end of the lane",
        )


def _traffic(running: RunningSimulation, scenario: Scenario, tell: Tell) -> Iterator[Finding]:
    steps = scenario.steps(min(LOOK, scenario.traffic.warm_up + LOOK))
    world, seen, on_road = running.world, set[str](), set[str]()
    for k in range(steps):
        world.step()
        if k % max(scenario.steps(1.0), 1) == 0:
            tell("traffic", k, steps)
            now = world.snapshot(running.frame)
            seen |= set(now.ids)
            on_road |= {v for v, lane in zip(now.ids, now.lane, strict=True) if _edge(lane) in scenario.road.edges}
    tell("traffic", steps, steps)
    text = f"traffic: {len(on_road)} vehicles were on the road in the first {steps * scenario.step:g} s"
    waiting = world.waiting()
    if not on_road:
        yield Finding(Verdict.WARNING, f"{text}; check routes and times of departure")
    else:
        yield Finding(Verdict.OK, text + (f", {waiting} wait for room to enter" if waiting else ""))


def _edge(lane: str) -> str:
    return lane.rpartition("_")[0]
