"""The picture of a run with shares: speeds over space and time."""

from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cosim.measures.traffic_measures import CELL_LENGTH, CELL_TIME, cell_speeds

_STYLE = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
SHOWN_TRAJECTORIES = 60


def space_time_picture(
    cells: pd.DataFrame,
    path: Path,
    title: str,
    samples: pd.DataFrame | None = None,
    merge: tuple[float, float] | None = None,
) -> None:
    """Write the space-time diagram of a run, with the ways of some driven vehicles and the merge, if they are given."""
    with matplotlib.rc_context(_STYLE):  # type: ignore[arg-type]
        space_time_figure(cells, title, samples, merge).savefig(path, dpi=150)


def space_time_figure(
    cells: pd.DataFrame, title: str, samples: pd.DataFrame | None = None, merge: tuple[float, float] | None = None
) -> Figure:
    """Mean speed of all lanes together in cells of 10 s and 20 m; white where nobody was."""
    v = cell_speeds(cells)
    begin, minutes = float(v.index[0]), (len(v) * CELL_TIME) / 60
    length = float(v.columns[-1]) + CELL_LENGTH
    drawn = Figure(figsize=(9, 4), layout="constrained")
    axes = drawn.subplots()
    top = float(np.nanmax(v.to_numpy())) if v.notna().any().any() else 1.0
    image = axes.imshow(
        v.to_numpy().T, origin="lower", aspect="auto", extent=(0, minutes, 0, length), cmap="RdYlGn", vmin=0, vmax=top
    )
    drawn.colorbar(image, ax=axes, label="mean speed [m/s]")
    if samples is not None:
        driven = samples[samples["driver"] != "sumo"]
        names = driven["vehicle"].unique()
        for vehicle in names[:: max(len(names) // SHOWN_TRAJECTORIES, 1)]:
            way = driven[driven["vehicle"] == vehicle]
            axes.plot((way["time"] - begin) / 60, way["x"], color="black", lw=0.4)
    for place in merge or ():
        axes.axhline(place, color="black", lw=0.8, ls=":")
    axes.set_xlim(0, minutes)
    axes.set_xlabel("time after the warm-up [min]")
    axes.set_ylabel("position along the road [m]")
    axes.set_title(title, loc="left")
    return drawn
