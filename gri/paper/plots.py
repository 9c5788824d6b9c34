"""How all figures of the project's tables are drawn and saved."""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
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
}


def save(figure: Figure, out: Path, name: str) -> None:
    """PNG and SVG of one figure."""
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / f"{name}.png")
    figure.savefig(out / f"{name}.svg", metadata={"Date": None})
    plt.close(figure)


def frequency_matrix(axis: Axes, matrix: np.ndarray, title: str) -> None:
    """Draw A[receiver, sender] with its values."""
    shown = np.ma.masked_array(matrix, np.eye(len(matrix), dtype=bool))
    axis.imshow(shown, vmin=0, vmax=1, cmap="Blues")
    for i, j in np.argwhere(~np.eye(len(matrix), dtype=bool)):
        value = matrix[i, j]
        axis.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color="white" if value > 0.6 else "black")
    axis.set_title(title, fontsize=7)
    axis.set_xticks(range(len(matrix)))
    axis.set_yticks(range(len(matrix)))
    axis.tick_params(labelsize=7, length=2)
    axis.set_xlabel("sender", fontsize=7)
    axis.set_ylabel("receiver", fontsize=7)
    axis.spines[:].set_visible(False)


def density(axis: Axes, points: np.ndarray, cells: int = 160) -> None:
    """Draw the square root of a Gaussian kernel density: a histogram of [S, 2] points, smoothed by a third of the width
    of Scott's rule on either axis.
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
