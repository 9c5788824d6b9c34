"""Windows through which traffic is seen: a stretch of road, lanes, and a time.

A recording sees a stretch of road for a while. Simulated traffic can be compared with it only if it is seen through
windows of the same size: the spread of speeds, for instance, grows with the length of the time and of the road.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd

LONGEST = 125.0  # [s]; a longer recording is cut into windows, which are then taken as independent
SHORTEST = 4.0  # [s]


@dataclass(frozen=True)
class Window:
    """What a recording saw at one time: from where to where [m], which lanes, and how long [s]."""

    low: float
    high: float
    lanes: tuple[float, ...]
    duration: float


def windows_of(recorded: pd.DataFrame) -> tuple[list[Window], pd.DataFrame]:
    """The windows of the samples of a recording, and the samples with the number of their window (`window`).

    Each source is cut into equal windows of at most LONGEST; windows shorter than SHORTEST are left out.
    """
    windows, parts = [], []
    for _, source in recorded.groupby("source", sort=False):
        start, end = source["time"].min(), source["time"].max()
        pieces = max(1, int(np.ceil((end - start) / LONGEST)))
        edges = np.linspace(start, end, pieces + 1)
        for k, (first, last) in enumerate(pairwise(edges)):
            before = source["time"] <= last if k == pieces - 1 else source["time"] < last
            part = source[(source["time"] >= first) & before]
            if last - first < SHORTEST or part.empty:
                continue
            lanes = tuple(sorted(part["lane"].dropna().unique()))
            parts.append(part.assign(window=len(windows)))
            windows.append(Window(float(part["x"].min()), float(part["x"].max()), lanes, float(last - first)))
    return windows, pd.concat(parts, ignore_index=True) if parts else recorded.head(0).assign(window=0)


def seen_through(
    simulated: Sequence[pd.DataFrame], windows: Sequence[Window], views: int, offset: float = 0.0
) -> pd.DataFrame:
    """The simulated samples as the recording would have seen them, with columns `seed` and `window`.

    `simulated` has the samples of one simulation each. Every window is laid over `views` times of all of them, at equal
    distances in time. `offset` [m] is where the recording's x = 0 lies on the simulated road; x becomes that of the
    recording, and each view a `source` of its own.
    """
    parts, number = [], 0
    per_seed = [views // len(simulated) + (k < views % len(simulated)) for k in range(len(simulated))]
    for seed, (samples, count) in enumerate(zip(simulated, per_seed, strict=True)):
        shifted = samples.assign(x=samples["x"] - offset).sort_values("time", kind="stable")
        times = shifted["time"].to_numpy()
        for window in windows:
            latest = max(times[-1] - window.duration, times[0])
            for start in np.linspace(times[0], latest, count):
                part = shifted.iloc[slice(*np.searchsorted(times, (start, start + window.duration + 1e-6)))]
                inside = part["x"].between(window.low, window.high) & part["lane"].isin(window.lanes)
                parts.append(part[inside].assign(seed=seed, window=number, source=str(number)))
                number += 1
    return pd.concat(parts, ignore_index=True)
