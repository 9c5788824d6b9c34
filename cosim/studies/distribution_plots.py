"""Plots of the distributions of simulated and recorded traffic, in total and per lane or driver."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.studies.realism import FINE_PER_COARSE_BIN, QUANTITIES, Quantity

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
RECORDED = "#444444"
SamplePairs = Mapping[str, tuple[pd.DataFrame, pd.DataFrame]]


def draw_distributions(
    curves: Mapping[str, pd.DataFrame], recorded: pd.DataFrame, pairs: SamplePairs, path: Path
) -> None:
    """Draw densities of all samples, and medians with the middle 50 % and 90 % of each pair; PNG or SVG by suffix.

    `curves` are sets of samples to draw with the recorded ones; `pairs` are simulated and recorded samples per lane or
    driver.
    """
    tables = [*curves.values(), recorded]
    shown = [q for q in QUANTITIES if all(q.name in table and len(_values(table, q)) for table in tables)]
    with matplotlib.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(3.4 * len(shown), 6.4), layout="constrained")
        axes = figure.subplots(2, len(shown), squeeze=False)
        for column, quantity in enumerate(shown):
            _draw_densities(axes[0, column], quantity, curves, recorded)
            _draw_intervals(axes[1, column], quantity, pairs)
        axes[0, 0].set_ylabel("probability density")
        axes[0, 0].legend(frameon=False)
        figure.savefig(path, dpi=130)


def _label(quantity: Quantity) -> str:
    return f"{quantity.label} [{quantity.unit}]"


def _values(samples: pd.DataFrame, quantity: Quantity) -> np.ndarray:
    values = samples[quantity.name].to_numpy(float)
    return values[(values >= quantity.low) & (values < quantity.high)]


def _draw_densities(axes: Axes, quantity: Quantity, curves: Mapping[str, pd.DataFrame], recorded: pd.DataFrame) -> None:
    bins = quantity.low + FINE_PER_COARSE_BIN * quantity.width * np.arange(
        len(quantity.centres) // FINE_PER_COARSE_BIN + 1
    )
    theirs = _values(recorded, quantity)
    axes.hist(theirs, bins.tolist(), density=True, color=RECORDED, alpha=0.25, label="recorded")
    ends = [np.quantile(theirs, (0.002, 0.998))]
    for colour, (label, samples) in zip(COLOURS, curves.items(), strict=False):
        values = _values(samples, quantity)
        axes.hist(values, bins.tolist(), density=True, histtype="step", lw=1.6, color=colour, label=label)
        ends.append(np.quantile(values, (0.002, 0.998)))
    axes.set_xlim(min(end[0] for end in ends), max(end[1] for end in ends))
    axes.set_xlabel(_label(quantity))


def _draw_intervals(axes: Axes, quantity: Quantity, pairs: SamplePairs) -> None:
    for place, (simulated, recorded) in enumerate(pairs.values()):
        for shift, colour, samples in ((-0.15, RECORDED, recorded), (0.15, COLOURS[0], simulated)):
            values = _values(samples, quantity)
            if not len(values):
                continue
            low, q1, median, q3, high = np.quantile(values, (0.05, 0.25, 0.5, 0.75, 0.95))
            axes.plot([low, high], [place + shift] * 2, color=colour, lw=1)
            axes.plot([q1, q3], [place + shift] * 2, color=colour, lw=4, solid_capstyle="butt")
            axes.plot(median, place + shift, "o", color="white", mec=colour, ms=5)
    axes.set_yticks(range(len(pairs)), list(pairs))
    axes.invert_yaxis()
    axes.set_xlabel(_label(quantity))
