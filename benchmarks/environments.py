"""CPU time of a step and of a reset of an environment, beside highway-env and a loop of per-vehicle getters.

    pip install highway-env
    python benchmarks/environments.py [--scenario us101_merge] [--rounds 5] [--steps 60]

All take turns in one run; figures are medians of the rounds. CPU time is that of all processes of an environment: it
and the process of its episode wait for each other in every step, so on a busy machine wall time is that of the
scheduler. `--real-time` (as root) gives all of them priority over everything else, so that wall times are nearly those
of a quiet machine; without it, those of a busy one say little. The loop of getters is what libraries such as sumo-rl
do: in every step they read position, speed, angle and lane of every vehicle by one call each, and a reset starts SUMO
and its warm-up anew. It runs in process, by libsumo, on the same traffic. highway-env has a small world of its own
without SUMO. Needs Linux.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import gymnasium
import libsumo
import numpy as np

from cosim.environments import DrivingEnv
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation

Times = tuple[float, float, float]
"""CPU seconds of a step and of a reset, and wall seconds of a reset."""
PRIORITY = 20  # of real-time processes


def used() -> dict[int, float]:
    """CPU seconds so far of this process and of all that it started, by process."""
    found: dict[int, float] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.getpgid(int(folder.name)) == os.getpgid(0):
                found[int(folder.name)] = int((folder / "schedstat").read_text().split()[0]) / 1e9
    return found | {os.getpid(): time.process_time()}  # read last: the search itself takes long


def since(before: dict[int, float]) -> float:
    """CPU seconds since then, of processes that are still there."""
    own = {os.getpid(): time.process_time()}
    return sum(seconds - before.get(process, 0.0) for process, seconds in (used() | own).items())


@contextmanager
def priority(real_time: bool) -> Iterator[None]:
    """Give this process and all that it started priority over other processes."""
    for scheduler, level in ((os.SCHED_FIFO, PRIORITY), (os.SCHED_OTHER, 0)):
        for process in used() if real_time else ():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(process, scheduler, os.sched_param(level))
        if scheduler == os.SCHED_FIFO:
            yield


def of_environment(env: gymnasium.Env, steps: int, resets_wanted: int) -> Iterator[Times]:
    """One environment: an episode begins anew before it can end, so that none of its processes is missed."""
    env.reset(seed=1)
    env.action_space.seed(1)
    while True:
        resets, waits, stepping, counted = [], [], 0.0, 0
        while counted < steps or len(resets) < resets_wanted:
            before, began = used(), time.perf_counter()
            env.reset()
            waits.append(time.perf_counter() - began)
            resets.append(since(before))
            before, over, taken = used(), False, 0
            while not over and taken < 10 and counted < steps:
                _, _, ended, truncated, _ = env.step(env.action_space.sample())
                over, taken = ended or truncated, taken + 1
            if not over and taken:
                stepping, counted = stepping + since(before), counted + taken
        yield stepping / counted, float(np.median(resets)), float(np.median(waits))


def of_getters(name: str, steps: int) -> Iterator[Times]:
    """The loop of per-vehicle getters in warmed-up traffic."""
    scenario, api = load_scenario(name), libsumo.vehicle
    with tempfile.TemporaryDirectory() as scratch:
        files = SumoFiles(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        inputs = prepare_simulation(scenario, files, scenario.time_limit)
        inputs.write()
        while True:
            began, entered = time.process_time(), time.perf_counter()
            with suppress(libsumo.TraCIException, libsumo.FatalTraCIError):
                libsumo.close()
            libsumo.start(["sumo", *inputs.arguments])
            for _ in range(scenario.steps(scenario.traffic.warm_up)):
                libsumo.simulationStep()
            reset, wait, began = time.process_time() - began, time.perf_counter() - entered, time.process_time()
            for _ in range(steps):
                ids = api.getIDList()
                for vehicle in ids:
                    api.getPosition(vehicle), api.getSpeed(vehicle), api.getAngle(vehicle), api.getLaneID(vehicle)
                api.setSpeed(ids[0], 10.0)
                libsumo.simulationStep()
            yield (time.process_time() - began) / steps, reset, wait


def compared(scenario: str, steps: int, resets: int) -> dict[str, Iterator[Times]]:
    """What takes turns."""
    found = {
        "DrivingEnv": of_environment(DrivingEnv(scenario), steps, resets),
        "per-vehicle getters, libsumo": of_getters(scenario, steps),
    }
    with suppress(ImportError):
        import highway_env

        gymnasium.register_envs(highway_env)
        found["highway-env merge-v1"] = of_environment(gymnasium.make("merge-v1"), steps, resets)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="us101_merge")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--resets", type=int, default=40, help="in each round, at least")
    parser.add_argument("--real-time", action="store_true", help="give them priority over all other processes")
    given = parser.parse_args()
    os.setpgid(0, 0)  # what this process starts can be told by its process group
    rows = compared(given.scenario, given.steps, given.resets)
    measured: dict[str, list[Times]] = {name: [] for name in rows}
    for _ in range(given.rounds):
        for name, turns in rows.items():
            if not measured[name]:
                next(turns)  # warms up
            with priority(given.real_time):
                measured[name].append(next(turns))
    for name, rounds in measured.items():
        step, reset, wait = (1e3 * float(np.median(column)) for column in zip(*rounds, strict=True))
        print(f"{name:32s} step {step:6.2f} ms of CPU, reset {reset:8.1f} ms of CPU and {wait:8.1f} ms by the clock")


if __name__ == "__main__":
    main()
