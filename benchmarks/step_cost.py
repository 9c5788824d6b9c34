"""Whole co-simulation step with driven groups ÷ bare SUMO stepping of the same traffic, side by side in one run.

    python benchmarks/step_cost.py [--scenario us101_car_following] [--groups 10] [--rounds 5]

Both sides are branches of one warmed-up simulation and start from the same state. One steps the traffic bare, one with
the groups driven (reading, inference of the graph, model, commands, collision test and recording included). They take
turns every five steps, so that whatever else the machine does slows both alike. A round does that seven times; its
ratio is the median. Groups of a merge seldom come ten at once. CPU time.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from msgspec.structs import replace
from turns import side_by_side

from cosim.loop.closed_loop import Files, RunningSimulation, Trunk, simulation
from cosim.loop.driving import Driver, Start, drive, start
from cosim.loop.round_recorder import Round
from cosim.runs.policy_loading import driver_of
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario
from cosim.traffic.route_file import route_file
from cosim.world.snapshot import Snapshot

REPEATS, TURN = 7, 5
BETWEEN = 10.0  # [s] from one round to the next attempt to find groups


def driven(road: RunningSimulation, begin: Start) -> tuple[float, int]:
    """CPU seconds with driven groups, and the number of steps: they may all end early."""
    began = time.process_time()
    episodes = drive(road.world, road.frame, begin)
    return time.process_time() - began, len(episodes[0].time) - len(begin.frames)


def bare(road: RunningSimulation, steps: int) -> float:
    """CPU seconds per step of SUMO alone."""
    began = time.process_time()
    for _ in range(steps):
        road.world.step()
    return (time.process_time() - began) / steps


def compare(
    road: RunningSimulation, history: Sequence[Snapshot], task: Round, driver: Driver
) -> tuple[float, float, float]:
    """Medians: CPU seconds per step, bare and driven, and their ratio."""
    alone, together = [], []
    for _ in range(REPEATS):
        began = time.process_time()
        begin = start(road.frame, history, task, driver)
        ready = time.process_time() - began
        both = lambda: driven(road, begin), lambda: bare(road, task.driven)  # noqa: B023
        (cost, steps), spent = side_by_side(road.world, TURN, *both)
        together.append((ready + cost) / steps)
        alone.append(spent)
    ratio = statistics.median(whole / step for whole, step in zip(together, alone, strict=True))
    return statistics.median(alone), statistics.median(together), ratio


def ratios(road: RunningSimulation, scenario: Scenario, driver: Driver, rounds: int) -> list[float]:
    """Driven ÷ bare of so many rounds, told as they come."""
    trunk, found = Trunk(road, scenario), []
    trunk.warm_up(lambda *_: None)
    while len(found) < rounds:
        for _ in range(scenario.steps(BETWEEN)):
            road.world.step()
        trunk = Trunk(road, scenario)  # one that did not take anybody yet
        history = trunk.look()
        task = trunk.find(history, limit=scenario.groups_at_once)
        if not task.groups:
            continue
        alone, together, ratio = compare(road, history, task, driver)
        found.append(ratio)
        print(
            f"{len(task.groups)} groups among {len(history[-1].ids)} vehicles: bare {1e3 * alone:.2f} ms,"
            f" driven {1e3 * together:.2f} ms, ratio {ratio:.2f}",
            flush=True,
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="us101_car_following")
    parser.add_argument("--groups", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    scenario = replace(load_scenario(options.scenario), groups_at_once=options.groups, watch=0.0)
    driver = driver_of(scenario)
    assert driver is not None, "somebody must drive"
    end = scenario.traffic.warm_up + scenario.time_limit
    with tempfile.TemporaryDirectory() as scratch:
        files = Files(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        files.routes.write_text(route_file(scenario.traffic, scenario.seed, end))
        with simulation(scenario, files) as road:
            found = ratios(road, scenario, driver, options.rounds)
    print(f"median ratio {statistics.median(found):.2f} over {len(found)} rounds")


if __name__ == "__main__":
    main()
