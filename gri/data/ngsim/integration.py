"""Motion that obeys the dynamics of a point mass."""

import numpy as np


def integrated(v: np.ndarray, position: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and accelerations [..., T] that obey the dynamics with speeds v, nearest to the given positions."""
    a = np.diff(v) / dt
    x = np.cumsum((v[..., :-1] + v[..., 1:]) * dt / 2, -1)
    x = np.concatenate([np.zeros_like(v[..., :1]), x], -1)
    x = x + np.mean(position - x, -1, keepdims=True)
    return x, np.concatenate([a, a[..., -1:]], -1)
