"""Smooth tracks, and states at the model's rate that obey the model's dynamics exactly.

Positions at 10 Hz are smoothed by a Savitzky-Golay filter, a polynomial fitted over a sliding window; its derivative
is the speed. The recorded speeds and accelerations are not used: they were differentiated from noisy positions. At the
model's rate, with Δt the model's step,

    a_t = (v_{t+1} − v_t) / Δt,    x_{t+1} = x_t + (v_t + v_{t+1})·Δt/2 = x_t + v_t·Δt + a_t·Δt²/2,

so that `Dynamics.step` leads from every state to the next under the action that `Dynamics.inverse` finds. The constant
of integration is the one by which x fits the smoothed positions best. Integrated and smoothed positions differ by
millimetres, at the ends of noisy tracks by up to 0.2 m; `deviation` says by how much. Nobody reverses: below 0, v is 0.
"""

from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np
from scipy.signal import savgol_filter

from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import Tracks
from gri.data.ngsim.integration import integrated


class Smoothing(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The filter and the model's rate."""

    window: int = 21
    """Frames of 0.1 s under the filter, odd; longer is smoother, and blunts hard braking."""
    order: int = 3
    """Degree of its polynomial."""
    every: int = 2
    """The model's step in frames: 2 is 0.2 s."""

    @property
    def dt(self) -> float:
        return self.every * FRAME


@dataclass(frozen=True)
class Motion:
    """Tracks at the model's rate, by track and step; SI units, one entry per row."""

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
    """Greatest distance between integrated and smoothed positions [m]."""

    def __len__(self) -> int:
        return len(self.track)


def smoothed(tracks: Tracks, options: Smoothing) -> Motion:
    """All tracks of at least a window's length, smoothed, at the model's rate; shorter ones are left out."""
    parts, deviation = [], 0.0
    bounds = np.flatnonzero(np.r_[True, tracks.track[1:] != tracks.track[:-1], True])
    for start, end in pairwise(bounds):
        if end - start < options.window:
            continue
        rows = np.arange(start, end)
        kept = rows[tracks.frame[rows] % options.every == 0]
        along = axis(tracks.x[rows], kept - start, options, least=0.0)
        aside = axis(tracks.y[rows], kept - start, options)
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


def axis(
    position: np.ndarray, kept: np.ndarray, options: Smoothing, least: float = -np.inf
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Position [m], speed (at least `least`) and acceleration at the kept frames, how far x is off the smooth one."""
    smooth, slope = (
        np.asarray(savgol_filter(position, options.window, options.order, deriv=d, delta=FRAME))[kept] for d in (0, 1)
    )
    v = slope.clip(least)
    x, a = integrated(v, smooth, options.dt)
    return x, v, a, float(np.abs(x - smooth).max())
