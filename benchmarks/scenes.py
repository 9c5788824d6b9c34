"""Cutting labelled scenes out of traffic ÷ bare SUMO stepping of the same traffic, side by side in one run.

    python benchmarks/scenes.py [SCENARIO] [--rounds 3] [--steps 1500]

Both sides simulate the same seed, each in a process of its own, one after the other. One steps the traffic bare, one
does everything `cosim scenes` does with rule labels: reading, asking, searching, cutting, labelling, writing. CPU time
after the warm-up. Where other work comes and goes on the machine the two sides meet unlike conditions; the second ratio
is that of all CPU time of the filming side to what it spent stepping.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import pandas  # noqa: F401  pyarrow brings it with the first table, once per process

from cosim.inputs import find_net
from cosim.loading import load_scenario
from cosim.scenes.rules import DT, KINDS, Rules
from cosim.scenes.shard import Reel, Spec, running
from cosim.snapshot import StepReport
from cosim.sumo import Sumo
from gri.data.scenes_file import Header, writing

Side = tuple[float, float, int]
"""CPU time per step [s] after the warm-up; of that, in SUMO's own step; scenes."""


def bare(name: str, steps: int) -> Side:
    """Steps only."""
    with warmed(name, steps) as (world, _, _):
        began = time.process_time()
        for _ in range(steps):
            world.step()
        spent = (time.process_time() - began) / steps
        return spent, spent, 0


def filming(name: str, steps: int) -> Side:
    """Steps and cuts scenes."""
    with warmed(name, steps) as (world, spec, folder):
        stepping = _timed(world)
        began = time.process_time()
        reel = Reel(world, spec)
        with writing(folder / "scenes.parquet", Header(dt=DT)) as write:
            for _ in range(steps):
                for block in reel.next(reel.tape.advance()):
                    write(block)
            for block in reel.developed():
                write(block)
        found = sum(tally.scenes for tally in reel.sieve.tallies.values())
        return (time.process_time() - began) / steps, sum(stepping) / steps, found


def _timed(world: Sumo) -> list[float]:
    """CPU times of its steps from now on [s]."""
    step, times = world.step, []

    def timed() -> StepReport:
        began = time.process_time()
        report = step()
        times.append(time.process_time() - began)
        return report

    world.step = timed
    return times


@contextmanager
def warmed(name: str, steps: int) -> Iterator[tuple[Sumo, Spec, Path]]:
    """The scenario's traffic after its warm-up."""
    scenario = load_scenario(name)
    spec = Spec(scenario=scenario, source="", split="train", kinds=KINDS, count=10**6, gold=False, rules=Rules())
    end = scenario.traffic.warm_up + steps * scenario.step
    with (
        tempfile.TemporaryDirectory() as scratch,
        running(scenario, find_net(scenario.net), Path(scratch), end) as world,
    ):
        for _ in range(scenario.steps(scenario.traffic.warm_up)):
            world.step()
        yield world, spec, Path(scratch)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario", nargs="?", default="us101_merge")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=1500)
    options = parser.parse_args()
    ratios, own = [], []
    for _ in range(options.rounds):
        alone, together = (_apart(side, options.scenario, options.steps) for side in (bare, filming))
        ratios.append(together[0] / alone[0])
        own.append(together[0] / together[1])
        milliseconds = [f"{1e3 * side[0]:.2f} ms" for side in (alone, together)]
        both = f"ratio {ratios[-1]:.2f}, to its own stepping {own[-1]:.2f}"
        print(f"bare {milliseconds[0]}, filming {milliseconds[1]}, {both}, {together[2]} scenes", flush=True)
    medians = f"{statistics.median(ratios):.2f}, to its own stepping {statistics.median(own):.2f}"
    print(f"median ratio {medians} over {len(ratios)} rounds")


def _apart(side: Callable[[str, int], Side], name: str, steps: int) -> Side:
    """One side in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(side, name, steps).result()


if __name__ == "__main__":
    main()
