"""How fast waves travel upstream: two places of a lane are compared at a range of lags.

A wave that travels upstream is seen first at the place downstream. The lag at which the speeds of both places agree
best, and the distance between them, give its speed. Recorded freeways have 12 to 22 km/h.
"""

import math

import numpy as np
import pandas as pd
from jaxtyping import Float

WAVE_BIN = 20.0  # [m] of road over which speeds are averaged to find waves
WAVE_DISTANCE = 3  # bins between two places at which the same wave is looked for
WAVE_LAGS = np.arange(3, 31)  # [s] that a wave may take from one place to the other: 7 to 72 km/h
WAVE_CORRELATION = 0.1  # a smaller correlation between both places is no wave


def wave_sums(part: pd.DataFrame) -> Float[np.ndarray, " sums"]:
    """Of each lag: products of speeds (deviations from the lane's mean) at two places, and the squares of both.

    The place upstream is looked at the lag later than the one downstream.
    """
    sums = np.zeros((3, len(WAVE_LAGS)))
    known = part[part["lane"].notna()]
    place = (known["x"].to_numpy() // WAVE_BIN).astype(int)
    second = known["time"].round().to_numpy(int)
    lanes, lane = np.unique(known["lane"], return_inverse=True)
    if not len(lanes):
        return sums.ravel()
    shape = len(lanes), int(np.ptp(second)) + 1, int(np.ptp(place)) + 1
    cell = np.ravel_multi_index((lane, second - second.min(), place - place.min()), shape)
    count, total = (np.bincount(cell, w, math.prod(shape)).reshape(shape) for w in (None, known["v"]))
    seen = count > 0
    speed = np.divide(total, count, out=np.zeros(shape), where=seen)
    mean = np.divide(speed.sum((1, 2)), seen.sum((1, 2)))[:, None, None]
    deviation = np.where(seen, speed - mean, 0.0)  # 0 adds nothing to a product; to squares, only what both places saw
    for k, lag in enumerate(WAVE_LAGS):
        before, after = deviation[:, :-lag, WAVE_DISTANCE:], deviation[:, lag:, :-WAVE_DISTANCE]
        both = seen[:, :-lag, WAVE_DISTANCE:] & seen[:, lag:, :-WAVE_DISTANCE]
        sums[:, k] = (before * after).sum(), np.square(after[both]).sum(), np.square(before[both]).sum()
    return sums.ravel()


def wave_speed(sums: Float[np.ndarray, " sums"]) -> float:
    """The speed [km/h] at which waves travel upstream: the distance of two places over the lag at which speeds agree.

    The lag is that of the highest correlation, refined by a parabola through its neighbours. NaN: no correlation above
    WAVE_CORRELATION, or the highest at either end of the lags.
    """
    products, after, before = sums.reshape(3, len(WAVE_LAGS))
    norm = np.sqrt(after * before)
    correlation = np.divide(products, norm, out=np.zeros_like(norm), where=norm > 0)
    best = int(correlation.argmax())
    if correlation[best] < WAVE_CORRELATION or not 0 < best < len(WAVE_LAGS) - 1:
        return np.nan
    left, middle, right = correlation[best - 1 : best + 2]
    lag = WAVE_LAGS[best] + 0.5 * (left - right) / (left - 2 * middle + right)
    return float(3.6 * WAVE_DISTANCE * WAVE_BIN / lag)
