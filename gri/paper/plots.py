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
COLOURS = {
    "oracle": "0.45",
    "GRI": "#0072B2",
    "Supervised": "#D55E00",
    "NRI": "#009E73",
    "NRI, type 0 speaks": "#66C2A5",
    "GRI (paper, contrast)": "#CC79A7",
    "GRI (paper, literal)": "#882255",
    "GRI, tested range held out": "#56B4E9",
    "GRI-VAIRL": "#E69F00",
    "GRI-AIRL": "#999933",
    "GRI (paper)": "#CC79A7",
    "IDM, calibrated": "0.45",
}


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


def curve(axis: Axes, name: str, x: ArrayLike, mean: ArrayLike, half_width: ArrayLike) -> None:
    """Draw the mean of a row with its 95 % band."""
    mean, half_width = np.asarray(mean), np.asarray(half_width)
    colour, above = COLOURS.get(name, "black"), {"oracle": 4, "GRI": 3}.get(name, 2)
    axis.plot(x, mean, label=name, color=colour, lw=1.4, ls="--" if name == "oracle" else "-", zorder=above)
    axis.fill_between(x, mean - half_width, mean + half_width, color=colour, alpha=0.15, lw=0)  # type: ignore[arg-type]


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
