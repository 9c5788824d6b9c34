"""Smooth tracks, and states at the model's time step that obey the model's dynamics exactly.

A Savitzky-Golay filter (a polynomial fitted over a sliding window) smooths the positions at 10 Hz. Its derivative is
the speed. The recorded speeds and accelerations are not used, because they are derivatives of noisy positions. With the
model's time step Δt,

    a_t = (v_{t+1} − v_t) / Δt,    x_{t+1} = x_t + (v_t + v_{t+1})·Δt/2 = x_t + v_t·Δt + a_t·Δt²/2,

so that `Dynamics.step` leads from every state to the next with the action that `Dynamics.inverse` returns. The constant
of integration is the best fit of x to the smoothed positions. Integrated and smoothed positions differ by millimetres,
and by up to 0.2 m at the ends of noisy tracks (`Motion.deviation`). Vehicles do not reverse: negative speeds become 0.
"""

from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np

from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import Tracks
from gri.data.ngsim.integration import integrated


class Smoothing(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The filter and the model's time step."""

    window: int = 21
    """Length of the filter's window [frames of 0.1 s], odd. A longer window is smoother but weakens hard braking."""
    order: int = 3
    """Degree of the filter's polynomial."""
    every: int = 2
    """The model's time step [frames]; 2 means 0.2 s."""

    @property
    def dt(self) -> float:
        """The model's time step [s]."""
        return self.every * FRAME


@dataclass(frozen=True)
class Motion:
    """Tracks at the model's time step in SI units, ordered by track and step. All arrays are [R], one entry per row."""

    vehicle: np.ndarray
    track: np.ndarray
    step: np.ndarray
    """Frame divided by `Smoothing.every`."""
    lane: np.ndarray
    kind: np.ndarray
    length: np.ndarray
    width: np.ndarray
    x: np.ndarray
    y: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    ax: np.ndarray
    ay: np.ndarray
    deviation: float
    """Largest distance between integrated and smoothed positions [m]."""

    def __len__(self) -> int:
        return len(self.track)


def smoothed(tracks: Tracks, options: Smoothing) -> Motion:
    """All tracks, smoothed, at the model's time step. Tracks shorter than the filter's window are left out."""
    parts, deviation = [], 0.0
    bounds = np.flatnonzero(np.r_[True, tracks.track[1:] != tracks.track[:-1], True])
    for start, end in pairwise(bounds):
        if end - start < options.window:
            continue
        rows = np.arange(start, end)
        kept = rows[tracks.frame[rows] % options.every == 0]
        along = smooth_axis(tracks.x[rows], kept - start, options, min_speed=0.0)
        aside = smooth_axis(tracks.y[rows], kept - start, options)
        deviation = max(deviation, along[3], aside[3])
        parts.append((kept, np.stack([along[0], aside[0], along[1], aside[1], along[2], aside[2]])))
    chosen = np.concatenate([rows for rows, _ in parts]) if parts else np.zeros(0, int)
    values = np.concatenate([values for _, values in parts], 1) if parts else np.zeros((6, 0))
    return Motion(
        vehicle=tracks.vehicle[chosen],
        track=tracks.track[chosen],
        step=tracks.frame[chosen] // options.every,
        lane=tracks.lane[chosen],
        kind=tracks.kind[chosen],
        length=tracks.length[chosen],
        width=tracks.width[chosen],
        **dict(zip(("x", "y", "vx", "vy", "ax", "ay"), values, strict=True)),
        deviation=deviation,
    )


def smooth_axis(
    position: np.ndarray, frames: np.ndarray, options: Smoothing, min_speed: float = -np.inf
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Motion along one axis of one track.

    `position` [T] is the position in every frame [m], `frames` [U] the frames wanted, `min_speed` a lower bound [m/s].
    Returns position [m], speed [m/s] and acceleration [m/s²], each [U], and the largest distance between integrated and
    smoothed positions [m].
    """
    from scipy.signal import savgol_filter  # takes long to import; runs without a recording need none of it

    smooth, slope = (
        np.asarray(savgol_filter(position, options.window, options.order, deriv=d, delta=FRAME))[frames] for d in (0, 1)
    )
    v = slope.clip(min_speed)
    x, a = integrated(v, smooth, options.dt)
    return x, v, a, float(np.abs(x - smooth).max())
