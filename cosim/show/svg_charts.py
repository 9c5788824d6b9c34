"""Charts of a batch as SVG in the text colour of the page, readable on light and dark screens and on paper."""

import io
import re
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cosim.batch.group_statistics import BY_NAME, Measure, uninterrupted

INK = "#010203"  # placeholder, replaced by the text colour of the page
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b87a00", "#56b4e9", "#7f7f7f")
MARKERS = "osD^vPX"
STYLE: Any = {
    "font.size": 9, "svg.fonttype": "none", "font.family": "sans-serif", "axes.spines.top": False,
    "axes.spines.right": False, "text.color": INK, "axes.labelcolor": INK, "axes.edgecolor": INK, "xtick.color": INK,
    "ytick.color": INK, "axes.titlesize": 9, "legend.frameon": False, "svg.hashsalt": "cosim",
}  # fmt: skip


def line_styles(policies: Sequence[str]) -> dict[str, tuple[str, str]]:
    """A colour and a marker for each policy; the same in every chart."""
    return {name: (PALETTE[k % len(PALETTE)], MARKERS[k % len(MARKERS)]) for k, name in enumerate(policies)}


def curves(groups: pd.DataFrame, perturbation: str, unit: str, measures: Sequence[str]) -> str:
    """SVG of each measure over the intensity of one perturbation, one line per policy with 95 % intervals.

    `unit` is the unit of the intensity.
    """
    part = groups[groups["perturbation"] == perturbation]
    styles = line_styles(list(dict.fromkeys(groups["policy"])))
    spread = float(np.ptp(part["intensity"])) if len(part) else 0.0
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(3.2 * len(measures), 2.7), layout="constrained")
        for axes, name in zip(np.atleast_1d(figure.subplots(1, len(measures))), measures, strict=True):
            for k, (policy, rows) in enumerate(part.groupby("policy", sort=False)):
                _draw_curve(
                    axes, rows, BY_NAME[name], *styles[str(policy)], label=str(policy), shift=0.012 * spread * k
                )
            axes.set(
                xlabel=f"intensity of {perturbation}{f' [{unit}]' if unit else ''}",
                ylabel=title_with_unit(BY_NAME[name]),
            )
            if BY_NAME[name].share:
                axes.set_ylim(-4, 104)
        figure.axes[0].legend(fontsize=8)
        return svg(figure)


def _draw_curve(
    axes: Axes, rows: pd.DataFrame, measure: Measure, colour: str, marker: str, label: str, shift: float
) -> None:
    """Draw one line; `shift` moves it along x, so that markers of equal policies do not hide each other."""
    rows = rows if measure.every_start else uninterrupted(rows)
    points = [(intensity, measure.estimate(part)) for intensity, part in rows.groupby("intensity")]
    points = [(float(str(intensity)), estimate) for intensity, estimate in points if estimate.n]
    if not points:
        return
    factor = 100 if measure.unit == "share" else 1
    x = [intensity + shift for intensity, _ in points]
    middle, low, high = (factor * np.array([getattr(e, k) for _, e in points]) for k in ("value", "low", "high"))
    axes.errorbar(
        x, middle, [middle - low, high - middle], color=colour, marker=marker, ms=4, lw=1.5, capsize=2, label=label
    )


def distributions(groups: pd.DataFrame, measures: Sequence[str]) -> str:
    """SVG of cumulative distributions, one line per policy; over nominal runs if there are any."""
    nominal = groups[groups["perturbation"] == "nominal"]
    part = uninterrupted(nominal if len(nominal) else groups)
    styles = line_styles(list(dict.fromkeys(groups["policy"])))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(3.2 * len(measures), 2.7), layout="constrained")
        for axes, name in zip(np.atleast_1d(figure.subplots(1, len(measures))), measures, strict=True):
            measure = BY_NAME[name]
            for policy, rows in part.groupby("policy", sort=False):
                values = np.sort(measure.values(rows))
                if len(values):
                    share = 100 * np.arange(1, len(values) + 1) / len(values)
                    axes.step(values, share, where="post", color=styles[str(policy)][0], lw=1.6, label=str(policy))
            axes.set(xlabel=title_with_unit(measure), ylabel="share of groups [%]", ylim=(0, 102))
        figure.axes[0].legend(fontsize=8)
        return svg(figure)


def title_with_unit(measure: Measure) -> str:
    """Title and unit of a measure, e.g. "minimum gap [m]"."""
    return f"{measure.title} [{'%' if measure.unit == 'share' else measure.unit}]"


def svg(figure: Figure) -> str:
    """The figure as an SVG element without background, in the text colour of the page."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None})
    text = stream.getvalue().replace(INK, "currentColor")
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    return text[text.index("<svg") :]
