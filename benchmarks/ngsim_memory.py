"""Peak memory of `gri ngsim inspect` and `gri ngsim scenes` on generated files of full size.

    python benchmarks/ngsim_memory.py                # one period in the official text form, 1.2 million rows
    python benchmarks/ngsim_memory.py --periods 10   # the data portal's form, all periods in one file: 12 million rows
    python benchmarks/ngsim_memory.py --periods 10 --only inspect

The traffic is five lanes at constant speeds. It has as many rows, vehicles and scenes as a recording, but contains no
recorded data.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import csv

COLUMNS = [
    "Vehicle_ID",
    "Frame_ID",
    "Total_Frames",
    "Global_Time",
    "Local_X",
    "Local_Y",
    "Global_X",
    "Global_Y",
    "v_Length",
    "v_Width",
    "v_Class",
    "v_Vel",
    "v_Acc",
    "Lane_ID",
    "Preceding",
    "Following",
    "Space_Headway",
    "Time_Headway",
]
LANES, ROAD, SPEED, APART = 5, 2100.0, 39.0, 88.0  # [ft], [ft/s]; 88 ft from front to front
CLOCK = 1118846980200  # [ms]
TRACK = int(ROAD / SPEED * 10)
"""Frames from end to end."""


def vehicles(rows: int, first_clock: int, chunk: int = 200) -> Iterator[pd.DataFrame]:
    """Rows of one period, some vehicles at a time."""
    for start in range(0, rows // TRACK, chunk):
        number = np.arange(start, min(start + chunk, rows // TRACK))
        lane = number % LANES + 1
        speed = SPEED - 0.5 * lane
        step = np.arange(TRACK)
        frame = (number // LANES * int(10 * APART / SPEED))[:, None] + step
        cell: dict[str, np.ndarray] = {name: np.zeros(frame.size) for name in COLUMNS}
        cell["Vehicle_ID"], cell["Frame_ID"] = np.repeat(number + 1, TRACK), frame.ravel()
        cell["Total_Frames"] = np.full(frame.size, TRACK)
        cell["Global_Time"] = first_clock + 100 * frame.ravel()
        cell["Local_X"] = np.repeat(6.0 + 12 * (lane - 1), TRACK)
        cell["Local_Y"] = (speed[:, None] * 0.1 * step).ravel().round(3)
        cell["v_Length"], cell["v_Width"], cell["v_Class"] = (np.full(frame.size, v) for v in (15.0, 6.0, 2))
        cell["v_Vel"], cell["Lane_ID"] = np.repeat(speed, TRACK), np.repeat(lane, TRACK)
        cell["Space_Headway"] = np.full(frame.size, APART)
        yield pd.DataFrame(cell)


def write_text(path: Path, rows: int) -> None:
    """The official form."""
    with path.open("wb") as file:
        for table in vehicles(rows, CLOCK):
            append(file, table, csv.WriteOptions(include_header=False, delimiter=" "))


def write_portal(path: Path, rows: int, periods: int) -> None:
    """The data portal's form: every period in one file, numbers that restart, thousands separators."""
    with path.open("wb") as file:
        for period in range(periods):
            for place, table in enumerate(vehicles(rows, CLOCK + 10**6 * period)):
                table["Global_Time"] = table["Global_Time"].map("{:,.0f}".format)
                table["Location"] = "us-101"
                append(file, table, csv.WriteOptions(include_header=place == period == 0))


def append(file: BinaryIO, table: pd.DataFrame, options: csv.WriteOptions) -> None:
    """Rows of the file; pyarrow writes them ten times as fast as pandas."""
    csv.write_csv(pa.Table.from_pandas(table, preserve_index=False), file, options)


def measured(*arguments: str) -> tuple[float, float]:
    """Seconds of processor time and peak memory [GB] of a command, the greatest of all commands so far."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-m", "gri.commands.cli", *arguments], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, after.ru_maxrss / 1e6


def main() -> None:
    """Write the file, run both commands, print what they took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=1_200_000, help="of one period")
    parser.add_argument("--periods", type=int, default=1, help="more than one: the data portal's form")
    parser.add_argument("--only", choices=("inspect", "scenes"), help="only this command")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("portal.csv" if options.periods > 1 else "us-101.txt")
        began = time.perf_counter()
        if options.periods > 1:
            write_portal(path, options.rows, options.periods)
        else:
            write_text(path, options.rows)
        rows = options.rows // TRACK * TRACK * options.periods
        print(f"{path.name}: {rows} rows, {path.stat().st_size / 1e6:.0f} MB, in {time.perf_counter() - began:.0f} s")
        commands = {"inspect": [], "scenes": ["--out", f"{folder}/scenes.parquet"]}
        for name in (options.only,) if options.only else commands:
            seconds, memory = measured("ngsim", name, str(path), *commands[name])
            print(f"gri ngsim {name}: {seconds:.0f} CPU s, at most {memory:.2f} GB", flush=True)


if __name__ == "__main__":
    main()
