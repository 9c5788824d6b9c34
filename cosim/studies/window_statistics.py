"""What single samples do not show: sums over the windows of a recording, of which statistics of the traffic are ratios.

Each function takes samples (docs in `cosim.studies.traffic_samples`), the number of the window of each sample, and how
many windows there are. It returns a row of sums for each window. Sums of windows can be added, and drawn with
replacement.
"""

from collections.abc import Callable, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from cosim.studies.wave_speed import wave_sums

STANDING = 1.0  # [m/s]
SLOW = 3.0  # [m/s]
SHORT_HEADWAY = 1.0  # [s]
LAGS = (10, 20, 45)  # [s]
PERIOD = 1.0  # [s] between two samples of a vehicle
ROUNDING = 1e-9  # [m²/s²]; smaller squares are rounding errors
SPARE = 5  # seconds that a window must be longer than a lag

Sums = Callable[[pd.DataFrame, np.ndarray, int], np.ndarray]


def _summed(
    window: Int[np.ndarray, " n"], number: int, numerator: np.ndarray, denominator: np.ndarray
) -> Float[np.ndarray, "windows 2"]:
    return np.stack([np.bincount(window, part, number) for part in (numerator, denominator)], axis=1)


def _group(window: np.ndarray, by: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The number of the group (window, by) of each sample, and the window of each group."""
    code, values = pd.factorize(by)
    pairs, group = np.unique(window * max(len(values), 1) + code, return_inverse=True)
    return group, pairs // max(len(values), 1)


def _spread(column: str, by: str | None = None) -> Sums:
    """Squared deviations from the mean of each group (`by`) within a window, and the degrees of freedom."""

    def sums(samples: pd.DataFrame, window: np.ndarray, number: int) -> np.ndarray:
        known = samples[column].notna().to_numpy()
        values, window = samples[column].to_numpy(float)[known], window[known]
        group, its_window = _group(window, samples[by].to_numpy()[known] if by else np.zeros(len(values)))
        size = np.bincount(group)
        deviation = values - (np.bincount(group, values) / np.maximum(size, 1))[group]
        squares = np.bincount(window, np.where(size[group] > 1, np.square(deviation), 0.0), number)
        return np.stack([squares, np.bincount(its_window, size - 1.0, number)], axis=1)

    return sums


def _percent(inside: Callable[[pd.DataFrame], pd.Series], of: Callable[[pd.DataFrame], pd.Series]) -> Sums:
    """Samples that fulfil a condition, in percent of those that fulfil another."""

    def sums(samples: pd.DataFrame, window: np.ndarray, number: int) -> np.ndarray:
        base = of(samples).to_numpy(bool)
        return _summed(window, number, 100.0 * (base & inside(samples).to_numpy(bool)), base.astype(float))

    return sums


def _lane_changes(samples: pd.DataFrame, window: np.ndarray, number: int) -> np.ndarray:
    """Changes between one second and the next, and the vehicle-kilometres between both."""
    known = samples["lane"].notna().to_numpy()
    part, window = samples[known], window[known]
    vehicle = pd.factorize(part["vehicle"])[0]
    order = np.lexsort((part["time"], vehicle, window))
    time, lane, x = (part[name].to_numpy(float)[order] for name in ("time", "lane", "x"))
    window, vehicle = window[order], vehicle[order]
    together = (np.diff(window) == 0) & (np.diff(vehicle) == 0) & (np.diff(time) < 1.5 * PERIOD)
    changed, way = together & (np.diff(lane) != 0), np.where(together, np.diff(x), 0.0)
    return _summed(window[1:], number, changed.astype(float), way / 1000)


def _autocorrelation(lag: int) -> Sums:
    """Products of the deviations of a lane's speed from its mean in the window, `lag` seconds apart; and squares."""

    def sums(samples: pd.DataFrame, window: np.ndarray, number: int) -> np.ndarray:
        known = samples["lane"].notna().to_numpy()
        lane, lanes = pd.factorize(samples["lane"].to_numpy()[known])
        second, window = samples["time"].round().to_numpy(int)[known], window[known]
        first = np.full(number, np.iinfo(int).max)
        np.minimum.at(first, window, second)
        second = second - first[window]
        shape = number, len(lanes), int(second.max(initial=0)) + 1
        cell = np.ravel_multi_index((window, lane, second), shape)
        size = number * len(lanes) * shape[2]
        count, total = (np.bincount(cell, w, size).reshape(shape) for w in (None, samples["v"].to_numpy()[known]))
        seen = count > 0
        seen &= (seen.any(1).sum(1) >= lag + SPARE)[:, None, None]  # windows that are too short do not count
        speed = np.divide(total, count, out=np.zeros(shape), where=seen)
        mean = np.divide(speed.sum(2), seen.sum(2), out=np.zeros(shape[:2]), where=seen.any(2))
        before, after = (np.where(seen, speed - mean[..., None], 0.0)[..., cut] for cut in (np.s_[:-lag], np.s_[lag:]))
        both = seen[..., :-lag] & seen[..., lag:]
        squares = np.where(both, (np.square(before) + np.square(after)) / 2, 0.0)
        found = np.stack([(before * after * both).sum((1, 2)), squares.sum((1, 2))], axis=1)
        return np.where(found[:, 1:] > ROUNDING, found, 0.0)  # a constant speed has no correlation

    return sums


def _waves(samples: pd.DataFrame, window: np.ndarray, number: int) -> np.ndarray:
    parts: Sequence[pd.DataFrame] = [part for _, part in samples.groupby(window)]
    return np.stack([wave_sums(part) for part in parts])


def _everyone(samples: pd.DataFrame) -> pd.Series:
    return samples["v"].notna()


SUMS: dict[str, Sums] = {
    "vehicle_sd": _spread("v", "vehicle"),
    "lane_sd": _spread("v", "lane"),
    "headway_sd": _spread("time_headway"),
    "short_headways": _percent(lambda p: p["time_headway"] < SHORT_HEADWAY, lambda p: p["time_headway"].notna()),
    "standing": _percent(lambda p: p["v"] < STANDING, _everyone),
    "slow_leftmost": _percent(lambda p: p["v"] < SLOW, lambda p: p["lane"] == 1),
    "lane_changes": _lane_changes,
    **{f"autocorrelation_{lag}": _autocorrelation(lag) for lag in LAGS},
    "wave_speed": _waves,
}
"""For each statistic of whole windows, what is summed."""
