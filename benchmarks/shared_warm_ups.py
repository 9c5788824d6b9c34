"""A batch whose runs share warm-ups and counterparts ÷ the same batch in which every run is done alone.

    python benchmarks/shared_warm_ups.py [--batch benchmarks/shared_warm_ups.yaml] [--rounds 3] [--alone 4]

Both ways take turns, each in folders of its own. Of the runs alone only `--alone` are done, evenly spread over the
batch; their mean counts for all (0: all are done). Told are CPU times of all processes that were started, and
wall-clock times, which need an evenly loaded machine. The tables of both are compared byte by byte. Needs Linux:
processes whose parent has ended are counted, too.
"""

import argparse
import ctypes
import os
import resource
import statistics
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from cosim.batch.execute import Executor, execute
from cosim.batch.run_matrix import Run, expand, load_batch
from cosim.batch.spec import Batch
from cosim.batch.store import BatchStore
from cosim.process.task import Task, TaskResults
from cosim.process.task_pool import run_local

ADOPT_ORPHANS = 36  # of prctl: PR_SET_CHILD_SUBREAPER


def alone(queue: deque[Task], time_limit: float, *, workers: int) -> TaskResults:
    """Do the tasks without what they share."""
    return run_local(deque(replace(task, preparation=None) for task in queue), time_limit, workers=workers)


def tables(folder: Path) -> dict[str, bytes]:
    """The content of all Parquet files of single runs by their paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.glob("runs/*/*.parquet"))}


def cpu() -> float:
    """CPU time [s] of this process and of all that it started, once these have ended."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG) != (0, 0):
            pass
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def do(batch: Batch, file: Path, runs: Sequence[Run], executor: Executor) -> tuple[float, float, dict[str, bytes]]:
    """CPU time [s], wall-clock time [s] and tables of these runs."""
    with TemporaryDirectory() as folder:
        used, began = cpu(), time.monotonic()
        store = BatchStore(Path(folder))
        tally = execute(batch, runs, store, executor, lambda _: None, file=file, retry=False, warn=print)
        assert tally.done == len(runs), f"{tally.failed} of {len(runs)} runs failed"
        took = time.monotonic() - began
        time.sleep(1.0)  # processes that waited notice that nobody needs them any more
        return cpu() - used, took, tables(Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--batch", default=str(Path(__file__).with_name("shared_warm_ups.yaml")))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--alone", type=int, default=0)
    options = parser.parse_args()
    ctypes.CDLL(None).prctl(ADOPT_ORPHANS, 1, 0, 0, 0)
    batch, file = load_batch(options.batch)
    runs, ratios = expand(batch, file), []
    some = runs[:: max(len(runs) // (options.alone or len(runs)), 1)]
    for _ in range(options.rounds):
        *together, shared = do(batch, file, runs, partial(run_local, workers=options.workers))
        *apart, by_itself = do(batch, file, some, partial(alone, workers=options.workers))
        same = "the same bytes" if all(shared[name] == content for name, content in by_itself.items()) else "DIFFERENT"
        (used, took), (used_alone, took_alone) = together, (spent * len(runs) / len(some) for spent in apart)
        ratios.append(used / used_alone)
        print(
            f"{len(runs)} runs: shared {used:.1f} s of CPU, alone {used_alone:.1f} s (from {len(some)}), ratio"
            f" {ratios[-1]:.2f}; wall-clock {took:.0f} s and {took_alone:.0f} s, ratio {took / took_alone:.2f}; {same}",
            flush=True,
        )
    print(f"median ratio of CPU times {statistics.median(ratios):.2f}")


if __name__ == "__main__":
    main()
