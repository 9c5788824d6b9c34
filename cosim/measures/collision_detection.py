"""The collision test: two vehicles collide when their oriented boxes overlap.

This test decides about every contact in the results; SUMO's own collision check is not used. The pose of a vehicle is
its front-bumper centre (see cosim/world/road_frame.py), and a box of length L reaches from there backwards. All lengths
in m, headings in rad counter-clockwise from +x.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


def box_centre(
    xy: Float[np.ndarray, "V 2"], heading: Float[np.ndarray, " V"], length: Float[np.ndarray, " V"]
) -> Float[np.ndarray, "V 2"]:
    """Centres [m] of the boxes whose front-bumper centres are at `xy`."""
    return xy - 0.5 * length[:, None] * _unit_vector(heading)


def overlapping_pairs(
    xy: Float[np.ndarray, "V 2"],
    heading: Float[np.ndarray, " V"],
    length: Float[np.ndarray, " V"],
    width: Float[np.ndarray, " V"],
    rows: Int[np.ndarray, " R"],
) -> Int[np.ndarray, "P 2"]:
    """Pairs (i, j) of rows of colliding vehicles, with i among `rows` and j any other of the V vehicles.

    Boxes that only touch do not collide. A fast test of axis-parallel bounding boxes comes first; what it lets through
    is tested exactly by `boxes_overlap`.
    """
    forward = np.array([np.cos(heading), np.sin(heading)])  # Shape: (2, V), here and below: long inner loops are fast
    centre, along = xy.T - 0.5 * length * forward, np.abs(forward)
    half_extent = 0.5 * (length * along + width * along[::-1])  # of the axis-parallel bounding box, in x and y
    close = np.abs(centre[:, None] - centre[:, rows, None]) < half_extent[:, None] + half_extent[:, rows, None]
    near = np.logical_and(*close)  # Shape: (R, V)
    near[np.arange(len(rows)), rows] = False
    if not near.any():
        return np.empty((0, 2), dtype=int)
    which, j = np.nonzero(near)
    i = rows[which]
    boxes = Boxes(xy, heading, length, width)
    return np.stack([i, j], axis=1)[boxes_overlap(boxes[i], boxes[j])]


@dataclass(frozen=True)
class Boxes:
    """Oriented boxes of P vehicles: front-bumper centre [m], heading [rad], length and width [m]."""

    xy: Float[np.ndarray, "P 2"]
    heading: Float[np.ndarray, " P"]
    length: Float[np.ndarray, " P"]
    width: Float[np.ndarray, " P"]

    def __getitem__(self, rows: Int[np.ndarray, " R"]) -> "Boxes":
        return Boxes(self.xy[rows], self.heading[rows], self.length[rows], self.width[rows])


def boxes_overlap(one: Boxes, other: Boxes) -> Bool[np.ndarray, " P"]:
    """Whether the k-th box of `one` overlaps the k-th box of `other`, by the separating-axis theorem.

    Two boxes do not overlap if their projections on one of the four box axes are disjoint. Touching is no overlap.
    """
    forward, other_forward = _unit_vector(one.heading), _unit_vector(other.heading)
    x, y = (other.xy - 0.5 * other.length[:, None] * other_forward - one.xy + 0.5 * one.length[:, None] * forward).T
    cos, sin = _components(forward, *other_forward.T)  # of the angle between the boxes
    cos, sin = np.abs(cos), np.abs(sin)
    apart = np.zeros(len(x), dtype=bool)
    for direction, own, their in ((forward, one, other), (other_forward, other, one)):
        along, across = _components(direction, x, y)
        apart |= np.abs(along) >= 0.5 * (own.length + their.length * cos + their.width * sin)
        apart |= np.abs(across) >= 0.5 * (own.width + their.length * sin + their.width * cos)
    return ~apart


def _components(
    forward: Float[np.ndarray, "P 2"], x: Float[np.ndarray, " P"], y: Float[np.ndarray, " P"]
) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    """Components of the vectors (x, y) along the forward directions and to their left."""
    return forward[:, 0] * x + forward[:, 1] * y, forward[:, 0] * y - forward[:, 1] * x


def _unit_vector(heading: Float[np.ndarray, " V"]) -> Float[np.ndarray, "V 2"]:
    return np.stack([np.cos(heading), np.sin(heading)], axis=1)
