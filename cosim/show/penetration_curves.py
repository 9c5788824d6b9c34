"""Curves of a batch whose runs have shares of the traffic: each figure over the share of driven vehicles."""

from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cosim.batch.traffic_results import NOBODY, estimate
from cosim.runs.share_summary import BY_NAME
from cosim.runs.summary import driver_name

CURVES = (
    "flow",
    "mean_speed",
    "travel_time",
    "speed_sd_time",
    "speed_sd_space",
    "slow_cells",
    "tet",
    "brakings_3",
    "lane_changes",
    "fuel",
    "co2",
    "nox",
)
_COLUMNS = 3
_STYLE: dict[Any, Any] = {"font.size": 8, "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "gri"}


def penetration_picture(rows: pd.DataFrame, path: Path) -> None:
    """Write `penetration_figure`; the suffix (.svg, .png, .pdf) says in which format."""
    with matplotlib.rc_context(_STYLE):
        metadata = {"Date": None} if path.suffix == ".svg" else {}
        penetration_figure(rows).savefig(path, dpi=150, metadata=metadata)


def penetration_figure(rows: pd.DataFrame) -> Figure:
    """One small picture per figure of the traffic, a line per policy; bars are 95 % intervals over seeds.

    Runs in which nobody is driven are the beginning of every line.
    """
    lines = -(-len(CURVES) // _COLUMNS)
    drawn = Figure(figsize=(9, 2.1 * lines), layout="constrained")
    policies = [name for name in rows["policy"].unique() if name != NOBODY] or [NOBODY]
    for name, axes in zip(CURVES, drawn.subplots(lines, _COLUMNS, sharex=True).flat, strict=True):
        figure = BY_NAME[name]
        for policy, marker in zip(policies, cycle("os^Dvxp*"), strict=False):
            parts = rows[rows["policy"].isin([policy, NOBODY])].groupby("share")
            share = np.array([100 * float(str(value)) for value, _ in parts])
            found = [estimate(part, name) for _, part in parts]
            value = figure.factor * np.array([e.value for e in found])
            bars = np.nan_to_num([[e.value - e.low for e in found], [e.high - e.value for e in found]])
            axes.errorbar(
                share, value, figure.factor * bars, label=driver_name(policy), ms=3, lw=1, capsize=2, marker=marker
            )
        axes.set_title(figure.heading, loc="left")
    for axes in drawn.axes[-_COLUMNS:]:
        axes.set_xlabel("share of driven vehicles [%]")
    drawn.legend(
        *drawn.axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=len(policies), frameon=False
    )
    return drawn
