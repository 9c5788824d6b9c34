"""Reference points and frames, converted here and nowhere else.

World: SUMO's Cartesian plane [m]. A vehicle's pose is its **front-bumper centre** and its heading [rad],
counter-clockwise from +x. SUMO gives angles in navigational degrees (0 = north, clockwise).
Road: `s` [m] along the reference line of a road from its origin, `d` [m] to its left. Where traffic drives on the left,
the road frame is the mirror image: `d` is to the right, and relative headings are clockwise.
Model: as road, but every vehicle ahead counts as `NOMINAL_LENGTH` long, because the paper's headways are differences of
positions and do not depend on lengths (see `model_offsets`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from cosim.world.polyline import corner_normals, directions, with_corner_vertices

NOMINAL_LENGTH = 5.0  # [m], of a vehicle ahead in the model's frame
EXTENSION = 1000.0  # [m] by which a curved reference line goes on straight beyond its ends
CURVATURE_REACH = 10.0  # [m] behind and ahead, over which the curvature is measured


def heading_of(sumo_angle: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Heading [rad, counter-clockwise from +x] of a navigational angle [deg], in (−π, π]."""
    heading = np.deg2rad(90.0 - sumo_angle)
    return -((-heading + np.pi) % (2 * np.pi) - np.pi)


def sumo_angle_of(heading: float) -> float:
    """Navigational angle [deg, 0 = north, clockwise] of a heading, in [0, 360)."""
    return (90.0 - math.degrees(heading)) % 360.0


@dataclass(frozen=True)
class LanePlace:
    """Where a lane is: s [m] of the road is from `low` to `high` on it, and positions from `first` to `last` count."""

    low: float
    high: float
    first: float = -math.inf
    last: float = math.inf

    @property
    def is_whole(self) -> bool:
        """Whether all positions along the lane count."""
        return math.isinf(self.first) and math.isinf(self.last)


