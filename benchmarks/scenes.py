"""Cutting labelled scenes out of traffic ÷ bare SUMO stepping of the same traffic, side by side in one run.

    python benchmarks/scenes.py [SCENARIO] [--rounds 3] [--steps 1000]

Both sides are branches of one warmed-up simulation and start from the same state. One only steps the traffic. The other
does everything that `cosim scenes` does with rule labels: reading, searching, cutting, labelling, writing. They take
turns every 50 steps, so that other load of the machine slows both alike. Times are CPU times. The second ratio is all
CPU time of the side that makes scenes ÷ the part of it spent in stepping.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pandas  # noqa: F401  pyarrow brings it with the first table, once per process
from turns import side_by_side

from cosim.scenes.scene_rules import DT, KINDS, Rules
from cosim.scenes.seed_scenes import SceneExtractor, SeedSpec, undisturbed_traffic
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.sumo import Sumo
from cosim.world.snapshot import StepReport
from gri.data.scene_file.schema import Header, writing

TURN = 50  # steps
BETWEEN = 100  # steps from one round to the next
Side = tuple[float, float, int]
"""CPU time per step [s]; of that, in SUMO's own step; scenes."""


def bare(world: Sumo, steps: int) -> Side:
    """Steps only."""
    began = time.process_time()
    for _ in range(steps):
        world.step()
    spent = (time.process_time() - began) / steps
    return spent, spent, 0


def with_extraction(world: Sumo, spec: SeedSpec, steps: int, file: Path) -> Side:
    """Steps, and extracts scenes."""
    stepping, began = _timed(world), time.process_time()
    extractor = SceneExtractor(world, spec)
    with writing(file, Header(dt=DT)) as write:
        for _ in range(steps):
            for block in extractor.process(extractor.buffer.advance()):
                write(block)
        for block in extractor.filter_clips():
            write(block)
    spent = (time.process_time() - began) / steps
    return spent, sum(stepping) / steps, sum(tally.scenes for tally in extractor.scene_filter.tallies.values())


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
def warmed(name: str, steps: int) -> Iterator[tuple[Sumo, SeedSpec, Path]]:
    """The scenario's traffic after its warm-up, with demand for `steps` more."""
    scenario = load_scenario(name)
    spec = SeedSpec(scenario=scenario, source="", split="train", kinds=KINDS, count=10**6, gold=False, rules=Rules())
    end = scenario.traffic.warm_up + steps * scenario.step
    with (
        tempfile.TemporaryDirectory() as scratch,
        undisturbed_traffic(scenario, find_net(scenario.net), Path(scratch), end) as world,
    ):
        for _ in range(scenario.steps(scenario.traffic.warm_up)):
            world.step()
        yield world, spec, Path(scratch)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario", nargs="?", default="us101_merge")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=1000)
    options = parser.parse_args()
    ratios, own = [], []
    with warmed(options.scenario, options.steps + options.rounds * BETWEEN) as (world, spec, folder):
        for _ in range(options.rounds):
            alone, together = side_by_side(
                world,
                TURN,
                lambda: bare(world, options.steps),
                lambda: with_extraction(world, spec, options.steps, folder / "scenes.parquet"),
            )
            ratios.append(together[0] / alone[0])
            own.append(together[0] / together[1])
            milliseconds = [f"{1e3 * side[0]:.2f} ms" for side in (alone, together)]
            both = f"ratio {ratios[-1]:.2f}, to its own stepping {own[-1]:.2f}"
            print(
                f"bare {milliseconds[0]}, with extraction {milliseconds[1]}, {both}, {together[2]} scenes", flush=True
            )
            for _ in range(BETWEEN):
                world.step()
    medians = f"{statistics.median(ratios):.2f}, to its own stepping {statistics.median(own):.2f}"
    print(f"median ratio {medians} over {len(ratios)} rounds")


if __name__ == "__main__":
    main()
