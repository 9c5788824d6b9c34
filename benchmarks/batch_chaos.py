"""Robustness of a batch of 500 tiny runs: workers and runs are killed by SIGKILL at random, then the command itself.

    python benchmarks/batch_chaos.py --out /tmp/chaos [--kills 24] [--lives 3]

The command is started `--lives` times. Every time but the last it is killed; the last time it finishes the batch.
Prints how the attempts and the runs ended, and the trend of the processes' memory. Needs /proc.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

BATCH = Path(__file__).parent / "batch.yaml"


def descendants(pid: int) -> list[int]:
    """Process ids of the workers and of the runs in them."""
    found = []
    for listed in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            for child in map(int, listed.read_text().split()):
                found += [child, *descendants(child)]
        except OSError:
            continue  # the process has ended
    return found


def is_run(pid: int) -> bool:
    try:
        return b"resource_tracker" not in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def kill_at_random(command: subprocess.Popen[bytes], kills: int, rng: random.Random) -> int:
    """Kill up to `kills` processes at random times while the command runs; returns how many were killed."""
    done = 0
    while done < kills and command.poll() is None:
        time.sleep(rng.uniform(0.5, 4.0))
        victims = [victim for victim in descendants(command.pid) if is_run(victim)]
        if victims:
            try:
                os.kill(rng.choice(victims), signal.SIGKILL)
                done += 1
            except ProcessLookupError:
                continue
    return done


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kills", type=int, default=24)
    parser.add_argument("--lives", type=int, default=3)
    options = parser.parse_args()
    command = [sys.executable, "-m", "cosim", "batch", str(BATCH), "--workers", "2", "--out", str(options.out)]
    rng, kills, began = random.Random(1), 0, time.monotonic()
    for _ in range(options.lives - 1):
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            kills += kill_at_random(process, options.kills // (options.lives - 1), rng)
            process.kill()
    subprocess.run([*command, "--retry-failed"], check=True)
    states = json.loads((options.out / "manifest.json").read_text())["states"]
    log = [json.loads(line) for line in (options.out / "log.jsonl").read_text().splitlines()]
    done = [entry for entry in log if entry["ended"] == "done"]
    peaks = np.array([entry["peak_mb"] for entry in done])
    print(f"{kills} kills, {options.lives - 1} of the command; runs {states}; {time.monotonic() - began:.0f} s")
    twice = len(done) - len({entry["run"] for entry in done})
    print(f"attempts {dict(Counter(entry['ended'] for entry in log))}, runs done twice {twice}")
    print(f"half-written folders {len(list(options.out.glob('runs/*.partial')))}")
    slope = np.polyfit(np.arange(len(peaks)), peaks, 1)[0]
    print(f"peak memory of a run {peaks.min():.1f} to {peaks.max():.1f} MB, trend {500 * slope:.2f} MB over 500 runs")


if __name__ == "__main__":
    main()
