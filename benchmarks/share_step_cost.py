"""Whole step with a share of the traffic driven ÷ bare SUMO stepping of the same traffic, side by side.

    python benchmarks/share_step_cost.py [--scenario us101_share] [--share 0.2] [--vehicles 300] [--seconds 60]

The driven side reads all vehicles, infers graphs, decides, commands, and records the traffic as a run does. Both sides
are branches of one simulation, in which the share is driven from the start, and step it from the same state on: the
bare side leaves all vehicles to SUMO. They take turns every five steps, so that other load of the machine slows both
alike. Times are CPU times. `--vehicles` is how many must be in the net before the comparison begins.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import torch
from msgspec.structs import replace
from turns import side_by_side

from cosim.loop.share_of_traffic import DrivenTraffic
from cosim.loop.traffic_recorder import TrafficRecorder
from cosim.runs.share_policies import share_plans
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation

REPEATS, TURN = 3, 5


def driven(traffic: DrivenTraffic, recorder: TrafficRecorder, steps: int, second: int) -> float:
    """CPU seconds per step with the share driven and recorded."""
    began = time.process_time()
    for k in range(steps):
        report, came, left = traffic.step()
        recorder.step(traffic.history, report, came, left)
        if k % second == 0:
            recorder.second(traffic.history)
    return (time.process_time() - began) / steps


def bare(running: RunningSimulation, traffic: DrivenTraffic, steps: int) -> float:
    """CPU seconds per step of SUMO alone."""
    for share in traffic.shares.values():
        for vehicle in share.vehicles:
            traffic.control.leave_to_sumo(vehicle)
    began = time.process_time()
    for _ in range(steps):
        running.world.step()
    return (time.process_time() - began) / steps


@torch.inference_mode()
def compare(running: RunningSimulation, scenario: Scenario, vehicles: int, seconds: float) -> list[float]:
    """The ratios of some repetitions, printed one by one."""
    traffic = DrivenTraffic(running, share_plans(scenario), scenario.seed, scenario.step, bounded=True)
    lanes = {edge: running.world.net.lane_count(edge) for edge in scenario.road.edges}
    while len(traffic.history.ids) < vehicles:
        traffic.step()
    recorder = TrafficRecorder(running.world, running.frame, scenario.road.length, lanes, traffic.driver_of)
    steps, second, found = scenario.steps(seconds), scenario.steps(1.0), []
    number = sum(len(share.vehicles) for share in traffic.shares.values())
    for _ in range(REPEATS):
        together, alone = side_by_side(
            running.world,
            TURN,
            lambda: driven(traffic, recorder, steps, second),
            lambda: bare(running, traffic, steps),
        )
        found.append(together / alone)
        print(
            f"{number} of {len(traffic.history.ids)} vehicles driven at {traffic.time:.0f} s:"
            f" bare {1e3 * alone:.2f} ms, driven {1e3 * together:.2f} ms, ratio {found[-1]:.2f}",
            flush=True,
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="us101_share")
    parser.add_argument("--share", type=float, default=0.2)
    parser.add_argument("--vehicles", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    scenario = replace(load_scenario(options.scenario), share=options.share)
    with tempfile.TemporaryDirectory() as scratch:
        files = SumoFiles(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        inputs = prepare_simulation(scenario, files, scenario.time_limit)
        inputs.write()
        with simulation(inputs) as running:
            found = compare(running, inputs.scenario, options.vehicles, options.seconds)
    print(f"median ratio {statistics.median(found):.2f} over {len(found)} repetitions")


if __name__ == "__main__":
    main()
