"""Diagrams of how far a row's probabilities can be trusted: one small panel per row, legible without colour."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from io import StringIO
from textwrap import fill
from typing import Any

import numpy as np
from jaxtyping import Float

from gri.bench.scores import COVERAGES

COLUMNS = 5
LEAST_PAIRS = 20  # of a point of the reliability diagram
STYLE: dict[Any, Any] = {
    "svg.hashsalt": "gri",
    "svg.fonttype": "none",
    "font.size": 7,
    "axes.titlesize": 7,
    "font.family": "sans-serif",
}


@dataclass(frozen=True)
class Curves:
    """Sums over bins of P(follow), and the risk at each of `COVERAGES`."""

    pairs: Float[np.ndarray, " bins"]
    p: Float[np.ndarray, " bins"]
    true: Float[np.ndarray, " bins"]
    risk: Float[np.ndarray, " coverages"]


def draw_reliability(rows: Mapping[str, Curves]) -> str:
    """An SVG: share of true edges against P(follow); on the dashed line probabilities mean what they say."""

    def panel(axes, curves: Curves) -> None:
        shown = curves.pairs >= LEAST_PAIRS
        axes.plot([0, 1], [0, 1], color="0.5", linestyle="--", linewidth=0.8)
        mean, share = curves.p[shown] / curves.pairs[shown], curves.true[shown] / curves.pairs[shown]
        axes.plot(mean, share, color="black", marker="o", markersize=3, linewidth=1)
        axes.set(xlim=(-0.05, 1.05), ylim=(-0.05, 1.05))

    return _panels(rows, panel, "P(follow)", "share of true edges")


def draw_abstention(rows: Mapping[str, Curves]) -> str:
    """An SVG: share of wrong answers against coverage, dashed that of the last row (the ceiling)."""
    *_, ceiling = rows.values()

    def panel(axes, curves: Curves) -> None:
        axes.plot(COVERAGES, ceiling.risk, color="0.5", linestyle="--", linewidth=0.8)
        axes.plot(COVERAGES, curves.risk, color="black", marker="o", markersize=2.5, linewidth=1)
        axes.set(xlim=(0, 1.05), ylim=(0, 0.65))

    return _panels(rows, panel, "coverage", "share of wrong answers")


def _panels(rows: Mapping[str, Curves], panel: Callable[..., None], x: str, y: str) -> str:
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    lines = -(-len(rows) // COLUMNS)
    with matplotlib.rc_context(STYLE):
        figure = Figure((1.5 * COLUMNS, 1.55 * lines + 0.4), layout="constrained")
        FigureCanvasSVG(figure)
        grid = figure.subplots(lines, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axes in grid.flat[len(rows) :]:
            axes.set_axis_off()
        for axes, (name, curves) in zip(grid.flat, rows.items(), strict=False):
            panel(axes, curves)
            axes.set_title(fill(name, 26))
        figure.supxlabel(x)
        figure.supylabel(y)
        text = StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()
