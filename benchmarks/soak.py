"""Whether memory, open descriptors, processes and temporary files stay flat when one process works for a long time.

    python benchmarks/soak.py [--minutes 30] [--out soak.csv]

Cycles of what a notebook does: a run of an own policy, whose tables are opened, summarised and drawn; a learner's
episode in an environment that stays open; an input that is refused. After each cycle everything is counted, in this
process and in all that it has started. The first fifth of the cycles fills caches and is left out. Exits with 1 if
descriptors, processes or files grow, or memory by more than 5 %. Needs Linux.
"""

import argparse
import gc
import os
import shutil
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
from matplotlib import pyplot

import cosim
from cosim.environments import DrivingEnv
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario
from gri.core.policy import ConstantVelocity
from gri.errors import InputError

GROWTH = 0.05  # of memory between the first and the last third
COUNTED = ("memory_mb", "descriptors", "processes", "files")


def processes() -> list[Path]:
    """The folders in /proc of this process and of all that it has started."""
    group = os.getpgid(0)
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.getpgid(int(folder.name)) == group:
                found.append(folder)
    return found


def private_bytes(process: Path) -> int:
    """Memory that belongs to this process alone: copies share most of theirs with the original."""
    lines = (process / "smaps_rollup").read_text().splitlines()
    return sum(1024 * int(line.split()[1]) for line in lines if line.startswith("Private_"))


def count(temporary: Path) -> dict[str, float]:
    """Memory, descriptors, processes and temporary files at present."""
    gc.collect()
    memory = descriptors = number = 0
    for process in processes():
        with suppress(OSError):  # it has ended meanwhile
            memory += private_bytes(process)
            descriptors += len(os.listdir(process / "fd"))
            number += 1
    files = sum(1 for _ in temporary.rglob("*"))
    return {"memory_mb": memory / 1e6, "descriptors": descriptors, "processes": number, "files": files}


def cycle(scenario: Scenario, env: DrivingEnv, folder: Path, seed: int) -> None:
    """A run with its tables and picture, an episode of a learner, and a mistake."""
    done = cosim.run(scenario, ConstantVelocity(0.2), seed=seed, folder=folder / "run")
    assert len(cosim.open_run(done.folder).steps) == len(done.steps)
    done.summary()
    done.figure().savefig(folder / "episode.png")
    pyplot.close("all")
    shutil.rmtree(done.folder)
    env.reset()
    over = False
    while not over:
        _, _, ended, truncated, _ = env.step(env.action_space.sample())
        over = ended or truncated
    with suppress(InputError):
        cosim.run(scenario, "nobody", folder=folder / "never")


def growth(rows: pd.DataFrame) -> pd.DataFrame:
    """Medians of the first and last third of the cycles after the first fifth, and what grew too much."""
    late = rows.iloc[len(rows) // 5 :]
    third = max(len(late) // 3, 1)
    table = pd.DataFrame(
        {"first third": late[:third][[*COUNTED]].median(), "last third": late[-third:][[*COUNTED]].median()}
    )
    ratio = table["last third"] / table["first third"].clip(lower=1)
    return table.assign(
        grew=np.where(table.index == "memory_mb", ratio > 1 + GROWTH, table["last third"] > table["first third"])
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--out", type=Path, help="a CSV file of all counts")
    options = parser.parse_args()
    with suppress(PermissionError):
        os.setpgid(0, 0)
    scenario = load_scenario("us101_car_following")
    traffic = msgspec.structs.replace(scenario.traffic, warm_up=20.0)
    scenario = msgspec.structs.replace(
        scenario, traffic=traffic, horizon=2.0, watch=1.0, episodes=1, groups_at_once=1, time_limit=100.0
    )
    rows, ends = [], time.monotonic() + 60 * options.minutes
    with tempfile.TemporaryDirectory() as name:
        temporary = Path(name) / "tmp"
        temporary.mkdir()
        os.environ["TMPDIR"] = tempfile.tempdir = str(temporary)
        env = DrivingEnv(scenario)
        while time.monotonic() < ends or len(rows) < 8:
            cycle(scenario, env, Path(name), seed=len(rows) % 5 + 1)
            rows.append({"cycle": len(rows), **count(temporary)})
            if options.out:
                pd.DataFrame(rows).to_csv(options.out, index=False)
        env.close()
    table = growth(pd.DataFrame(rows))
    print(f"{len(rows)} cycles in {options.minutes:g} minutes")
    print(table.to_string(float_format="{:.1f}".format))
    sys.exit(int(table["grew"].any()))


if __name__ == "__main__":
    main()
