"""Samples of traffic, about one per second and vehicle, from a recording, a run or a table.

A table of samples has one row per vehicle and time, in SI units: `source` (times and vehicles are unique within it
only), `time`, `vehicle`, `lane` (1 = leftmost, NaN unknown), `x` (front bumper along the road), `v`, `a`, `length` (NaN
unknown). `with_headways` adds headways and time gaps to the vehicle ahead.
"""

from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from cosim.runs.run_reading import read_tables
from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import clean
from gri.data.ngsim.smoothing import Motion, Smoothing, smoothed
from gri.data.recordings.reading import recordings_of
from gri.data.scene_file.schema import KEY
from gri.errors import InputError, guarded_reading

SAMPLE_PERIOD = 1.0  # [s] between two samples of a vehicle
MIN_SPEED = 1.0  # [m/s]; below it, time headways are not defined
COLUMNS = ("source", "time", "vehicle", "lane", "x", "v", "a", "length")
SMOOTHING = Smoothing()


def with_headways(samples: pd.DataFrame) -> pd.DataFrame:
    """The samples with `headway` [m], `time_headway` [s] and `time_gap` [s] to the next vehicle in the lane.

    Headways are from front bumper to front bumper, as in NGSIM; the time gap is from the front bumper to the rear
    bumper ahead. Both times are at the speed of the follower. NaN: no vehicle ahead, an unknown lane or length, or, for
    times, a follower slower than `MIN_SPEED`.
    """
    ordered = samples.sort_values(["source", "time", "lane", "x"], kind="stable")
    ahead = ordered.shift(-1)
    together = np.logical_and.reduce([ordered[name].eq(ahead[name]) for name in ("source", "time", "lane")])
    headway = (ahead["x"] - ordered["x"]).where(together)
    moving = ordered["v"].where(ordered["v"] >= MIN_SPEED)
    gap = headway - ahead["length"].where(ahead["length"] > 0)
    added = ordered.assign(headway=headway, time_headway=headway / moving, time_gap=gap / moving)
    return added.loc[samples.index]


def recorded_samples(path: Path) -> pd.DataFrame:
    """Samples of a recording of any layout (docs/recordings.md), a scene file, or a Parquet table with `COLUMNS`.

    Raises `InputError` if the file is none of these, or too short.
    """
    kind = _kind_of_parquet(path) if path.suffix == ".parquet" else "recording"
    if kind == "recording":
        parts = [_samples_of_motion(r.name, smoothed(clean(r)[0], SMOOTHING)) for r in recordings_of(path)]
        found = pd.concat(parts, ignore_index=True)
    else:
        found = _samples_of_scenes(path) if kind == "scenes" else _samples_of_table(path)
    if found.empty:
        raise InputError(
            f"{path}: no vehicle is recorded for {SMOOTHING.window * FRAME:g} s or longer; give a longer file"
        )
    return with_headways(found)


def run_samples(folder: Path) -> pd.DataFrame:
    """Samples of vehicles 0 and 1 of a run during the drive; `driver` is the policy that drove them.

    In car following they have `gap` [m], `relative_speed` [m/s] (above 0: the gap closes) and `ttc` [s] to the next
    vehicle of the group.
    """
    tables = read_tables(folder)
    steps = tables["steps"]
    ahead = steps.groupby(["driver", "episode", "time"], sort=False)["v"].shift(-1)  # roles are in order
    in_lane = bool((tables["groups"].get("rule", pd.Series(dtype=object)) == "car_following").all())
    closing = steps["v"] - (ahead if in_lane else np.nan)
    gap = steps["gap"].where(closing.notna() & (steps["gap"] > 0))
    steps = steps.assign(relative_speed=closing, ahead=gap, closes_in=(gap / closing).where(closing > 0))
    steps = steps[steps["during_drive"] & steps["present"] & steps["role"].isin([0, 1])]
    step = steps["time"].drop_duplicates().sort_values().diff().min()
    tick = (steps["time"] / step).round().astype(int)
    steps = steps[tick % round(SAMPLE_PERIOD / step) == 0]
    seconds = steps["gap"] / steps["v"].where(steps["v"] >= MIN_SPEED)
    return pd.DataFrame(
        {
            "source": steps["driver"],
            "driver": steps["driver"],
            "time": steps["time"],
            "vehicle": steps["vehicle"],
            "v": steps["v"],
            "a": steps["a"],
            "time_gap": seconds.where(seconds > 0),
            "gap": steps["ahead"],
            "relative_speed": steps["relative_speed"],
            "ttc": steps["closes_in"],
        }
    )


def _samples_of_motion(name: str, motion: Motion) -> pd.DataFrame:
    """The smoothed tracks of a recording, once per second."""
    sampled = motion.step % round(SAMPLE_PERIOD / SMOOTHING.dt) == 0
    table = pd.DataFrame(
        {
            "time": motion.step * SMOOTHING.dt,
            "vehicle": motion.vehicle,
            "lane": motion.lane.astype(float),
            "x": motion.x,
            "v": motion.vx,
            "a": motion.ax,
            "length": np.where(motion.length > 0, motion.length, np.nan),
        }
    )
    return table[sampled].assign(source=name)


def _samples_of_scenes(path: Path) -> pd.DataFrame:
    """A scene file; the lane is known in car following only, in which all vehicles are in one lane."""
    with guarded_reading(path, "Parquet file", "make it again"):
        table = pd.read_parquet(path)
    table = table[table["valid"] & ((table["time"] / SAMPLE_PERIOD) % 1 < 1e-6)]
    return pd.DataFrame(
        {
            "source": table["source"].astype(str) + "/" + table["scene"].astype(str),
            "time": table["time"],
            "vehicle": table["vehicle"],
            "lane": np.where(table["kind"] == "car_following", 1.0, np.nan),
            "x": table["x"],
            "v": table["v"].fillna(table["vx"]),
            "a": table["a"].fillna(table["ax"]),
            "length": table["length"].where(table["length"] > 0),
        }
    )


def _samples_of_table(path: Path) -> pd.DataFrame:
    with guarded_reading(path, "Parquet file", "make it again"):
        table = pd.read_parquet(path)
    if missing := [name for name in COLUMNS if name not in table]:
        raise InputError(f"{path}: column {missing[0]} is missing; wanted {', '.join(COLUMNS)}, or a scene file")
    return table[list(COLUMNS)]


def _kind_of_parquet(path: Path) -> Literal["scenes", "samples", "recording"]:
    """What a Parquet file holds. Raises `InputError` if it cannot be read."""
    with guarded_reading(path, "Parquet file", "make it again"):
        schema = pq.read_schema(path)
    if KEY in (schema.metadata or {}):
        return "scenes"
    return "samples" if {"source", "x", "v"} <= set(schema.names) else "recording"
