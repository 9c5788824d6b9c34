"""What a large batch costs besides its simulations: CPU, memory, files and bytes by the number of runs, then projected.

    python benchmarks/large_batch.py [--sizes 500,1000,2000] [--scenario us101_car_following] [--real 24] [--nodes 100]

Does a few real runs of the scenario. Their tables then stand in turn for those of every run of batches of these sizes.
So all the machinery of a batch works (listing runs, records, publishing, packing, reading), and only the simulations
are left out. Each size is done twice, in shards and with a folder per run, in a process of its own. Costs per run are
the slopes of straight lines through the sizes; the worst deviation from the line is printed beside them. The bytes are
those of the real runs alone, because tables that repeat would take less.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from collections import deque
from functools import partial
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml

from cosim.batch.execute import execute
from cosim.batch.result_listing import groups_of, overview_table
from cosim.batch.run_matrix import expand, load_batch
from cosim.batch.store import BatchStore
from cosim.process.task import Task, TaskResult, TaskResults
from gri.table import markdown_table

MEASURES = {
    "listing": ("list and check the runs, CPU", "ms"),
    "recording": ("publish, record and pack, CPU", "ms"),
    "memory": ("memory of the command", "kB"),
    "files": ("files", ""),
    "reading": ("`cosim results`, CPU", "ms"),
    "reading_memory": ("memory of `cosim results`", "kB"),
}


def copied(queue: deque[Task], time_limit: float, *, real: list[Path]) -> TaskResults:
    """Every task ends with the files of the next real run."""
    folders = cycle(real)
    while queue:
        task = queue.popleft()
        shutil.copytree(next(folders), task.folder)
        yield TaskResult(task.name, task.folder, "done", "")


def files_and_bytes(folder: Path) -> tuple[int, int]:
    """How many names of files a folder has, and how many bytes; hard links count once."""
    found = [path for path in folder.rglob("*") if path.is_file()]
    return len(found), sum({(at.st_dev, at.st_ino): at.st_size for at in map(os.stat, found)}.values())


def peak() -> float:
    """The greatest memory of this process so far [kB]."""
    return float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def measure(file: Path, out: Path, real: Path) -> dict[str, float]:
    """The costs of one batch up to its records."""
    began, memory = time.process_time(), peak()
    batch, path = load_batch(str(file))
    runs, listed = expand(batch, path), time.process_time()
    executor = partial(copied, real=sorted(real.iterdir()))
    tally = execute(batch, runs, BatchStore(out), executor, lambda _: None, file=path, retry=False, warn=print)
    assert tally.done == len(runs)
    files, size = files_and_bytes(out)
    return {
        "listing": 1e3 * (listed - began),
        "recording": 1e3 * (time.process_time() - listed),
        "memory": peak() - memory,
        "files": files,
        "kB": size / 1e3,
    }


def measure_reading(out: Path) -> dict[str, float]:
    """The costs of the table of its results."""
    began, memory = time.process_time(), peak()
    overview_table(groups_of(BatchStore(out)), "policy")
    return {"reading": 1e3 * (time.process_time() - began), "reading_memory": peak() - memory}


def in_own_process(what: str, *arguments: object) -> dict[str, float]:
    words = [sys.executable, __file__, "--measure", what, *map(str, arguments)]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()[-1])


def line(sizes: list[int], values: list[float]) -> tuple[float, float]:
    """The slope of a straight line through the values, and the greatest deviation from it as a share of the value."""
    slope, offset = np.polyfit(sizes, values, 1)
    return float(slope), float(max(abs(1 - (slope * n + offset) / v) for n, v in zip(sizes, values, strict=True) if v))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", default="500,1000,2000")
    parser.add_argument("--scenario", default="us101_car_following")
    parser.add_argument("--real", type=int, default=24, help="real runs, with other seeds")
    parser.add_argument("--nodes", type=int, default=100)
    parser.add_argument("--cores", type=int, default=16, help="of a node")
    parser.add_argument("--measure", nargs="+", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        what, *paths = options.measure
        return print(json.dumps((measure if what == "batch" else measure_reading)(*map(Path, paths))))
    sizes = [int(size) for size in options.sizes.split(",")]
    ways: dict[str, dict[str, list[float]]] = {}
    with TemporaryDirectory() as scratch:
        one = {"scenarios": [options.scenario], "policies": {"idm": {"kind": "idm"}}, "seeds": [1]}
        real, run = real_runs(Path(scratch), one, options.real)
        for way, shards in (("in shards", {"shards": {}}), ("a folder per run", {})):
            found = ways.setdefault(way, {name: [] for name in (*MEASURES, "kB")})
            for size in sizes:
                file, out = Path(scratch, "b.yaml"), Path(scratch, "out")
                file.write_text(yaml.safe_dump({**one, "seeds": {"count": size}, **shards}))
                costs = in_own_process("batch", file, out, real) | in_own_process("results", out)
                for name in MEASURES:
                    found[name].append(costs[name])
                print(f"{way}, {size} runs: " + ", ".join(f"{name} {value:.0f}" for name, value in costs.items()))
                shutil.rmtree(out)
            file.write_text(yaml.safe_dump({**one, "seeds": {"count": options.real}, **shards}))
            found["kB"] = [in_own_process("batch", file, out, real)["kB"] / options.real]
            shutil.rmtree(out)
    print(f"\nOne real run: {run['seconds']:.1f} s of CPU, peak memory {run['peak_mb']:.0f} MB\n")
    report(sizes, ways)
    project(ways, sizes, run, options.nodes, options.cores)


def real_runs(scratch: Path, content: dict, count: int) -> tuple[Path, dict[str, float]]:
    """The folder of real runs of a batch, and the CPU seconds and the peak memory of one in the mean."""
    (scratch / "real.yaml").write_text(yaml.safe_dump({**content, "seeds": {"count": count}}))
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "cosim", "batch", "real.yaml", "--workers", "1", "--out", "real"]
    subprocess.run(command, cwd=scratch, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    entries = [json.loads(line) for line in (scratch / "real/log.jsonl").read_text().splitlines()]
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    memory = sum(entry["peak_mb"] for entry in entries) / count
    return scratch / "real/runs", {"seconds": cpu / count, "peak_mb": memory}


def report(sizes: list[int], ways: dict[str, dict[str, list[float]]]) -> None:
    lines = []
    for name, (title, unit) in MEASURES.items():
        row = [f"{title} [{unit}]" if unit else title]
        for found in ways.values():
            slope, off = line(sizes, found[name])
            row += [f"{abs(slope):.3g}", f"{100 * off:.0f} %"]
        lines.append(row)
    lines.append(["bytes [kB]", *(text for found in ways.values() for text in (f"{found['kB'][0]:.3g}", ""))])
    head = ["per run", *(text for way in ways for text in (way, "off the line"))]
    print(markdown_table(head, lines))


def project(
    ways: dict[str, dict[str, list[float]]], sizes: list[int], run: dict[str, float], nodes: int, cores: int
) -> None:
    """What a million runs would take: an extrapolation of the lines."""
    million, lines = 1e6, []
    for way, found in ways.items():
        per = {name: line(sizes, found[name])[0] for name in MEASURES}
        main_hours = million * (per["listing"] + per["recording"]) / 1e3 / 3600
        lines.append(
            [
                way,
                f"{million * per['files']:.3g}",
                f"{million * found['kB'][0] / 1e9:.3g}",
                f"{main_hours:.2g}",
                f"{million * per['memory'] / 1e6:.2g}",
                f"{million * per['reading'] / 3.6e6:.2g}",
                f"{million * per['reading_memory'] / 1e6:.2g}",
            ]
        )
    hours = million * run["seconds"] / 3600
    print(f"\n1e6 runs: {hours:.0f} core hours, {hours / nodes / cores:.1f} h on {nodes} nodes of {cores} cores\n")
    head = ["", "files", "TB", "CPU h of the command", "its memory [GB]", "`results` [CPU h]", "its memory [GB]"]
    print(markdown_table(head, lines))


if __name__ == "__main__":
    main()
