"""Cutting labelled scenes out of traffic ÷ bare SUMO stepping of the same traffic, side by side in one run.

    python benchmarks/scenes.py [SCENARIO] [--rounds 5] [--steps 600]

Both sides are branches of one warmed-up simulation and start from the same state. A round steps the traffic bare, then
with everything `cosim scenes` does with rule labels: reading, asking, searching, cutting, labelling, writing. CPU time.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import pandas  # noqa: F401  pyarrow brings it with the first table, once per process

from cosim.branch import fork
from cosim.inputs import find_net
from cosim.loading import load_scenario
from cosim.scenes.rules import DT, KINDS, Rules
from cosim.scenes.shard import Reel, Spec, running
from cosim.sumo import Sumo
from gri.data.scenes_file import Header, writing


def bare(world: Sumo, steps: int) -> float:
    began = time.process_time()
    for _ in range(steps):
        world.step()
    return (time.process_time() - began) / steps


def filming(world: Sumo, spec: Spec, steps: int, folder: Path) -> tuple[float, int]:
    began = time.process_time()
    reel = Reel(world, spec)
    with writing(folder / "scenes.parquet", Header(dt=DT)) as write:
        for _ in range(steps):
            for block in reel.next(reel.tape.advance()):
                write(block)
        for block in reel.developed():
            write(block)
    found = sum(tally.scenes for tally in reel.sieve.tallies.values())
    return (time.process_time() - began) / steps, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario", nargs="?", default="us101_merge")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=600)
    options = parser.parse_args()
    scenario = load_scenario(options.scenario)
    spec = Spec(
        scenario=scenario, source="", split="train", kinds=KINDS, count=10**6, gold=False, rules=Rules()
    )  # fmt: skip
    end = scenario.traffic.warm_up + options.rounds * options.steps * scenario.step
    with (
        tempfile.TemporaryDirectory() as scratch,
        running(scenario, find_net(scenario.net), Path(scratch), end) as world,
    ):
        for _ in range(scenario.steps(scenario.traffic.warm_up)):
            world.step()
        ratios = []
        for _ in range(options.rounds):
            alone = fork(lambda: bare(world, options.steps)).result()
            together, found = fork(lambda: filming(world, spec, options.steps, Path(scratch))).result()
            ratios.append(together / alone)
            print(f"bare {1e3 * alone:.2f} ms, filming {1e3 * together:.2f} ms, ratio {ratios[-1]:.2f}, {found} scenes")
            for _ in range(options.steps):
                world.step()
    print(f"median ratio {statistics.median(ratios):.2f} over {len(ratios)} rounds")


if __name__ == "__main__":
    main()
