"""A batch whose runs share warm-ups ÷ the same batch in which every run warms up by itself.

    python benchmarks/shared_warm_ups.py [--batch benchmarks/shared_warm_ups.yaml] [--rounds 3] [--workers 1]

Both ways take turns, each in folders of its own. The time is the wall-clock time of the runs, so it needs an idle
machine to be told in seconds; the ratio needs one that is evenly loaded. The tables of both are compared byte by byte.
"""

import argparse
import statistics
import time
from collections import deque
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from cosim.batch.execute import execute
from cosim.batch.run_matrix import expand, load_batch
from cosim.batch.store import BatchStore
from cosim.process.task import Task, TaskResults
from cosim.process.task_pool import run_local


def alone(queue: deque[Task], time_limit: float, *, workers: int) -> TaskResults:
    """Do the tasks without what they share."""
    return run_local(deque(replace(task, preparation=None) for task in queue), time_limit, workers=workers)


def tables(folder: Path) -> dict[str, bytes]:
    """The content of all Parquet files by their paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*.parquet"))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batch", default=str(Path(__file__).with_name("shared_warm_ups.yaml")))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    batch, file = load_batch(options.batch)
    runs, spent, seen = expand(batch, file), {"shared": [], "alone": []}, {}
    for _ in range(options.rounds):
        for name, pool in (("shared", run_local), ("alone", alone)):
            with TemporaryDirectory() as folder:
                began = time.monotonic()
                executor = partial(pool, workers=options.workers)
                tally = execute(
                    batch, runs, BatchStore(Path(folder)), executor, lambda _: None, file=file, retry=False, warn=print
                )
                spent[name].append(time.monotonic() - began)
                seen[name] = tables(Path(folder))
                assert tally.done == len(runs), f"{tally.failed} of {len(runs)} runs failed"
        shared, by_itself = spent["shared"][-1], spent["alone"][-1]
        same = "the same bytes" if seen["shared"] == seen["alone"] else "DIFFERENT TABLES"
        print(
            f"{len(runs)} runs: shared {shared:.1f} s, alone {by_itself:.1f} s, ratio {shared / by_itself:.2f}, {same}"
        )
    print(f"median ratio {statistics.median(a / b for a, b in zip(*spent.values(), strict=True)):.2f}")


if __name__ == "__main__":
    main()
