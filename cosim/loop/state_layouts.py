"""Conversion between the world's road frame and the states of a policy's dynamics; one layout per dynamics.

In model states every vehicle ahead counts as `NOMINAL_LENGTH` long (`cosim.world.road_frame.model_offsets`).
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from cosim.spec.scenario import CarFollowing, GroupRule
from cosim.world.episode import COLUMNS
from cosim.world.groups import MergeLanes
from cosim.world.road_frame import LaneLine, RoadFrame, model_offsets
from gri.core.dynamics import DUBINS, POINT_MASS_1D, Dynamics

_S, _D, _X, _Y, _HEADING, _V, _A = (COLUMNS.index(name) for name in ("s", "d", "x", "y", "heading", "v", "a"))
SEEN_BESIDE = 20.0  # [m] of s around a ramp, in which its places on the road are looked for


@dataclass(frozen=True)
class Pose:
    """Poses of vehicles in the road frame: s, d [m], heading relative to the road [rad], v [m/s], a [m/s²]."""

    s: Float[np.ndarray, "G R"]
    d: Float[np.ndarray, "G R"]
    heading: Float[np.ndarray, "G R"]
    v: Float[np.ndarray, "G R"]
    a: Float[np.ndarray, "G R"]

    def of(self, group: int, role: int) -> tuple[float, float, float, float]:
        """(s, d, heading, v) of one vehicle."""
        s, d, heading, v = (float(value[group, role]) for value in (self.s, self.d, self.heading, self.v))
        return s, d, heading, v


@dataclass(frozen=True)
class LongitudinalLayout:
    """States [x, v, a] of a 1-D point mass; vehicles keep their lateral position of the take-over.

    x counts along the lane of each group (`lines`, None on a straight road, where that is s). `offset` [m] is added to
    it, `lateral` [m] are the lateral positions d.
    """

    offset: Float[np.ndarray, "G N"]
    lateral: Float[np.ndarray, "G N"]
    lines: tuple[LaneLine, ...] | None = None
    dynamics: Dynamics = POINT_MASS_1D
    order: ClassVar[tuple[int, ...] | None] = None  # of the roles, from the rear to the front

    def with_members(self, offset: Float[np.ndarray, "G N"], lateral: Float[np.ndarray, "G N"]) -> "LongitudinalLayout":
        """The layout of groups with other members, which have these offsets and lateral positions [m]."""
        return replace(self, offset=offset, lateral=lateral)

    @property
    def is_pointwise(self) -> bool:
        """Whether `states` takes several instants at once: on straight roads."""
        return self.lines is None

    def states(self, observed: Float[np.ndarray, "*T G N C"]) -> Float[np.ndarray, "*T G N 3"]:
        """Model states (float64) of vehicles with the features of COLUMNS."""
        states = observed[..., [_S, _V, _A]]
        states[..., 0] = _driven(self.lines, states[..., 0]) + self.offset
        return states

    def pose(self, state: Float[np.ndarray, "G N 3"]) -> Pose:
        """The poses of model states."""
        x, v, a = (state[..., feature] for feature in range(3))
        return Pose(_s_at(self.lines, x - self.offset), self.lateral, np.zeros(x.shape), v, a)

    def in_bends(
        self, before: Float[np.ndarray, "G N 3"], after: Float[np.ndarray, "G N 3"]
    ) -> Float[np.ndarray, "G N 3"]:
        """The states after a step as they are: x counts along the lane that is driven."""
        del before
        return after


@dataclass(frozen=True)
class RampPath:
    """The path of a ramp that joins the target lane at s = `end` [m] of the road; `width` [m] is that of a lane.

    A vehicle 0 on it follows it, whatever the policy steers: the policy decides on the speed alone.
    """

    path: RoadFrame
    end: float
    width: float

    def along(self, xy: Float[np.ndarray, "G 2"]) -> Float[np.ndarray, " G"]:
        """s [m] along the path of world points."""
        return self.path.to_road(xy)[0]

    def on_road(self, s: Float[np.ndarray, " R"], road: RoadFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(s, d, relative heading) on the road of places along the path."""
        xy, heading = self.path.to_world(s, np.zeros(len(s)))
        at, d = road.to_road(xy, (s - SEEN_BESIDE, np.full(len(s), self.end + SEEN_BESIDE)))
        turn = road.side * (heading - road.heading_at(at))
        return at, d, (turn + np.pi) % (2 * np.pi) - np.pi


