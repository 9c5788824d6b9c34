"""What all figures of this folder share: style, colours, frequency matrices, curves with bands, densities."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

matplotlib.use("Agg")
STYLE: dict[Any, Any] = {
    "figure.dpi": 150,
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "gri",
    "savefig.bbox": "tight",
}
CURVES: dict[str, dict[str, Any]] = {
    "oracle": {"color": "0.45", "ls": "--", "marker": ""},
    "GRI": {"color": "#0072B2", "ls": "-", "marker": "o"},
    "Supervised": {"color": "#D55E00", "ls": "-.", "marker": "s"},
    "NRI": {"color": "#009E73", "ls": ":", "marker": "^"},
    "IDM, calibrated": {"color": "0.45", "ls": (0, (6, 2, 1, 2)), "marker": "P"},
    "GRI (paper)": {"color": "#CC79A7", "ls": (0, (5, 1, 1, 1, 1, 1)), "marker": "D"},
    "GRI (paper, contrast)": {"color": "#CC79A7", "ls": (0, (5, 1, 1, 1, 1, 1)), "marker": "D"},
    "GRI (paper, literal)": {"color": "#882255", "ls": (0, (1, 1)), "marker": "X"},
    "NRI, type 0 speaks": {"color": "#44AA99", "ls": (0, (3, 3)), "marker": "v"},
    "GRI, tested range held out": {"color": "#56B4E9", "ls": (0, (7, 2)), "marker": "*"},
    "GRI-VAIRL": {"color": "#E69F00", "ls": (0, (4, 1, 1, 1)), "marker": "P"},
    "GRI-AIRL": {"color": "#999933", "ls": (0, (2, 2)), "marker": "<"},
    "GRI, recurrent decoder": {"color": "#332288", "ls": (0, (9, 1)), "marker": ">"},
    "GRI, flat prior": {"color": "#56B4E9", "ls": (0, (7, 2)), "marker": "*"},
    "NRI + prior": {"color": "#44AA99", "ls": (0, (3, 3)), "marker": "v"},
}
"""Colour, line style and marker of each row of the tables. The last two tell curves apart in grey print."""
MOST_CURVES = 5  # in a panel


def panels(rows: Sequence[str], everywhere: Sequence[str]) -> list[list[str]]:
    """The rows in parts of at most MOST_CURVES in the order of CURVES, with the rows of `everywhere` in each."""
    order = {name: k for k, name in enumerate(CURVES)}
    rows = sorted(rows, key=lambda row: order.get(row, len(order)))
    fixed, others = [row for row in rows if row in everywhere], [row for row in rows if row not in everywhere]
    room = MOST_CURVES - len(fixed)
    return [[*fixed, *others[k : k + room]] for k in range(0, max(len(others), 1), room)]


def styles(rows: Sequence[str]) -> dict[str, dict[str, Any]]:
    """How the curves of one panel are drawn; a row without a style of its own gets one that no other row has."""
    free = [style for name, style in CURVES.items() if name not in rows and style["marker"]]
    taken = {CURVES[row]["marker"] for row in rows if row in CURVES}
    free = [style for style in free if style["marker"] not in taken]
    return {row: CURVES[row] if row in CURVES else free.pop() for row in rows}


def line(style: Mapping[str, Any], points: int) -> dict[str, Any]:
    """A style for `Axes.plot`; about eight of the points have a marker."""
    return {**style, "ms": 4, "lw": 1.4, "markevery": max(1, points // 8)}


def save(figure: Figure, out: Path, name: str) -> list[Path]:
    """Write a figure as PNG and SVG. Returns both files."""
    out.mkdir(parents=True, exist_ok=True)
    files = [out / f"{name}.png", out / f"{name}.svg"]
    figure.savefig(files[0])
    figure.savefig(files[1], metadata={"Date": None})
    plt.close(figure)
    return files


def frequency_matrices(columns: Mapping[str, np.ndarray], types: Sequence[str], title: str) -> Figure:
    """A column of matrices A[type, receiver, sender] for each name, with their values."""
    size = (1.55 * len(columns) + 0.3, 1.95 * len(types) + 0.4)
    figure, axes = plt.subplots(len(types), len(columns), figsize=size, squeeze=False)
    for column, (name, matrices) in zip(axes.T, columns.items(), strict=True):
        for axis, kind, matrix in zip(column, types, matrices, strict=True):
            _frequency_matrix(axis, matrix)
            axis.set_title(f"{name}\n{kind}", fontsize=7)
    figure.suptitle(title, fontsize=9)
    figure.tight_layout(h_pad=1.5)
    return figure


def _frequency_matrix(axis: Axes, matrix: np.ndarray) -> None:
    diagonal = np.eye(len(matrix), dtype=bool)
    axis.imshow(np.ma.masked_array(matrix, diagonal), vmin=0, vmax=1, cmap="Blues")
    for i, j in np.argwhere(~diagonal):
        colour = "white" if matrix[i, j] > 0.6 else "black"
        axis.text(j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", fontsize=7, color=colour)
    axis.set_xticks(range(len(matrix)))
    axis.set_yticks(range(len(matrix)))
    axis.tick_params(labelsize=7, length=2)
    axis.set_xlabel("sender", fontsize=7)
    axis.set_ylabel("receiver", fontsize=7)
    axis.spines[:].set_visible(False)


def curve(
    axis: Axes, name: str, style: Mapping[str, Any], x: ArrayLike, mean: ArrayLike, half_width: ArrayLike
) -> None:
    """Draw the mean of a row with its 95 % band."""
    mean, half_width = np.asarray(mean), np.asarray(half_width)
    axis.plot(x, mean, label=name, zorder={"oracle": 4, "GRI": 3}.get(name, 2), **line(style, len(mean)))
    low, high = mean - half_width, mean + half_width
    axis.fill_between(x, low, high, color=style["color"], alpha=0.15, lw=0)  # type: ignore[arg-type]


def legend_below(figure: Figure, axis: Axes, columns: int, height: float) -> None:
    """One legend for all axes, below them, in a strip of that height [inches]."""
    handles, names = axis.get_legend_handles_labels()
    figure.legend(handles, names, loc="lower center", ncol=columns, fontsize=7, frameon=False)
    figure.tight_layout(rect=(0, height / figure.get_figheight(), 1, 1))


def density(axis: Axes, points: np.ndarray, cells: int = 160) -> None:
    """Draw the square root of a Gaussian kernel density of [S, 2] points.

    The density is a smoothed histogram. On each axis the kernel has a third of the width of Scott's rule.
    """
    low, high = points.min(0), points.max(0)
    margin = 0.08 * (high - low) + 1e-3
    edges = [np.linspace(a, b, cells + 1) for a, b in zip(low - margin, high + margin, strict=True)]
    counts, *_ = np.histogram2d(points[:, 0], points[:, 1], bins=edges)
    cell = np.array([edge[1] - edge[0] for edge in edges])
    width = points.std(0) * len(points) ** (-1 / 6) * 0.35
    counts = gaussian_filter(counts, np.maximum(width / cell, 1.0), mode="constant")
    extent = (edges[0][0], edges[0][-1], edges[1][0], edges[1][-1])
    shown = np.sqrt(counts.T / counts.max())
    axis.imshow(shown, origin="lower", extent=extent, aspect="auto", cmap="Reds", vmin=0, vmax=1)
    axis.set_facecolor(matplotlib.colormaps["Reds"](0.0))
