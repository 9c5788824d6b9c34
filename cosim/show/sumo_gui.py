"""Replay of an episode in sumo-gui: all recorded vehicles on the net of the run, moved through TraCI.

Vehicles around the group are grey. The same group left to SUMO drives as half-transparent ghosts; SUMO does not check
any of them for collisions.
"""

import os
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from cosim.runs.finished_run import read_scenario
from cosim.show.episode_view import EpisodeView
from cosim.spec.input_files import find_net
from cosim.world.road_frame import sumo_angle_of
from gri.errors import InputError

COLOURS = (
    *((0, 114, 178), (213, 94, 0), (60, 60, 60)),
    *((0, 158, 115), (204, 121, 167), (184, 122, 0), (86, 180, 233), (123, 94, 167)),
)
GREY, GHOST_ALPHA = (190, 190, 190), 90


@dataclass(frozen=True)
class Pose:
    """Vehicles of one kind of appearance at one instant: front bumpers, headings [rad], sizes [m], colours by name."""

    names: tuple[str, ...]
    xy: Float[np.ndarray, "V 2"]
    heading: Float[np.ndarray, " V"]
    size: Float[np.ndarray, "V 2"]
    colour: dict[str, tuple[int, ...]]


def poses_of(view: EpisodeView, ghost: EpisodeView | None, around: pd.DataFrame | None) -> list[Pose]:
    """Everything that is on the road at each instant of the view.

    `ghost` is the counterpart, `around` are the rows of the table of surroundings.
    """
    by_time = {} if around is None else {round(float(str(t)), 3): rows for t, rows in around.groupby("time")}
    found = []
    for instant in view.time:
        rows: dict[str, tuple[tuple[float, ...], tuple[int, ...]]] = {}
        now = by_time.get(round(float(instant), 3))
        if now is not None:
            columns = now[["x", "y", "heading", "length", "width"]].to_numpy().tolist()
            rows |= {str(name): (tuple(values), GREY) for name, values in zip(now["vehicle"], columns, strict=True)}
        for shown, prefix, alpha in ((view, "", 255), (ghost, "ghost of ", GHOST_ALPHA)):
            if shown is None or not (at := np.flatnonzero(np.abs(shown.time - instant) < 1e-6)).size:
                continue
            k = int(at[0])
            for role in np.flatnonzero(shown.present[k]):
                values = [float(shown.feature(name)[k, role]) for name in ("x", "y", "heading")]
                size = float(shown.length[role]), float(shown.width[role])
                rows[prefix + shown.ids[role]] = ((*values, *size), (*COLOURS[role], alpha))
        array = np.array([values for values, _ in rows.values()]).reshape(-1, 5)
        colours = {name: colour for name, (_, colour) in rows.items()}
        found.append(Pose(tuple(rows), array[:, :2], array[:, 2], array[:, 3:], colours))
    return found


def replay(view: EpisodeView, poses: Sequence[Pose], run: Path) -> None:
    """Open sumo-gui on the net and move the recorded vehicles (`poses_of`) in real time.

    Raises `InputError` without sumo-gui or without a display.
    """
    program = shutil.which("sumo-gui")
    if program is None:
        raise InputError(
            "sumo-gui is not installed; install gri-cosim[sumo], or play the episode in a browser:"
            f" `cosim render {run} --episode {view.number}`"
        )
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError(
            "no display is set, so sumo-gui cannot open a window; play the episode in a browser:"
            f" `cosim render {run} --episode {view.number}`"
        )
    _play(view, poses, command(view, run, program))


def command(view: EpisodeView, run: Path, program: str) -> list[str]:
    """The command line of sumo-gui, as a list of arguments."""
    scenario = read_scenario(run)
    options = {
        "net-file": str(find_net(scenario.net)),
        "step-length": f"{scenario.step:g}",
        "window-size": "1400,600",
    }
    flags = ["--start", "--quit-on-end", "--no-step-log", "--collision.action", "none"]
    return [program, *(part for name, value in options.items() for part in (f"--{name}", value)), *flags]


def _play(view: EpisodeView, poses: Sequence[Pose], command: list[str]) -> None:
    import traci  # comes with eclipse-sumo, as sumo-gui does

    traci.start(command)
    try:
        traci.simulationStep()
        edge = next(name for name in traci.edge.getIDList() if not name.startswith(":"))
        traci.route.add("replay", [edge])
        began, there = time.monotonic(), set()
        for k, pose in enumerate(poses):
            for vehicle in there - set(pose.names):
                traci.vehicle.remove(vehicle)
            for row, vehicle in enumerate(pose.names):
                if vehicle not in there:
                    traci.vehicle.add(vehicle, "replay")
                    traci.vehicle.setLength(vehicle, float(pose.size[row, 0]))
                    traci.vehicle.setWidth(vehicle, float(pose.size[row, 1]))
                    traci.vehicle.setColor(vehicle, pose.colour[vehicle])
                place = *pose.xy[row].tolist(), sumo_angle_of(float(pose.heading[row]))
                traci.vehicle.moveToXY(vehicle, "", -1, *place, keepRoute=2)
            there = set(pose.names)
            if k == 0:
                traci.gui.trackVehicle("View #0", view.ids[1])
                traci.gui.setZoom("View #0", 1500)
            time.sleep(
                max(began + view.time[k] - view.time[0] - time.monotonic(), 0.0)
            )  # sumo-gui's delay option has no effect under TraCI
            traci.simulationStep()
    finally:
        traci.close()
