"""Numbers of lanes, 1 for the leftmost, from the lanes' names in the source or from lateral positions."""

import itertools
from collections.abc import Sequence

import numpy as np
import pandas as pd

SAME_LANE = 1.5
"""Names of lanes whose vehicles have median lateral positions that are closer than this are one lane [m]."""
LEAST_LANE_WIDTH = 2.2
"""Least distance between the middles of two lanes [m]."""
BIN, BLUR = 0.1, 0.4
"""Width of the bins of lateral positions and standard deviation of the filter over them [m]."""
LEAST_SHARE = 0.02
"""A lane has at least this share of the most used lane's rows per metre."""


def from_labels(label: pd.Series, d: pd.Series) -> pd.Series:
    """Lanes from names: numbered by the median lateral position of their rows, from the left. "" is no lane: 0."""
    words = label.astype("string").fillna("")
    median = d[words != ""].groupby(words[words != ""]).median().sort_values(ascending=False)
    number, last = 0, np.inf
    lanes: dict[str, int] = {"": 0}
    for word, place in median.items():
        number += last - place >= SAME_LANE
        last = place if last - place >= SAME_LANE else last
        lanes[str(word)] = number
    return words.map(lanes).astype(float)


def from_edges(d: pd.Series, edges: Sequence[float]) -> pd.Series:
    """Lanes from the lateral positions of the lines between them [m]; left of all lines is lane 1."""
    ordered = np.sort(np.asarray(edges, float))
    return pd.Series(1.0 + len(ordered) - np.searchsorted(ordered, d.to_numpy(), "right"), d.index).where(
        d.notna(), 0.0
    )


def estimated_edges(d: pd.Series) -> tuple[float, ...]:
    """The lines between lanes [m], from left to right: half-way between the places where most vehicles drive."""
    values = d.dropna().to_numpy()
    if not len(values):
        return ()
    bins = np.arange(values.min() - 2, values.max() + 2 + BIN, BIN)
    from scipy.ndimage import gaussian_filter1d  # both take long to import; most runs replay no recording
    from scipy.signal import find_peaks

    counts = gaussian_filter1d(np.histogram(values, bins)[0].astype(float), BLUR / BIN)
    peaks = find_peaks(counts, height=LEAST_SHARE * counts.max(), distance=round(LEAST_LANE_WIDTH / BIN))[0]
    rough = bins[peaks] + BIN / 2
    nearest = np.abs(values[:, None] - rough).argmin(1)
    near = np.abs(values - rough[nearest]) < LEAST_LANE_WIDTH / 2
    middles = [float(np.median(values[near & (nearest == k)])) for k in range(len(rough))]
    return tuple((left + right) / 2 for right, left in itertools.pairwise(middles))[::-1]
