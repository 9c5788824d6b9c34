"""Replay of an episode in sumo-gui: the three recorded vehicles on the net of the run, moved through TraCI."""

import os
import shutil
import sys
import time
from pathlib import Path

import numpy as np

from cosim.runs.run_tables import read_json
from cosim.show.episode_view import EpisodeView
from cosim.spec.input_files import find_net
from cosim.spec.scenario import Scenario
from cosim.world.road_frame import sumo_angle_of
from gri.errors import InputError

COLOURS = ((0, 114, 178), (213, 94, 0), (120, 120, 120))


def replay(view: EpisodeView, run: Path) -> None:
    """Open sumo-gui on the net and move the recorded vehicles in real time.

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
    _play(view, command(view, run, program))


def command(view: EpisodeView, run: Path, program: str) -> list[str]:
    """The command line of sumo-gui, as a list of arguments."""
    scenario = read_json(run / "scenario.json", Scenario)
    options = {
        "net-file": str(find_net(scenario.net)),
        "step-length": f"{scenario.step:g}",
        "window-size": "1400,600",
    }
    flags = ["--start", "--quit-on-end", "--no-step-log", "--collision.action", "none"]
    return [program, *(part for name, value in options.items() for part in (f"--{name}", value)), *flags]


def _play(view: EpisodeView, command: list[str]) -> None:
    import traci  # comes with eclipse-sumo, as sumo-gui does

    traci.start(command)
    try:
        traci.simulationStep()
        edge = next(name for name in traci.edge.getIDList() if not name.startswith(":"))
        traci.route.add("replay", [edge])
        for role, vehicle in enumerate(view.ids):
            traci.vehicle.add(vehicle, "replay")
            traci.vehicle.setLength(vehicle, float(view.length[role]))
            traci.vehicle.setWidth(vehicle, float(view.width[role]))
            traci.vehicle.setColor(vehicle, COLOURS[role])
        x, y, heading = (view.feature(name) for name in ("x", "y", "heading"))
        began = time.monotonic()
        for k in range(len(view.time)):
            for role in np.flatnonzero(view.present[k]):
                pose = float(x[k, role]), float(y[k, role]), sumo_angle_of(float(heading[k, role]))
                traci.vehicle.moveToXY(view.ids[role], "", -1, *pose, keepRoute=2)
            if k == 0:
                traci.gui.trackVehicle("View #0", view.ids[1])
                traci.gui.setZoom("View #0", 1500)
            time.sleep(
                max(began + view.time[k] - view.time[0] - time.monotonic(), 0.0)
            )  # sumo-gui's delay option has no effect under TraCI
            traci.simulationStep()
    finally:
        traci.close()
