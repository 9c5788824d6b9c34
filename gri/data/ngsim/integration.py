"""Positions and accelerations that obey the dynamics of a point mass."""

import numpy as np


def integrated(v: np.ndarray, position: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions [m] and accelerations [m/s²] that obey the point mass's dynamics (Sec. VI-C) with the given speeds.

    `v` [..., T] are speeds [m/s], `position` [..., T] measured positions [m], `dt` the time step [s]. The acceleration
    is a_t = (v_{t+1} − v_t)/Δt, repeated at the last step. The constant of integration makes the mean difference to the
    measured positions zero.
    """
    a = np.diff(v) / dt
    x = np.cumsum((v[..., :-1] + v[..., 1:]) * dt / 2, -1)
    x = np.concatenate([np.zeros_like(v[..., :1]), x], -1)
    x = x + np.mean(position - x, -1, keepdims=True)
    return x, np.concatenate([a, a[..., -1:]], -1)