@dataclass(frozen=True)
class LaneLine:
    """A line at constant d: at s [m] of the road one has driven `distance` [m] along it; both increase."""

    s: Float[np.ndarray, " K"]
    distance: Float[np.ndarray, " K"]

    def driven(self, s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The distance [m] along the line at s."""
        return _interpolated(s, self.s, self.distance)

    def s_at(self, distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """s [m] at a distance along the line."""
        return _interpolated(distance, self.distance, self.s)


@dataclass(frozen=True)
class RoadFrame:
    """Arc-length coordinates along a polyline.

    `points` are the reference line's vertices, `origin` [m] is the arc length at which s = 0. The line is extended
    straight beyond its ends. d is measured along `normals`, one per vertex and linear in between; by default they are
    perpendicular to the line, and the bisectors at its corners, so that lines of constant d are parallel to it. The
    segments `jumps` have no length: there the line goes on beside its end. `mirrored` is for traffic on the left.

    `places` are the lanes of the road's world, by id: the road itself and what leads to it or away from it. None means
    all lanes of a straight road.
    """

    points: Float[np.ndarray, "M 2"]
    origin: float = 0.0
    normals: Float[np.ndarray, "M 2"] | None = None
    jumps: tuple[int, ...] = ()
    mirrored: bool = False
    places: Mapping[str, LanePlace] | None = None

    @property
    def side(self) -> int:
        """1, or −1 where the frame is mirrored: the sign of d and of relative headings in the world."""
        return -1 if self.mirrored else 1

    @cached_property
    def _vertices(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices with normals; without given normals, vertices near the corners are added.

        A line that is not straight is longer than the road by EXTENSION on both ends.
        """
        line, normals = self.points, self.normals
        if normals is None:
            line = with_corner_vertices(line)
            normals = self.side * corner_normals(line)  # to the side of positive d
        if not self.is_straight:
            before, after = (EXTENSION * step for step in directions(line)[[0, -1]])
            line = np.concatenate([line[:1] - before, line, line[-1:] + after])
            normals = np.concatenate([normals[:1], normals, normals[-1:]])
        return (line * [1, -1], normals * [1, -1]) if self.mirrored else (line, normals)

    @property
    def _jumps(self) -> list[int]:
        return [k + 1 for k in self.jumps]

    @cached_property
    def _segments(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Start, unit direction and start arc length of each segment."""
        line = self._vertices[0]
        delta = np.diff(line, axis=0)
        length = np.hypot(delta[:, 0], delta[:, 1])
        assert (length > 0).all(), "the reference line has a repeated point"
        direction = delta / length[:, None]
        length[self._jumps] = 0.0
        first = 0.0 if self.is_straight else -EXTENSION
        return line[:-1], direction, first + np.concatenate([[0.0], np.cumsum(length)])

    @cached_property
    def _straight(self) -> tuple[np.ndarray, float]:
        """The unit vector to the left of a straight line, and its heading [rad]."""
        x, y = self._segments[1][0]
        return np.array([-y, x]), float(np.arctan2(y, x))

    @property
    def is_straight(self) -> bool:
        """Whether the reference line is one straight segment."""
        return len(self.points) == 2

    @property
    def straight_line(self) -> tuple[float, ...] | None:
        """Where the line is straight and not mirrored: start x, y, direction x, y, normal x, y, origin, arc length at
        the start [m], heading [rad]. None elsewhere."""
        if not self.is_straight or self.mirrored:
            return None
        (start, direction, arc), (normal, heading) = self._segments, self._straight
        return *start[0].tolist(), *direction[0].tolist(), *normal.tolist(), self.origin, float(arc[0]), heading

    @property
    def end(self) -> float:
        """Coordinate s [m] of the end of the reference line."""
        return float(self._segments[2][-1]) - (0.0 if self.is_straight else EXTENSION) - self.origin

    def to_road(
        self,
        xy: Float[np.ndarray, "V 2"],
        within: tuple[Float[np.ndarray, " V"], Float[np.ndarray, " V"]] | None = None,
    ) -> tuple[Float[np.ndarray, " V"], Float[np.ndarray, " V"]]:
        """Coordinates (s, d) of world points.

        `within` are the lowest and highest s [m] of each point, known from its lane: a road may pass near itself.
        """
        start, direction, arc = self._segments
        if self.mirrored:
            xy = xy * [1, -1]
        if self.is_straight:
            along, across = _turned(xy[:, 0] - start[0, 0], xy[:, 1] - start[0, 1], direction[0])
            return along - self.origin, across
        segment = self._nearest(xy, within)
        last, forward = len(direction) - 1, np.ones(len(direction), dtype=int)
        forward[[k - 1 for k in self._jumps]] = 2  # the segment after a jump follows the one before it
        backward = np.ones(len(direction), dtype=int)
        backward[[k + 1 for k in self._jumps]] = 2
        for _ in range(20):  # from the nearest segment to the one between whose normals the point is
            share, d = self._in_segment(xy, segment)
            move = np.where(share > 1, forward[segment], np.where(share < 0, -backward[segment], 0))
            following = np.clip(segment + move, 0, last)
            if (following == segment).all():
                break
            segment = following
        return arc[segment] + share * self._lengths[segment] - self.origin, d

    def _nearest(self, xy: Float[np.ndarray, "V 2"], within: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
        """The nearest segment of each point, of those within its range of s."""
        start, direction, arc = self._segments
        along, across = _turned(xy[:, :1] - start[:, 0], xy[:, 1:] - start[:, 1], direction.T)  # Shape: (V, M-1)
        distance = np.hypot(along - np.clip(along, 0.0, self._lengths), across)
        distance[:, self._jumps] = np.inf
        if within is not None:
            lowest, highest = (value + self.origin for value in within)
            beside = (arc[1:] < lowest[:, None]) | (arc[:-1] > highest[:, None])
            beside[beside.all(axis=1)] = False  # a point beyond the ends of the line
            distance = np.where(beside, np.inf, distance)
        return np.argmin(distance, axis=1)

    @cached_property
    def _lengths(self) -> Float[np.ndarray, " S"]:
        return np.diff(self._segments[2])

    def _in_segment(self, xy: Float[np.ndarray, "V 2"], segment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The share u of its segment at which a point is, beyond [0, 1] outside it, and d [m].

        With the vertices P and Q of a segment and their normals m and n, a point is at
        P + u·(Q − P) + d·(m + u·(n − m)). The cross product with the last bracket gives a quadratic equation for u.
        """
        start, normals = self._segments[0], self._vertices[1]
        edge = self._segments[1][segment] * self._lengths[segment][:, None]
        first, change = normals[segment], normals[segment + 1] - normals[segment]
        away = xy - start[segment]
        square, linear, constant = (
            -_cross(edge, change),
            _cross(away, change) - _cross(edge, first),
            _cross(away, first),
        )
        root = np.sqrt(np.maximum(linear**2 - 4 * square * constant, 0.0))
        share = 2 * constant / np.where(root - linear > 1e-12, root - linear, np.inf)
        normal = first + share[:, None] * change
        return share, ((away - share[:, None] * edge) * normal).sum(axis=1) / (normal**2).sum(axis=1)

    def to_world(
        self, s: Float[np.ndarray, " V"], d: Float[np.ndarray, " V"]
    ) -> tuple[Float[np.ndarray, "V 2"], Float[np.ndarray, " V"]]:
        """World points at road coordinates, and the heading of the road there [rad]."""
        start, direction, arc = self._segments
        if self.is_straight and not self.mirrored:
            normal, heading = self._straight
            xy = start[0] + (s + self.origin)[:, None] * direction[0] + d[:, None] * normal
            return xy, np.full(len(s), heading)
        segment = self._segment_at(s)
        along = (s + self.origin - arc[segment])[:, None]
        xy = start[segment] + along * direction[segment] + d[:, None] * self._normal_at(s, segment)
        return xy * [1, -1] if self.mirrored else xy, self.heading_at(s)

    def _normal_at(self, s: Float[np.ndarray, " V"], segment: np.ndarray) -> Float[np.ndarray, "V 2"]:
        normals, arc = self._vertices[1], self._segments[2]
        share = ((s + self.origin - arc[segment]) / self._lengths[segment])[:, None]
        return normals[segment] + share * (normals[segment + 1] - normals[segment])

    def heading_at(self, s: Float[np.ndarray, " V"]) -> Float[np.ndarray, " V"]:
        """Heading of the road [rad], at right angles to its normals; it changes continuously."""
        if self.is_straight:
            heading = np.full(len(s), self._straight[1])
        else:
            normal = self._normal_at(s, self._segment_at(s))
            heading = np.arctan2(-normal[:, 0], normal[:, 1])
        return -heading if self.mirrored else heading

    def curvature_at(self, s: Float[np.ndarray, " V"], d: Float[np.ndarray, " V"]) -> Float[np.ndarray, " V"]:
        """Curvature [1/m] of the road at road coordinates, positive in a bend to the side of positive d.

        It is the change of heading from 10 m behind to 10 m ahead, so that bends may be polylines.
        """
        turn = self.side * (self.heading_at(s + CURVATURE_REACH) - self.heading_at(s - CURVATURE_REACH))
        along = ((turn + np.pi) % (2 * np.pi) - np.pi) / (2 * CURVATURE_REACH)
        return along / np.maximum(1 - along * d, 0.1)  # a lane on the inner side has a smaller radius

    def line_at(self, d: float) -> LaneLine | None:
        """The line at this d [m], along which distances differ from s in bends; None on a straight road."""
        if self.is_straight:
            return None
        line, normals = self._vertices
        steps = np.hypot(*np.diff(line + d * normals, axis=0).T)
        turned = (np.diff(line + d * normals, axis=0) * self._segments[1]).sum(axis=1) <= 0
        steps[turned | (self._lengths == 0)] = 0.0  # on the inner side of a corner a line may turn back
        s = self._segments[2] - self.origin
        kept = np.concatenate([[True], steps > 0])
        s, distance = s[kept], np.concatenate([[0.0], np.cumsum(steps)])[kept]
        return LaneLine(s, distance - np.interp(0.0, s, distance))

    def stretch_at(self, s: Float[np.ndarray, " V"], d: Float[np.ndarray, " V"]) -> Float[np.ndarray, " V"]:
        """Metres along the line at d per metre of s."""
        if self.is_straight:
            return np.ones(len(s))
        segment = self._segment_at(s)
        normals = self._vertices[1]
        change = normals[segment + 1] - normals[segment]
        turned = d[:, None] * change / self._lengths[segment][:, None]
        return np.maximum(np.hypot(*(self._segments[1][segment] + turned).T), 0.1)

    def _segment_at(self, s: Float[np.ndarray, " V"]) -> Int[np.ndarray, " V"]:
        """The segment at each s, which is never one without a length; the first and the last one go on."""
        arc = self._segments[2]
        return np.clip(np.searchsorted(arc, s + self.origin, side="right") - 1, 0, len(arc) - 2)


def _interpolated(x: np.ndarray, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Linear interpolation that goes on with the slope 1 beyond the ends."""
    return np.interp(x, knots, values) + np.minimum(x - knots[0], 0.0) + np.maximum(x - knots[-1], 0.0)


def _cross(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]


def _turned(x: np.ndarray, y: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Components of (x, y) along a direction and to the left of it."""
    return x * direction[0] + y * direction[1], direction[0] * y - direction[1] * x


def model_offsets(length: Float[np.ndarray, "G N"], order: tuple[int, ...] | None = None) -> Float[np.ndarray, "G N"]:
    """Offsets [m] of `s` that turn every headway of a group into the net gap plus `NOMINAL_LENGTH`.

    `order` lists the roles from the rear to the front, by default 0, 1, and so on. The rearmost vehicle has the offset
    0. Every vehicle ahead is shifted by the sum of (nominal − true length) of itself and the vehicles between. Offsets
    are constant in time, so they change neither speeds and accelerations nor the dynamics.
    """
    offsets = np.zeros_like(length)
    for behind, ahead in pairwise(range(length.shape[1]) if order is None else order):
        offsets[:, ahead] = offsets[:, behind] + NOMINAL_LENGTH - length[:, ahead]
    return offsets
