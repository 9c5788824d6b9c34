"""Measures of the traffic in a study area, from samples of all its vehicles once a second. Pure functions, SI units.

A sample stands for a second of its vehicle, in which it drives v metres. Flow, density and speed are Edie's (1963):
flow = Σ distance / (length · time), density = Σ vehicle seconds / (length · time), speed = Σ distance / Σ vehicle
seconds. Time exposed (TET) and time integrated time to collision (TIT) are those of Minderhoud and Bovy (2001).
Fuel and emissions are SUMO's (HBEFA).

Columns of `samples` are in docs/reference/run-tables.md, as are names and units of the figures.
"""

from collections.abc import Mapping

import numpy as np
import pandas as pd

HARD_BRAKING = (3.0, 4.5)  # [m/s²]
LONG_STANDING = 60.0  # [s]
STANDING = 1.0  # [m/s], below which a vehicle stands
SLOW = 5.0  # [m/s], below which a cell of space and time is slow
SHORT_TTC = 1.5  # [s]; a shorter time to collision is a conflict (van der Horst and Hogema 1993)
CELL_TIME, CELL_LENGTH = 10.0, 20.0  # [s], [m] of a cell of space and time
WHOLE_WAY = 40.0  # [m] at both ends that a vehicle may miss of the study area and still count as having crossed it
CONGESTED = 15.0  # [m/s], mean speed below which the road at a merge is congested
LEAST_MINUTES = 5  # of free and of congested traffic, without which no capacity drop is given
WAVE_SPEEDS = np.arange(2.0, 10.01, 0.25)  # [m/s] upstream
LEAST_WAVE = 0.3  # share of the variance that lines along a wave must explain
_G, _KM, _HOUR = 1e-3, 1e-3, 3600.0


def vehicles_table(samples: pd.DataFrame, brakings: pd.DataFrame, length: float) -> pd.DataFrame:
    """One row per vehicle that was in the study area: its way, its time, and what happened on it.

    `travel_time` is for the whole study area, NaN for vehicles that did not cross it.
    """
    by = samples.groupby("vehicle", sort=False)
    found = by.agg(
        driver=("driver", "first"),
        entered=("time", "first"),
        left=("time", "last"),
        x_first=("x", "first"),
        x_last=("x", "last"),
        distance=("v", "sum"),
        seconds=("v", "size"),
        min_ttc=("ttc", "min"),
        **{name: (name, "sum") for name in ("fuel", "co2", "nox", "pmx")},
    ).reset_index()
    rows = samples[["vehicle", "lane", "v", "ttc"]]
    same = rows["vehicle"].eq(rows["vehicle"].shift())  # samples of a vehicle follow each other
    stands = rows["v"] < STANDING
    flags = pd.DataFrame(
        {
            "vehicle": rows["vehicle"],
            "lane_changes": same & rows["lane"].ne(rows["lane"].shift()),
            "stops": stands & ~(same & stands.shift(fill_value=False)),
            "standing": stands,
            "tet": rows["ttc"] < SHORT_TTC,
            "tit": (SHORT_TTC - rows["ttc"]).clip(lower=0),
        }
    )
    found = found.merge(flags.groupby("vehicle", sort=False).sum().reset_index(), on="vehicle")
    found = found.merge(brakings, on="vehicle", how="left")
    for threshold in HARD_BRAKING:
        found[f"brakings_{threshold:g}"] = found[f"brakings_{threshold:g}"].fillna(0).astype(int)
    crossed = (found["x_first"] < WHOLE_WAY) & (found["x_last"] > length - WHOLE_WAY)
    way = (found["x_last"] - found["x_first"]).where(crossed)
    found["travel_time"] = (found["left"] - found["entered"]) * length / way
    return found


def ordered(samples: pd.DataFrame) -> pd.DataFrame:
    """The samples vehicle by vehicle, each in the order of time."""
    return samples.sort_values(["vehicle", "time"], kind="stable", ignore_index=True)


def figures(
    samples: pd.DataFrame, vehicles: pd.DataFrame, length: float, duration: float, pair_events: Mapping[str, int]
) -> dict[str, float]:
    """The figures of some vehicles: their samples, their rows of the vehicles table, and counts of events."""
    seconds, metres = float(len(samples)), float(samples["v"].sum())
    kilometres = max(metres * _KM, 1e-9)
    crossing = vehicles["travel_time"].dropna()
    return {
        "vehicles": float(len(vehicles)),
        "flow": _HOUR * metres / (length * duration),
        "density": seconds / (length * _KM * duration),
        "mean_speed": metres / seconds if seconds else np.nan,
        "speed_sd": float(samples["v"].std()),
        "travel_time": float(crossing.mean()),
        "travel_time_sd": float(crossing.std()),
        "standing": float(vehicles["standing"].sum()) / seconds if seconds else np.nan,
        "stops": float(vehicles["stops"].sum()) / kilometres,
        "tet": _HOUR * float(vehicles["tet"].sum()) / seconds if seconds else np.nan,
        "tit": _HOUR * float(vehicles["tit"].sum()) / seconds if seconds else np.nan,
        **{f"brakings_{k:g}": float(vehicles[f"brakings_{k:g}"].sum()) / kilometres for k in HARD_BRAKING},
        "lane_changes": float(vehicles["lane_changes"].sum()) / kilometres,
        "fuel": float(vehicles["fuel"].sum()) * _G / kilometres,
        "co2": float(vehicles["co2"].sum()) * _G / kilometres,
        "nox": float(vehicles["nox"].sum()) / kilometres,
        "pmx": float(vehicles["pmx"].sum()) / kilometres,
        **{name: float(count) for name, count in pair_events.items()},
    }


