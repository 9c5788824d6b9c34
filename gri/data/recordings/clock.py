"""From times to frames of 0.1 s, the clock on which defects are looked for and tracks are smoothed.

A recording of 10 Hz keeps its rows. Of any other one, positions are interpolated: by straight lines where its steps are
shorter than 0.1 s, by cubic splines where they are longer (up to `COARSEST`).
"""

from itertools import pairwise

import numpy as np
import pandas as pd

from gri.data.ngsim.columns import FRAME
from gri.errors import InputError

COARSEST = 1.0
"""Longest step that positions are interpolated from [s]."""
LONGEST_GAP = 0.6
"""A longer gap in a track stays a gap, unless one step is longer [s]."""
ON_GRID = 0.006
"""A time that is nearer to a multiple of 0.1 s is on the grid [s]; times with two decimals are up to 0.005 s off."""
SMOOTH, STEADY = ("s_m", "d_m"), ("lane", "length_m", "width_m", "class", "vehicle")


def with_frames(table: pd.DataFrame, where: str, notes: list[str]) -> pd.DataFrame:
    """The rows of one recording at frames of 0.1 s, with the column `frame`, ordered by vehicle and frame.

    `table` has the column `vehicle` (a number). `notes` gains a line if positions were interpolated.

    Errors: `InputError` if the times are rounded so far that rows cannot be told apart, or too far apart.
    """
    table = table.sort_values(["vehicle", "time_s"], kind="stable")
    step = _step(table, where)
    ticks = table["time_s"].to_numpy() / FRAME
    on_grid = abs(step - FRAME) < 1e-4 and bool((np.abs(ticks - np.round(ticks)) < ON_GRID / FRAME).all())
    if on_grid:
        return table.assign(frame=np.round(ticks).astype(int))
    remark = f"positions were interpolated from steps of {step:.3g} s to 0.1 s"
    if not any(remark in note for note in notes):
        notes.append(f"{where}: {remark}")
    return _interpolated(table, step)


def _step(table: pd.DataFrame, where: str) -> float:
    """The time step [s]: the median over all pairs of successive rows of a vehicle."""
    same = np.diff(table["vehicle"].to_numpy()) == 0
    steps = np.diff(table["time_s"].to_numpy())[same]
    if not len(steps):
        raise InputError(f"{where}: got one row per vehicle, wanted tracks; check the columns of times and vehicles")
    repeated = (steps == 0) & (np.diff(table["s_m"].to_numpy())[same] != 0)
    if repeated.mean() > 0.05:
        raise InputError(
            f"{where}: {repeated.mean():.0%} of the rows have the same time as another position of the same vehicle, so"
            " the times look rounded; give times with more decimals, or map a frame number: --map time_s=FRAME*0.04"
        )
    moved = steps[steps > 0]
    if not len(moved):
        raise InputError(f"{where}: all rows of a vehicle have one time, wanted one row per vehicle and time")
    step = float(np.median(moved))
    mean = float(moved[moved < 1.5 * step].mean())  # of times with few decimals, single steps are rounded
    step = mean if abs(mean - step) < 0.2 * step else step
    if step > COARSEST + 1e-6:
        raise InputError(f"{where}: got steps of {step:g} s, wanted up to {COARSEST:g} s; record with shorter steps")
    return step


def _interpolated(table: pd.DataFrame, step: float) -> pd.DataFrame:
    time, vehicle = table["time_s"].to_numpy(), table["vehicle"].to_numpy()
    table = table[np.r_[True, (np.diff(time) > 0) | (np.diff(vehicle) != 0)]]
    time, vehicle = table["time_s"].to_numpy(), table["vehicle"].to_numpy()
    cut = (np.diff(vehicle) != 0) | (np.diff(time) > max(LONGEST_GAP, 1.5 * step))
    parts = []
    for start, end in pairwise(np.r_[0, np.flatnonzero(cut) + 1, len(table)]):
        frame = np.arange(np.ceil(time[start] / FRAME - 1e-4), np.floor(time[end - 1] / FRAME + 1e-4) + 1).astype(int)
        if end - start >= 2 and len(frame):
            parts.append(_track(table.iloc[start:end], frame, step))
    return pd.concat(parts, ignore_index=True) if parts else table.assign(frame=0).iloc[:0]


def _track(rows: pd.DataFrame, frame: np.ndarray, step: float) -> pd.DataFrame:
    from scipy.interpolate import CubicSpline  # takes long to import; most runs replay no recording

    time, at = rows["time_s"].to_numpy(), (frame * FRAME).clip(rows["time_s"].iloc[0], rows["time_s"].iloc[-1])
    before = np.searchsorted(time, at + 1e-6, "right").clip(1) - 1
    made = {name: rows[name].to_numpy()[before] for name in STEADY}
    for name in (*SMOOTH, "speed_mps", "acceleration_mps2"):
        values = rows[name].to_numpy()
        spline = name in SMOOTH and step > 1.2 * FRAME and len(rows) >= 4 and np.isfinite(values).all()
        made[name] = CubicSpline(time, values)(at) if spline else np.interp(at, time, values)
    return pd.DataFrame({**made, "frame": frame, "time_s": frame * FRAME})
