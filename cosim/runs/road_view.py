"""What is on the road in one episode, as arrays: the group, its counterpart, the vehicles around, and the lanes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from cosim.runs.finished_run import SCENARIO, has_file, read_scenario
from cosim.runs.lanes import DrawnRoad, Lane, drawn_road
from cosim.runs.surroundings_table import read_surroundings
from cosim.world.outcome_columns import group_size
from cosim.world.road_frame import RoadFrame

Times = Float[np.ndarray, " T"]


@dataclass(frozen=True)
class Moving:
    """One vehicle from above: front bumper (s, d) [m], angle to the road [rad]; NaN where it is not there."""

    name: str
    length: float
    width: float
    s: Times
    d: Times
    angle: Times


@dataclass(frozen=True)
class RoadView:
    """One episode from above. `members` and `ghosts` (the counterpart; empty if there is none) are by role.

    `neighbours` are the other vehicles; there are none where the run was done without surroundings.
    """

    time: Times
    takeover_time: float
    members: tuple[Moving, ...]
    ghosts: tuple[Moving, ...]
    neighbours: tuple[Moving, ...]
    lanes: tuple[Lane, ...]


def road_view(tables: Mapping[str, pd.DataFrame], number: int, folder: Path | None = None) -> RoadView:
    """Episode `number` of a run from above; without the run's folder, the road is empty and straight."""
    (group,) = tables["groups"][tables["groups"]["episode"] == number].to_dict("records")
    steps = tables["steps"][tables["steps"]["episode"] == number]
    own, left = steps[~steps["counterpart"]], steps[steps["counterpart"]]
    time = np.unique(own["time"])
    road = DrawnRoad(None, ())
    if folder is not None and has_file(folder, SCENARIO):
        road = drawn_road(read_scenario(folder))
    around = None if folder is None else read_surroundings(folder, number, counterpart=False)
    return RoadView(
        time=time,
        takeover_time=float(group["takeover_time"]),
        members=_by_role(own, time, group, road.frame),
        ghosts=_by_role(left, time, group, road.frame) if len(left) else (),
        neighbours=() if around is None else _neighbours(around, own, time, road.frame),
        lanes=road.lanes,
    )


def _by_role(steps: pd.DataFrame, time: Times, group: Mapping, frame: RoadFrame | None) -> tuple[Moving, ...]:
    found = []
    for role in range(group_size(group)):
        rows = steps[(steps["role"] == role) & steps["present"]]
        size = float(group[f"length_{role}"]), float(group[f"width_{role}"])
        found.append(_moving(str(group[f"vehicle_{role}"]), rows, time, size, frame))
    return tuple(found)


def _neighbours(around: pd.DataFrame, own: pd.DataFrame, time: Times, frame: RoadFrame | None) -> tuple[Moving, ...]:
    """The vehicles around a group that are not drawn as members of it."""
    members = set(zip(own["time"], own["x"], own["y"], strict=True))
    same = [place in members for place in zip(around["time"], around["x"], around["y"], strict=True)]
    others = around[~np.array(same, dtype=bool)]
    return tuple(
        _moving(str(name), rows, time, (float(rows["length"].iloc[0]), float(rows["width"].iloc[0])), frame)
        for name, rows in others.groupby("vehicle", observed=True)
    )


def _moving(name: str, rows: pd.DataFrame, time: Times, size: tuple[float, float], frame: RoadFrame | None) -> Moving:
    at = np.searchsorted(time, rows["time"].to_numpy() - 1e-6)
    inside = at < len(time)
    at, rows = at[inside], rows[inside]
    s, d, angle = np.full((3, len(time)), np.nan)
    s[at], d[at] = rows["s"], rows["d"]
    if frame is not None:
        turn = frame.side * (rows["heading"].to_numpy() - frame.heading_at(rows["s"].to_numpy(dtype=float)))
        angle[at] = (turn + np.pi) % (2 * np.pi) - np.pi
    elif len(at):
        angle[at] = _angle_of_path(s[at], d[at])
    return Moving(name, *size, s, d, angle)


def _angle_of_path(s: Times, d: Times) -> Times:
    """Angle to the road [rad] of the direction of travel; 0 at standstill."""
    if len(s) < 2:
        return np.zeros(len(s))
    ds, dd = np.gradient(s), np.gradient(d)
    return np.where(np.hypot(ds, dd) > 0.05, np.arctan2(dd, np.maximum(ds, 1e-9)), 0.0)