def space_time(samples: pd.DataFrame, length: float, begin: float, end: float) -> pd.DataFrame:
    """Vehicle seconds, metres driven and seconds of standing in each cell of space and time, also the empty ones.

    `time` [s] and `x` [m] are where a cell begins; the last cell may be longer than the others.
    """
    times, places = max(int((end - begin) / CELL_TIME), 1), max(int(length / CELL_LENGTH), 1)
    row = ((samples["time"].to_numpy() - begin - 1e-6) / CELL_TIME).astype(int).clip(0, times - 1)
    column = (samples["x"].to_numpy() / CELL_LENGTH).astype(int).clip(0, places - 1)
    v = samples["v"].to_numpy()
    sums = [
        np.bincount(row * places + column, weights, times * places)
        for weights in (np.ones(len(v)), v, (v < STANDING).astype(float))
    ]
    cell = np.arange(times * places)
    where = {"time": begin + cell // places * CELL_TIME, "x": cell % places * CELL_LENGTH}
    return pd.DataFrame({**where, **dict(zip(("seconds", "distance", "standing"), sums, strict=True))})


def cell_speeds(cells: pd.DataFrame) -> pd.DataFrame:
    """Mean speed [m/s] by time (rows) and place (columns); NaN where nobody was."""
    return cells.assign(v=cells["distance"] / cells["seconds"].where(cells["seconds"] > 0)).pivot(
        index="time", columns="x", values="v"
    )


def pattern_figures(cells: pd.DataFrame) -> dict[str, float]:
    """What the speeds over space and time show: their spread, slow cells, and how fast waves move.

    `speed_sd_time` is the standard deviation over time at one place, `speed_sd_space` that over the road at one time
    (root of the mean variance). `wave_speed` [m/s] is the speed at which slow traffic moves upstream (negative).
    """
    v = cell_speeds(cells)
    known = v.notna().to_numpy()
    return {
        "speed_sd_time": float(np.sqrt(v.var(axis=0).mean())),
        "speed_sd_space": float(np.sqrt(v.var(axis=1).mean())),
        "slow_cells": float((v.to_numpy()[known] < SLOW).mean()) if known.any() else np.nan,
        "wave_speed": wave_speed(v),
    }


def wave_speed(v: pd.DataFrame) -> float:
    """The speed [m/s] of waves in speeds by time and place, negative upstream; NaN without clear waves.

    Along lines that move with a wave, speeds are alike. So the mean speeds of such lines differ most where the lines
    have the wave's speed. It is given if these means explain at least LEAST_WAVE of the variance, and if they explain
    more than at both ends of WAVE_SPEEDS.
    """
    deviation = (v - v.mean(axis=0)).to_numpy()  # from the mean at each place, so that bottlenecks are no waves
    rows, columns = np.nonzero(np.isfinite(deviation))
    values = deviation[rows, columns]
    total = float((values**2).sum())
    if total <= 1e-9:
        return np.nan
    explained = []
    for speed in WAVE_SPEEDS:
        line = np.round(rows + columns * CELL_LENGTH / speed / CELL_TIME).astype(int)  # the same for one wave
        sums, counts = np.bincount(line, values), np.bincount(line)
        explained.append(float((sums[counts > 0] ** 2 / counts[counts > 0]).sum()) / total)
    best = int(np.argmax(explained))
    if explained[best] < LEAST_WAVE or best in (0, len(WAVE_SPEEDS) - 1):
        return np.nan
    return -float(WAVE_SPEEDS[best])


def merge_figures(samples: pd.DataFrame, merge: tuple[float, float] | None, begin: float, end: float, length: float):
    """Flow behind a merge, and by how much it drops when traffic jams there.

    `merge` are the s [m] between which vehicles merge. The flow [veh/h] is that in the 100 m behind it. A minute is
    congested where the mean speed in the 100 m before the merge is below CONGESTED. `capacity_drop` is 1 − (mean flow
    in congested minutes)/(largest flow in a free minute); NaN with fewer than LEAST_MINUTES of both.
    """
    if merge is None or merge[1] + 20 > length:
        return {"merge_flow": np.nan, "capacity_drop": np.nan}
    behind = samples["x"].between(merge[1], min(merge[1] + 100, length), inclusive="left")
    before = samples["x"].between(max(merge[0] - 100, 0), max(merge[0], 20), inclusive="left")
    stretch = min(merge[1] + 100, length) - merge[1]
    minutes = max(int((end - begin) / 60), 1)
    minute = ((samples["time"] - begin - 1e-6) / 60).astype(int)
    driven = samples["v"].where(behind, 0).groupby(minute).sum().reindex(range(minutes), fill_value=0)
    flow = _HOUR * driven / (stretch * 60)
    speed = samples["v"].where(before).groupby(minute).mean().reindex(range(minutes))
    free, congested = flow[speed >= CONGESTED], flow[speed < CONGESTED]
    enough = min(len(free), len(congested)) >= LEAST_MINUTES
    drop = 1 - float(congested.mean()) / float(free.max()) if enough else np.nan
    return {"merge_flow": float(flow.mean()), "capacity_drop": drop}
