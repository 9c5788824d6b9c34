"""Steps per second and reset times of the environments, beside highway-env and a loop of per-vehicle getters.

    pip install highway-env
    python benchmarks/environments.py [--scenario us101_merge] [--rounds 5] [--steps 200]

All take turns in one run, so that other load of the machine slows all alike; figures are medians of the rounds. The
loop of getters is what libraries such as sumo-rl do: in every step they read position, speed, angle and lane of every
vehicle by one call each, command one vehicle, and a reset starts SUMO and its warm-up anew. It runs in process, by
libsumo, on the same traffic. highway-env has a small world of its own without SUMO.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import gymnasium
import libsumo
import numpy as np

from cosim.environments import DrivingEnv, DrivingVectorEnv
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation

PARALLEL = 4


def of_gymnasium(env: gymnasium.Env, steps: int) -> Iterator[tuple[float, float]]:
    """Seconds per step and seconds of a reset, round by round."""
    env.reset(seed=1)
    while True:
        resets, stepping = [], 0.0
        for _ in range(steps):
            began = time.perf_counter()
            _, _, ended, truncated, _ = env.step(env.action_space.sample())
            stepping += time.perf_counter() - began
            if ended or truncated or not resets:
                began = time.perf_counter()
                env.reset()
                resets.append(time.perf_counter() - began)
        yield stepping / steps, statistics.median(resets)


def of_vector(scenario: str, steps: int) -> Iterator[tuple[float, float]]:
    """Seconds per step of one episode where several are driven at the same time; resets are inside the steps."""
    env = DrivingVectorEnv(scenario, PARALLEL)
    env.reset(seed=1)
    while True:
        began = time.perf_counter()
        for _ in range(steps // PARALLEL):
            env.step(env.action_space.sample())
        yield (time.perf_counter() - began) / (steps // PARALLEL * PARALLEL), float("nan")


def of_getters(name: str, steps: int) -> Iterator[tuple[float, float]]:
    """The loop of per-vehicle getters in warmed-up traffic."""
    scenario, api = load_scenario(name), libsumo.vehicle
    with tempfile.TemporaryDirectory() as scratch:
        files = SumoFiles(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        inputs = prepare_simulation(scenario, files, scenario.time_limit)
        inputs.write()

        def reset() -> float:
            began = time.perf_counter()
            with suppress(libsumo.TraCIException):
                libsumo.close()
            libsumo.start(["sumo", *inputs.arguments])
            for _ in range(scenario.steps(scenario.traffic.warm_up)):
                libsumo.simulationStep()
            return time.perf_counter() - began

        taken = reset()
        while True:
            began = time.perf_counter()
            for _ in range(steps):
                ids = api.getIDList()
                [(api.getPosition(v), api.getSpeed(v), api.getAngle(v), api.getLaneID(v)) for v in ids]
                api.setSpeed(ids[0], 10.0)
                libsumo.simulationStep()
            yield (time.perf_counter() - began) / steps, taken


def rows(scenario: str, steps: int) -> dict[str, Iterator[tuple[float, float]]]:
    """What is compared."""
    found = {
        "DrivingEnv": of_gymnasium(DrivingEnv(scenario), steps),
        f"DrivingVectorEnv, {PARALLEL} episodes at once": of_vector(scenario, steps),
        "per-vehicle getters, libsumo": of_getters(scenario, steps),
    }
    with suppress(ImportError):
        import highway_env

        gymnasium.register_envs(highway_env)
        found["highway-env merge-v0"] = of_gymnasium(gymnasium.make("merge-v0"), steps)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="us101_merge")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=200)
    given = parser.parse_args()
    compared = rows(given.scenario, given.steps)
    measured: dict[str, list[tuple[float, float]]] = {name: [] for name in compared}
    for _ in range(given.rounds):
        for name, turns in compared.items():
            measured[name].append(next(turns))
    for name, pairs in measured.items():
        step, reset = (float(np.median(column)) for column in zip(*pairs, strict=True))
        print(f"{name:40s} {1 / step:8.0f} steps/s {1e3 * step:8.2f} ms/step {1e3 * reset:10.2f} ms/reset")


if __name__ == "__main__":
    main()
