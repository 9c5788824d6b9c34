"""Contacts and surrogate safety measures; our own oriented-box test is the truth about collisions.

Poses are front-bumper centres (see cosim/world/road_frame.py); a box of length L reaches from the pose backwards.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


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
    forward = np.array([np.cos(heading), np.sin(heading)])  # Shape: (2, V), here and below: long inner loops are fast
    centre, along = xy.T - 0.5 * length * forward, np.abs(forward)
    reach = 0.5 * (length * along + width * along[::-1])  # of the box around the box, in x and y
    close = np.abs(centre[:, None] - centre[:, rows, None]) < reach[:, None] + reach[:, rows, None]
    near = close[0] & close[1]  # Shape: (R, V)
    near[np.arange(len(rows)), rows] = False
    if not near.any():
        return np.empty((0, 2), dtype=int)
    which, j = np.nonzero(near)
    i = rows[which]
    boxes = Boxes(xy, heading, length, width)
    return np.stack([i, j], axis=1)[boxes_meet(boxes[i], boxes[j])]


@dataclass(frozen=True)
class Boxes:
    """Oriented boxes, each given by its vehicle's pose."""

    xy: Float[np.ndarray, "P 2"]
    heading: Float[np.ndarray, " P"]
    length: Float[np.ndarray, " P"]
    width: Float[np.ndarray, " P"]

    def __getitem__(self, rows: Int[np.ndarray, " R"]) -> "Boxes":
        return Boxes(self.xy[rows], self.heading[rows], self.length[rows], self.width[rows])


def boxes_meet(one: Boxes, other: Boxes) -> Bool[np.ndarray, " P"]:
    """Whether the boxes of each pair overlap, by the separating-axis theorem; touching is no overlap."""
    forward, there = _direction(one.heading), _direction(other.heading)
    x, y = (other.xy - 0.5 * other.length[:, None] * there - one.xy + 0.5 * one.length[:, None] * forward).T
    cos, sin = _turned(forward, *there.T)  # of the angle between the boxes
    cos, sin = np.abs(cos), np.abs(sin)
    apart = np.zeros(len(x), dtype=bool)
    for direction, own, their in ((forward, one, other), (there, other, one)):
        along, across = _turned(direction, x, y)
        apart |= np.abs(along) >= 0.5 * (own.length + their.length * cos + their.width * sin)
        apart |= np.abs(across) >= 0.5 * (own.width + their.length * sin + their.width * cos)
    return ~apart


def _turned(
    forward: Float[np.ndarray, "P 2"], x: Float[np.ndarray, " P"], y: Float[np.ndarray, " P"]
) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    """Components of vectors along these directions and to the left of them."""
    return forward[:, 0] * x + forward[:, 1] * y, forward[:, 0] * y - forward[:, 1] * x


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
