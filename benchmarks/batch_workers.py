"""Throughput of two workers ÷ that of one on the same 500 tiny runs, and whether both wrote the same bytes.

python benchmarks/batch_workers.py --out /tmp/workers [--runs 500]
"""

import argparse
import subprocess
import sys
import time
from pathlib import Path

BATCH = Path(__file__).parent / "batch.yaml"


def seconds(file: Path, out: Path, workers: int) -> float:
    """Wall-clock time of the whole command, its start included."""
    began = time.monotonic()
    command = [sys.executable, "-m", "cosim", "batch", str(file), "--workers", str(workers), "--out", str(out)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.monotonic() - began


def contents(folder: Path) -> dict[str, bytes]:
    """Every table of every run, by its path in the folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.glob("runs/*/*.parquet")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--runs", type=int, default=500)
    options = parser.parse_args()
    options.out.mkdir(parents=True)
    file = options.out / "batch.yaml"
    file.write_text(BATCH.read_text().replace("count: 250", f"count: {options.runs // 2}"))
    one, two = (seconds(file, options.out / str(workers), workers) for workers in (1, 2))
    tables = {workers: contents(options.out / workers) for workers in ("1", "2")}
    print(f"{options.runs} runs: one worker {one:.0f} s, two workers {two:.0f} s, ratio {one / two:.2f}")
    print(f"{len(tables['1'])} tables, the same bytes: {tables['1'] == tables['2']}")


if __name__ == "__main__":
    main()
