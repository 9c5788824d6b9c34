"""All vehicles of one episode over time, in SUMO's plane, from the tables of a run."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from cosim.runs.finished_run import read_scenario
from cosim.runs.run_reading import read_tables
from cosim.runs.surroundings_table import read_surroundings
from gri.errors import InputError

COLUMNS = ("time", "vehicle", "x", "y", "heading", "v", "a", "length", "width")


@dataclass(frozen=True)
class MovingVehicles:
    """The vehicles of an episode; `step` is the time between two instants [s].

    `rows` has `COLUMNS`: one row per vehicle and instant, ordered by both. x, y [m] is the middle of the front bumper,
    heading [rad] is counter-clockwise from +x, v in m/s, a in m/s², sizes in m. `net` names the net of the run.
    """

    name: str
    step: float
    rows: pd.DataFrame
    net: str

    def tracks(self) -> Iterator[tuple[str, pd.DataFrame]]:
        """The rows of each vehicle without gaps; a vehicle that comes back has several tracks, `name`, `name.1`, …"""
        for name, rows in self.rows.groupby("vehicle", sort=True, observed=True):
            cut = (np.diff(rows["time"].to_numpy()) > 1.5 * self.step).cumsum()
            for k, part in rows.groupby(np.r_[0, cut]):
                yield (f"{name}.{k}" if k else str(name)), part

    @property
    def begin(self) -> float:
        """Time of the first instant [s]."""
        return float(self.rows["time"].min())


def vehicles_of(folder: Path, episode: int, counterpart: bool = False) -> MovingVehicles:
    """The vehicles of an episode or of its counterpart: all around the group, or the group where the run has no others.

    Raises `InputError` for a number that the run does not have, or a folder that is no run.
    """
    tables = read_tables(folder)
    groups = tables["counterparts" if counterpart else "groups"]
    found = groups[groups["episode"] == episode]
    if not len(found):
        known = f"the episodes {groups['episode'].min()} to {groups['episode'].max()}" if len(groups) else "none"
        raise InputError(f"--episode: got {episode}, {folder} has {known}")
    scenario = read_scenario(folder)
    rows = read_surroundings(folder, episode, counterpart)
    if rows is None or not len(rows):
        rows = _group(tables["steps"], found.iloc[0], episode, counterpart)
    rows = (
        rows[list(COLUMNS)].astype({"vehicle": str}).sort_values(["time", "vehicle"], kind="stable", ignore_index=True)
    )
    return MovingVehicles(f"episode-{episode}", scenario.step, rows, scenario.net)


def _group(steps: pd.DataFrame, group: pd.Series, episode: int, counterpart: bool) -> pd.DataFrame:
    chosen = (steps["episode"] == episode) & (steps["counterpart"] == counterpart) & steps["present"]
    rows = steps[chosen]
    sizes = {name: [float(group[f"{name}_{role}"]) for role in rows["role"]] for name in ("length", "width")}
    names = [str(group[f"vehicle_{role}"]) for role in rows["role"]]
    return rows.assign(vehicle=names, **sizes)
