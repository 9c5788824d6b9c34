"""Conversion between the world's road frame and the states of a policy's dynamics; one layout per dynamics.

In model states every vehicle ahead counts as `NOMINAL_LENGTH` long (`cosim.world.road_frame.model_offsets`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cosim.spec.scenario import CarFollowing, GroupRule
from cosim.world.episode import COLUMNS
from cosim.world.road_frame import LaneLine, RoadFrame, model_offsets
from gri.core.dynamics import DUBINS, POINT_MASS_1D, Dynamics

_S, _D, _HEADING, _V, _A = (COLUMNS.index(name) for name in ("s", "d", "heading", "v", "a"))


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

    def states(self, observed: Float[np.ndarray, "G N C"]) -> Float[np.ndarray, "G N 3"]:
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
    dynamics: Dynamics = DUBINS

    def states(self, observed: Float[np.ndarray, "G N C"]) -> Float[np.ndarray, "G N 6"]:
        """Model states (float64) of vehicles with the features of COLUMNS."""
        s = observed[..., _S]
        turn = self.road.side * (observed[..., _HEADING] - self.road.heading_at(s.ravel()).reshape(s.shape))
        x, y, heading = _driven(self.lines, s) + self.offset, observed[..., _D] - self.target, _wrapped(turn)
        features = [x, self.side * y, observed[..., _V], self.side * heading, observed[..., _A]]
        return np.stack([*features, np.zeros_like(s)], -1)

    def pose(self, state: Float[np.ndarray, "G N 6"]) -> Pose:
        """The poses of model states."""
        x, y, v, heading, a, _ = (state[..., feature] for feature in range(6))
        return Pose(_s_at(self.lines, x - self.offset), self.side * y + self.target, self.side * heading, v, a)

    def in_bends(
        self, before: Float[np.ndarray, "G N 6"], after: Float[np.ndarray, "G N 6"]
    ) -> Float[np.ndarray, "G N 6"]:
        """The states after a step, with the way along x that a vehicle at y drives in it."""
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
    side: int = 1,
) -> Layout:
    """The layout for a group rule, from the states and lengths [m] observed at the take-over.

    `side` is that of the target lane of a merge.
    """
    found = [road.line_at(float(d)) for d in observed[:, -1, _D]]
    lines = tuple(line for line in found if line is not None) or None
    if isinstance(rule, CarFollowing):
        return LongitudinalLayout(model_offsets(length), observed[..., _D], lines)
    # From the rear to the front: lag vehicle, merger, leader. The leader keeps to the centre of the target lane.
    return PlanarLayout(model_offsets(length, order=(1, 0, 2)), observed[:, 2:, _D], road, side, lines)


def _driven(lines: tuple[LaneLine, ...] | None, s: Float[np.ndarray, "G N"]) -> Float[np.ndarray, "G N"]:
    """The distance along the line of each group."""
    return s if lines is None else np.stack([line.driven(of) for line, of in zip(lines, s, strict=True)])


def _s_at(lines: tuple[LaneLine, ...] | None, distance: Float[np.ndarray, "G N"]) -> Float[np.ndarray, "G N"]:
    """s [m] at a distance along the line of each group."""
    return distance if lines is None else np.stack([line.s_at(of) for line, of in zip(lines, distance, strict=True)])


def _wrapped(angle: Float[np.ndarray, "G N"]) -> Float[np.ndarray, "G N"]:
    """The same angle in [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
