"""Contacts and surrogate safety measures; our own oriented-box test is the truth about collisions.

Poses are front-bumper centres (see cosim/frames.py); a box of length L reaches from the pose backwards.
"""

import numpy as np
from jaxtyping import Bool, Float


def box_centre(
    xy: Float[np.ndarray, "V 2"], heading: Float[np.ndarray, " V"], length: Float[np.ndarray, " V"]
) -> Float[np.ndarray, "V 2"]:
    """Centres of the boxes whose front-bumper centres are at `xy`."""
    return xy - 0.5 * length[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)


def overlaps(
    xy: Float[np.ndarray, "V 2"],
    heading: Float[np.ndarray, " V"],
    length: Float[np.ndarray, " V"],
    width: Float[np.ndarray, " V"],
    rows: np.ndarray,
) -> Bool[np.ndarray, "R V"]:
    """Which boxes overlap the boxes `rows`, by the separating-axis theorem; a box never overlaps itself.

    Touching boxes do not overlap: the test is strict.
    """
    centre = box_centre(xy, heading, length)
    half = 0.5 * np.stack([length, width], axis=1)  # Shape: (V, 2)
    cos, sin = np.cos(heading), np.sin(heading)
    axes = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=1)  # Shape: (V, axis, xy)
    offset = centre[None] - centre[rows][:, None]  # Shape: (R, V, xy)

    def reach(axis: np.ndarray, boxes_axes: np.ndarray, boxes_half: np.ndarray) -> np.ndarray:
        """Half extent of boxes projected on an axis."""
        return (np.abs((boxes_axes * axis[..., None, :]).sum(-1)) * boxes_half).sum(-1)

    apart = np.zeros(offset.shape[:2], dtype=bool)
    for k in range(2):
        for axis in (axes[rows][:, None, k], axes[None, :, k]):
            distance = np.abs((offset * axis).sum(-1))
            extent = reach(axis, axes[rows][:, None], half[rows][:, None]) + reach(axis, axes[None], half[None])
            apart |= distance >= extent
    apart[np.arange(len(rows)), rows] = True
    return ~apart


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
