"""Whole co-simulation step with driven groups ÷ bare SUMO stepping of the same traffic, side by side in one run.

    python benchmarks/step_cost.py [--groups 10] [--rounds 5]

Both sides are branches of one warmed-up simulation and start from the same state. A round steps the traffic bare,
then with the groups driven (reading, model, commands, collision test and recording included). CPU time of the process.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import msgspec
import torch

from cosim.branch import fork
from cosim.closed_loop import Files, RunningRoad, Trunk, simulation
from cosim.driving import drive
from cosim.inputs import find_net
from cosim.loading import load_scenario
from cosim.policies import driver_of
from cosim.traffic import route_file


def bare(road: RunningRoad, steps: int) -> float:
    began = time.process_time()
    for _ in range(steps):
        road.world.step()
    return (time.process_time() - began) / steps


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--groups", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    torch.set_num_threads(1)
    scenario = load_scenario("us101_car_following")
    scenario = msgspec.structs.replace(scenario, groups_at_once=options.groups, watch=0.0)
    driver = driver_of(scenario)
    with tempfile.TemporaryDirectory() as scratch:
        files = Files(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        files.routes.write_text(route_file(scenario.traffic, scenario.seed, 1200.0))
        with simulation(scenario, files) as road:
            trunk = Trunk(road, scenario)
            trunk.warm_up(lambda *_: None)
            ratios = []
            for _ in range(options.rounds):
                history = trunk.look()
                task = trunk.find(history, limit=options.groups)
                alone = fork(lambda: bare(road, task.driven)).result()  # noqa: B023

                def driven() -> float:
                    began = time.process_time()
                    drive(road.world, road.frame, history, task, driver)  # noqa: B023
                    return (time.process_time() - began) / task.driven  # noqa: B023

                together = fork(driven).result()
                ratios.append(together / alone)
                print(
                    f"{len(task.groups)} groups among {len(history[-1].ids)} vehicles: bare {1e3 * alone:.2f} ms,"
                    f" driven {1e3 * together:.2f} ms, ratio {ratios[-1]:.2f}"
                )
    print(f"median ratio {statistics.median(ratios):.2f} over {len(ratios)} rounds")


if __name__ == "__main__":
    main()
