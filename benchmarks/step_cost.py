"""Whole co-simulation step with driven groups ÷ bare SUMO stepping of the same traffic, side by side in one run.

    python benchmarks/step_cost.py [--scenario us101_car_following] [--groups 10] [--rounds 5] [--set FIELD=VALUE]

Both sides are branches of one warmed-up simulation and start from the same state. One steps the traffic bare, one with
the groups driven (reading, inference of the graph, model, commands, collision test and recording included). They take
turns every five steps, so that other load of the machine slows both alike. A round does that seven times; its
ratio is the median. A merge seldom has ten groups at once. Times are CPU times.
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

from cosim.loop.driving import Driver, RoundStart, drive, start_round
from cosim.loop.intervention import NoIntervention
from cosim.loop.round_recorder import Round
from cosim.loop.trunk import Trunk
from cosim.runs.policy_loading import driver_of
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.traffic.warm_up import warm_up
from cosim.world.snapshot import Snapshot

REPEATS, TURN = 7, 5
BETWEEN = 10.0  # [s] from one round to the next attempt to find groups


def driven(running: RunningSimulation, start: RoundStart) -> tuple[float, int]:
    """CPU seconds with driven groups, and the number of steps: they may all end early."""
    began = time.process_time()
    episodes = drive(running.world, running.frame, start)
    return time.process_time() - began, len(episodes[0].time) - len(start.observations)


def bare(running: RunningSimulation, steps: int) -> list[float]:
    """CPU seconds of SUMO alone from the start until each step."""
    began, spent = time.process_time(), []
    for _ in range(steps):
        running.world.step()
        spent.append(time.process_time() - began)
    return spent


def compare(
    running: RunningSimulation, history: Sequence[Snapshot], this_round: Round, driver: Driver
) -> tuple[float, float, float]:
    """Medians: CPU seconds per step, bare and driven, and their ratio."""
    alone, together = [], []
    for _ in range(REPEATS):
        began = time.process_time()
        start = start_round(running.frame, history, NoIntervention(this_round), driver)
        ready = time.process_time() - began
        both = lambda: driven(running, start), lambda: bare(running, this_round.driven_steps)  # noqa: B023
        (cost, steps), spent = side_by_side(running.world, TURN, *both)
        together.append((ready + cost) / steps)
        alone.append(spent[steps - 1] / steps)  # the same steps: the first ones in a branch copy its memory
    ratio = statistics.median(whole / step for whole, step in zip(together, alone, strict=True))
    return statistics.median(alone), statistics.median(together), ratio


def ratios(running: RunningSimulation, scenario: Scenario, driver: Driver, rounds: int) -> list[float]:
    """Driven ÷ bare of this many rounds, printed one by one."""
    found, begin = [], warm_up(running.world, scenario, lambda *_: None)
    while len(found) < rounds:
        for _ in range(scenario.steps(BETWEEN)):
            running.world.step()
        trunk = Trunk(running, scenario, begin)  # one that has not used any vehicle yet
        history = trunk.observe_history()
        this_round = trunk.find_groups(history, limit=scenario.groups_at_once)
        if not this_round.groups:
            continue
        alone, together, ratio = compare(running, history, this_round, driver)
        found.append(ratio)
        print(
            f"{len(this_round.groups)} groups among {len(history[-1].ids)} vehicles: bare {1e3 * alone:.2f} ms,"
            f" driven {1e3 * together:.2f} ms, ratio {ratio:.2f}",
            flush=True,
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="us101_car_following")
    parser.add_argument("--groups", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    options = parser.parse_args()
    torch.set_num_threads(1)
    scenario = load_scenario(options.scenario, settings=options.set)
    scenario = replace(scenario, groups_at_once=options.groups, watch=0.0)
    driver = driver_of(scenario)
    assert driver is not None, "the scenario has no policy that drives"
    with tempfile.TemporaryDirectory() as scratch:
        files = SumoFiles(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        inputs = prepare_simulation(scenario, files, scenario.time_limit)
        inputs.write()
        with simulation(inputs) as running:
            found = ratios(running, inputs.scenario, driver, options.rounds)
    print(f"median ratio {statistics.median(found):.2f} over {len(found)} rounds")


if __name__ == "__main__":
    main()
