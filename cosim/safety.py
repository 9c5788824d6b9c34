"""Contacts and surrogate safety measures; our own oriented-box test is the truth about collisions.

Poses are front-bumper centres (see cosim/frames.py); a box of length L reaches from the pose backwards.
"""

import numpy as np
from jaxtyping import Float, Int


def box_centre(
    xy: Float[np.ndarray, "V 2"], heading: Float[np.ndarray, " V"], length: Float[np.ndarray, " V"]
) -> Float[np.ndarray, "V 2"]:
    """Centres of the boxes whose front-bumper centres are at `xy`."""
    return xy - 0.5 * length[:, None] * _direction(heading)


def overlaps(
    xy: Float[np.ndarray, "V 2"],
    heading: Float[np.ndarray, " V"],
    length: Float[np.ndarray, " V"],
    width: Float[np.ndarray, " V"],
    rows: Int[np.ndarray, " R"],
) -> Int[np.ndarray, "P 2"]:
    """Pairs (i, j) of overlapping boxes with i among `rows`, by the separating-axis theorem.

    Touching boxes do not overlap: the test is strict.
    """
    centre = box_centre(xy, heading, length)
    half = 0.5 * np.stack([length, width], axis=1)
    radius = np.hypot(half[:, 0], half[:, 1])
    offset = centre[None] - centre[rows][:, None]  # Shape: (R, V, 2)
    near = (offset**2).sum(-1) < (radius[rows][:, None] + radius[None]) ** 2
    near[np.arange(len(rows)), rows] = False
    which, j = np.nonzero(near)
    i, between = rows[which], offset[which, j]
    forward = _direction(heading)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    axes = np.stack([forward, left], axis=1)  # Shape: (V, axis, 2)
    apart = np.zeros(len(i), dtype=bool)
    for box in (i, j):
        for axis in (axes[box, 0], axes[box, 1]):
            reach = sum((np.abs((axes[k] * axis[:, None]).sum(-1)) * half[k]).sum(-1) for k in (i, j))
            apart |= np.abs((between * axis).sum(-1)) >= reach
    return np.stack([i, j], axis=1)[~apart]


def _direction(heading: Float[np.ndarray, " V"]) -> Float[np.ndarray, "V 2"]:
    return np.stack([np.cos(heading), np.sin(heading)], axis=1)


def net_gap(
    s_behind: Float[np.ndarray, "*n"], s_ahead: Float[np.ndarray, "*n"], length_ahead: Float[np.ndarray, "*#n"]
) -> Float[np.ndarray, "*n"]:
    """Distance [m] from a front bumper to the rear bumper ahead; negative when they overlap along the road."""
    return s_ahead - length_ahead - s_behind


def time_to_collision(
    gap: Float[np.ndarray, "*n"], v_behind: Float[np.ndarray, "*n"], v_ahead: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n"]:
    """Time [s] until contact at constant speeds: gap / (v_behind − v_ahead), +inf when the gap does not close."""
    closing = v_behind - v_ahead
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(closing > 0, np.maximum(gap, 0) / closing, np.inf)
