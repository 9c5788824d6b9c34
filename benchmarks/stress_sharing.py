"""Cost of one simulation per cell and policy ÷ cost of a stress test that shares one warmed-up simulation.

    python benchmarks/stress_sharing.py [--starts 10] [--measured 2]

Shared: there is one warm-up, and each round has a branch per cell and policy (`cosim.stress.chunk`). Alone: every cell
and policy warms up and drives the same starts in a simulation of its own. Only `--measured` of these are run, evenly
spread, and their mean is used for all. Times are CPU seconds of the process and its branches.
"""

import argparse
import resource
import statistics

import torch
from msgspec.structs import replace

from cosim.spec.loading import load_scenario
from cosim.stress.chunk import chunk_rows
from cosim.stress.plan import Chunk, chunks, policies_of, sweeps_of

KINDS = ("headway_ratio", "leader_braking", "observation_noise", "perception_latency", "action_delay")


def cpu() -> float:
    used = [resource.getrusage(kind) for kind in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def cost(chunk: Chunk) -> tuple[float, int]:
    """CPU seconds and rows."""
    began = cpu()
    rows, _ = chunk_rows(chunk, lambda *_: None)
    return cpu() - began, len(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=10)
    parser.add_argument("--measured", type=int, default=2)
    parser.add_argument("--policy", default="gri,idm,sumo")
    options = parser.parse_args()
    torch.set_num_threads(1)
    scenario = load_scenario("us101_car_following")
    policies = policies_of(options.policy.split(","), scenario)
    (whole,) = chunks(scenario, policies, sweeps_of(KINDS, (), scenario), options.starts)
    shared, rows = cost(whole)
    parts = [(cell, name) for cell in whole.cells for name in policies]
    print(f"shared: {len(parts)} cells × policies, {rows} drives, {shared:.1f} s")
    alone = []
    for cell, name in parts[:: max(len(parts) // options.measured, 1)][: options.measured]:
        seconds, drives = cost(replace(whole, cells=(cell,), policies={name: policies[name]}))
        alone.append(seconds)
        print(f"alone: {cell.perturbation} {cell.intensity} {name}, {drives} drives, {seconds:.1f} s")
    mean = statistics.mean(alone)
    print(f"ratio {len(parts) * mean / shared:.1f} = {len(parts)} × {mean:.1f} s ÷ {shared:.1f} s")


if __name__ == "__main__":
    main()
