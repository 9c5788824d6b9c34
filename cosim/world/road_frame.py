"""Reference points and frames, converted here and nowhere else.

World: SUMO's Cartesian plane [m]. A vehicle's pose is its **front-bumper centre** and its heading [rad],
counter-clockwise from +x. SUMO gives angles in navigational degrees (0 = north, clockwise).
Road: `s` [m] along the reference line of a road from its origin, `d` [m] to its left.
Model: as road, but every vehicle ahead counts as `NOMINAL_LENGTH` long, because the paper's headways are differences of
positions and do not depend on lengths (see `model_offsets`).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

NOMINAL_LENGTH = 5.0  # [m], of a vehicle ahead in the model's frame
CURVATURE_REACH = 10.0  # [m] behind and ahead, over which the curvature is measured


def heading_of(sumo_angle: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Heading [rad, counter-clockwise from +x] of a navigational angle [deg], in (−π, π]."""
    heading = np.deg2rad(90.0 - sumo_angle)
    return -((-heading + np.pi) % (2 * np.pi) - np.pi)


def sumo_angle_of(heading: float) -> float:
    """Navigational angle [deg, 0 = north, clockwise] of a heading, in [0, 360)."""
    return (90.0 - math.degrees(heading)) % 360.0


@dataclass(frozen=True)
class RoadFrame:
    """Arc-length coordinates along a polyline.

    `points` are the reference line's vertices, `origin` [m] is the arc length at which s = 0. The line is extended
    straight beyond its ends. A point is projected onto the nearest segment.
    """

    points: Float[np.ndarray, "M 2"]
    origin: float = 0.0

    @cached_property
    def _segments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Start, unit direction and start arc length of each segment."""
        delta = np.diff(self.points, axis=0)
        length = np.hypot(delta[:, 0], delta[:, 1])
        assert (length > 0).all(), "the reference line has a repeated point"
        return self.points[:-1], delta / length[:, None], np.concatenate([[0.0], np.cumsum(length)])

    @cached_property
    def _sideways(self) -> tuple[np.ndarray, np.ndarray]:
        """Unit vector to the left and heading of each segment."""
        forward = self._segments[1]
        return np.stack([-forward[:, 1], forward[:, 0]], axis=1), np.arctan2(forward[:, 1], forward[:, 0])

    @property
    def end(self) -> float:
        """Coordinate s [m] of the end of the reference line."""
        return float(self._segments[2][-1]) - self.origin

    def to_road(self, xy: Float[np.ndarray, "V 2"]) -> tuple[Float[np.ndarray, " V"], Float[np.ndarray, " V"]]:
        """Coordinates (s, d) of world points."""
        start, direction, arc = self._segments
        if len(direction) == 1:
            along, across = _turned(xy[:, 0] - start[0, 0], xy[:, 1] - start[0, 1], direction[0])
            return along - self.origin, across
        along, across = _turned(xy[:, :1] - start[:, 0], xy[:, 1:] - start[:, 1], direction.T)  # Shape: (V, M-1)
        low, high = np.zeros(len(direction)), np.diff(arc)
        low[0], high[-1] = -np.inf, np.inf
        overshoot = along - np.clip(along, low, high)
        nearest = np.argmin(np.hypot(overshoot, across), axis=1)
        rows = np.arange(len(xy))
        return arc[nearest] + along[rows, nearest] - self.origin, across[rows, nearest]

    def to_world(
        self, s: Float[np.ndarray, " V"], d: Float[np.ndarray, " V"]
    ) -> tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, " V"]]:
        """World points at road coordinates, and the heading of the road there [rad]."""
        start, direction, arc = self._segments
        left, heading = self._sideways
        segment = self._segment_at(s)
        along = (s + self.origin - arc[segment])[:, None]
        return start[segment] + along * direction[segment] + d[:, None] * left[segment], heading[segment]

    def heading_at(self, s: Float[np.ndarray, " V"]) -> Float[np.ndarray, " V"]:
        """Heading of the road [rad]."""
        return self._sideways[1][self._segment_at(s)]

    def curvature_at(self, s: Float[np.ndarray, " V"], d: Float[np.ndarray, " V"]) -> Float[np.ndarray, " V"]:
        """Curvature [1/m] of the road at road coordinates, positive in a bend to the left.

        It is the change of heading from 10 m behind to 10 m ahead, so that bends may be polylines.
        """
        turn = self.heading_at(s + CURVATURE_REACH) - self.heading_at(s - CURVATURE_REACH)
        along = ((turn + np.pi) % (2 * np.pi) - np.pi) / (2 * CURVATURE_REACH)
        return along / np.maximum(1 - along * d, 0.1)  # a lane on the inner side has a smaller radius

    def _segment_at(self, s: Float[np.ndarray, " V"]) -> Int[np.ndarray, " V"]:
        _, direction, arc = self._segments
        if len(direction) == 1:
            return np.zeros(len(s), dtype=int)
        return np.clip(np.searchsorted(arc, s + self.origin, side="right") - 1, 0, len(direction) - 1)


def _turned(x: np.ndarray, y: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Components of (x, y) along a direction and to the left of it."""
    return x * direction[0] + y * direction[1], direction[0] * y - direction[1] * x


def without_straight_vertices(line: Float[np.ndarray, "M 2"]) -> Float[np.ndarray, "K 2"]:
    """The same polyline without the vertices at which it does not turn, so that projections cost less."""
    direction = np.diff(line, axis=0)
    direction /= np.hypot(direction[:, 0], direction[:, 1])[:, None]
    turn = direction[:-1, 0] * direction[1:, 1] - direction[:-1, 1] * direction[1:, 0]
    return line[np.concatenate([[True], np.abs(turn) > 1e-12, [True]])]


def model_offsets(length: Float[np.ndarray, "G 3"], order: tuple[int, ...] = (0, 1, 2)) -> Float[np.ndarray, "G 3"]:
    """Offsets [m] of `s` that turn every headway of a group into the net gap plus `NOMINAL_LENGTH`.

    `order` lists the roles from the rear to the front. The rearmost vehicle has the offset 0. Every vehicle ahead is
    shifted by the sum of (nominal − true length) of itself and the vehicles between. Offsets are constant in time, so
    they change neither speeds and accelerations nor the dynamics.
    """
    offsets = np.zeros_like(length)
    for behind, ahead in pairwise(order):
        offsets[:, ahead] = offsets[:, behind] + NOMINAL_LENGTH - length[:, ahead]
    return offsets