@dataclass(frozen=True)
class PlanarLayout:
    """States [x, y, v, θ, a, ω] of Dubins' car; y counts from the centre of the target lane, θ from the road.

    A curved road is treated as straight: x is arc length along the target lane (`lines`, None on a straight road), y is
    the lateral offset. In a bend, a vehicle beside the target lane drives more or less of x per metre (`in_bends`).
    Where the target is on the side of smaller d (`side` −1), the states are the mirror image. SUMO has no yaw rate, so
    that of the vehicles that it drives is 0.
    """

    offset: Float[np.ndarray, "G N"]
    target: Float[np.ndarray, "G 1"]
    """d [m] of the centre of the target lane."""
    road: RoadFrame
    side: int = 1
    lines: tuple[LaneLine, ...] | None = None
    ramp: RampPath | None = None
    dynamics: Dynamics = DUBINS
    order: ClassVar[tuple[int, ...] | None] = (1, 0, 2)  # lag vehicle, merger, leader

    def with_members(self, offset: Float[np.ndarray, "G N"], lateral: Float[np.ndarray, "G N"]) -> "PlanarLayout":
        """The layout of groups with other members, which have these offsets [m]; the target lane stays."""
        del lateral
        return replace(self, offset=offset)

    @property
    def is_pointwise(self) -> bool:
        """Whether `states` takes several instants at once: on straight roads without a ramp."""
        return self.lines is None and self.ramp is None

    def states(self, observed: Float[np.ndarray, "*T G N C"]) -> Float[np.ndarray, "*T G N 6"]:
        """Model states (float64) of vehicles with the features of COLUMNS."""
        s = observed[..., _S]
        turn = self.road.side * (observed[..., _HEADING] - self.road.heading_at(s.ravel()).reshape(s.shape))
        states = np.empty((*s.shape, 6))
        states[..., 0] = _driven(self.lines, s) + self.offset
        states[..., 1] = self.side * (observed[..., _D] - self.target)
        states[..., 2], states[..., 3] = observed[..., _V], self.side * _wrapped(turn)
        states[..., 4], states[..., 5] = observed[..., _A], 0.0
        if self.ramp is not None:
            along = self.ramp.along(observed[:, 0, [_X, _Y]])
            on_ramp = along < self.ramp.end
            states[on_ramp, 0, 0] = _driven(self.lines, along[:, None])[on_ramp, 0] + self.offset[on_ramp, 0]
            states = self._kept_on_ramp(states)
        return states

    def pose(self, state: Float[np.ndarray, "G N 6"]) -> Pose:
        """The poses of model states."""
        x, y, v, heading, a, _ = (state[..., feature] for feature in range(6))
        s, d, turn = _s_at(self.lines, x - self.offset), self.side * y + self.target, self.side * heading
        if self.ramp is not None and (on_ramp := s[:, 0] < self.ramp.end).any():
            at = self.ramp.on_road(s[on_ramp, 0], self.road)
            for values, of_ramp in zip((s, d, turn), at, strict=True):
                values[on_ramp, 0] = of_ramp
        return Pose(s, d, turn, v, a)

    def _kept_on_ramp(self, states: Float[np.ndarray, "G 3 6"]) -> Float[np.ndarray, "G 3 6"]:
        """The states in which a vehicle 0 that is still on a ramp is beside its target, as far as a lane at most."""
        assert self.ramp is not None
        s = _s_at(self.lines, states[..., 0] - self.offset)[:, 0]
        if (on_ramp := s < self.ramp.end).any():
            states = states.copy()
            aside = self.side * (self.ramp.on_road(s[on_ramp], self.road)[1] - self.target[on_ramp, 0])
            states[on_ramp, 0, 1] = np.maximum(aside, -self.ramp.width)
            states[on_ramp, 0, 3] = states[on_ramp, 0, 5] = 0.0
        return states

    def in_bends(
        self, before: Float[np.ndarray, "G N 6"], after: Float[np.ndarray, "G N 6"]
    ) -> Float[np.ndarray, "G N 6"]:
        """The states after a step, with the way along x that a vehicle at y drives in it; a ramp is followed."""
        if self.ramp is not None:
            after = self._kept_on_ramp(after)
        if self.lines is None:
            return after
        pose, result = self.pose(before), after.copy()
        s, d = pose.s.ravel(), pose.d.ravel()
        on_target = self.road.stretch_at(s, np.broadcast_to(self.target, pose.d.shape).ravel())
        longer = (on_target / self.road.stretch_at(s, d)).reshape(pose.s.shape)
        result[..., 0] = before[..., 0] + longer * (after[..., 0] - before[..., 0])
        return result


Layout = LongitudinalLayout | PlanarLayout


def layout_of(
    rule: GroupRule,
    road: RoadFrame,
    observed: Float[np.ndarray, "G N C"],
    length: Float[np.ndarray, "G N"],
    lanes: MergeLanes | None = None,
) -> Layout:
    """The layout for a group rule, from the states and lengths [m] observed at the take-over.

    `lanes` are those of a merge.
    """
    found = [road.line_at(float(d)) for d in observed[:, -1, _D]]
    lines = tuple(line for line in found if line is not None) or None
    if isinstance(rule, CarFollowing):
        return LongitudinalLayout(model_offsets(length), observed[..., _D], lines)
    # The leader keeps to the centre of the target lane.
    offsets, target, side = model_offsets(length, PlanarLayout.order), observed[:, 2:, _D], lanes.side if lanes else 1
    ramp = RampPath(lanes.path, lanes.source.end, lanes.target.width) if lanes and lanes.path else None
    return PlanarLayout(offsets, target, road, side, lines, ramp)


def _driven(lines: tuple[LaneLine, ...] | None, s: Float[np.ndarray, "*T G N"]) -> Float[np.ndarray, "*T G N"]:
    """The distance along the line of each group."""
    return s if lines is None else np.stack([line.driven(of) for line, of in zip(lines, s, strict=True)])


def _s_at(lines: tuple[LaneLine, ...] | None, distance: Float[np.ndarray, "G N"]) -> Float[np.ndarray, "G N"]:
    """s [m] at a distance along the line of each group."""
    return distance if lines is None else np.stack([line.s_at(of) for line, of in zip(lines, distance, strict=True)])


def _wrapped(angle: Float[np.ndarray, "*T G N"]) -> Float[np.ndarray, "*T G N"]:
    """The same angle in [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
