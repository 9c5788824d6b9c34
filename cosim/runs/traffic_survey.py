"""What undisturbed traffic does: speeds, flows and lane use of a scenario in which nobody is taken over."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from cosim.spec.input_files import find_net
from cosim.spec.scenario import Scenario
from cosim.traffic.running_simulation import simulation
from cosim.traffic.scratch_files import scratch_files
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.traffic.warm_up import Progress
from cosim.world.snapshot import Snapshot

TELL_EVERY = 100  # steps


@dataclass(frozen=True)
class Survey:
    """Samples of the study area once a second from the end of the warm-up on, and what went wrong at any time.

    `samples` has a row per vehicle and second: time [s], vehicle, its class (`kind`) and length [m], lane
    (1 = leftmost), x [m] from the entry of the study area, v [m/s], a [m/s²] (the mean over the past step).
    """

    samples: pd.DataFrame
    hardest_braking: float  # [m/s^2], of any vehicle in the net, in the sampled seconds
    waiting: int  # vehicles that could not enter the net in time
    collisions: int  # steps with a collision in SUMO's list
    teleports: int


def survey(scenario: Scenario, files: SumoFiles, duration: float, tell: Progress) -> Survey:
    """Simulate the warm-up and `duration` [s] more; nobody is taken over."""
    inputs = prepare_simulation(scenario, files, duration)
    inputs.write()
    scenario = inputs.scenario
    parts, hardest, collisions, teleports = [], 0.0, 0, 0
    first, second = scenario.steps(scenario.traffic.warm_up), max(scenario.steps(1.0), 1)
    with simulation(inputs) as road:
        total = first + scenario.steps(min(duration, inputs.end))
        lanes = {edge: road.world.net.lane_count(edge) for edge in scenario.road.edges}
        for k in range(1, total + 1):
            report = road.world.step()
            collisions, teleports = collisions + bool(report.collisions), teleports + len(report.teleported)
            if k >= first and k % second == 0:
                snapshot = road.world.snapshot(road.frame)
                hardest = min(hardest, float(snapshot.a.min(initial=0.0)))
                samples = _samples(snapshot, scenario.road.length, lanes)
                kinds = road.world.drivers.kinds(samples["vehicle"])
                parts.append(samples.assign(kind=[kind.rpartition(".")[0] for kind in kinds]))
            if k % TELL_EVERY == 0:
                tell("traffic", k, total)
        samples = pd.concat(parts, ignore_index=True)
        return Survey(samples, hardest, road.world.waiting(), collisions, teleports)


def _samples(snapshot: Snapshot, length: float, lanes: dict[str, int]) -> pd.DataFrame:
    """The vehicles on the main road inside the study area."""
    edge, index = zip(*(lane.rpartition("_")[::2] for lane in snapshot.lane), strict=True)
    inside = (snapshot.s >= 0) & (snapshot.s < length) & np.isin(edge, list(lanes))
    rows = np.flatnonzero(inside)
    return pd.DataFrame(
        {
            "time": snapshot.time,
            "vehicle": [snapshot.ids[row] for row in rows],
            "length": snapshot.length[rows],
            "lane": [lanes[edge[row]] - int(index[row]) for row in rows],
            "x": snapshot.s[rows],
            "v": snapshot.v[rows],
            "a": snapshot.a[rows],
        }
    )


def survey_job(scenario: Scenario, duration: float, tell: Callable[..., None]) -> Survey:
    """Survey the undisturbed traffic of a scenario; it runs in a worker process."""
    with scratch_files(find_net(scenario.net)) as files:
        return survey(scenario, files, duration, tell)
