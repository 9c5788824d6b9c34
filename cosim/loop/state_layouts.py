"""Conversion between the world's road frame and the states of a policy's dynamics; one layout per dynamics.

In model states every vehicle ahead counts as `NOMINAL_LENGTH` long (`cosim.world.road_frame.model_offsets`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cosim.spec.scenario import CarFollowing, GroupRule
from cosim.world.episode import COLUMNS
from cosim.world.road_frame import RoadFrame, model_offsets
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

    `offset` [m] is added to s to get x, `lateral` [m] are the lateral positions d.
    """

    offset: Float[np.ndarray, "G 3"]
    lateral: Float[np.ndarray, "G 3"]
    dynamics: Dynamics = POINT_MASS_1D

    def states(self, observed: Float[np.ndarray, "G 3 C"]) -> Float[np.ndarray, "G 3 3"]:
        """Model states (float64) of vehicles with the features of COLUMNS."""
        states = observed[..., [_S, _V, _A]]
        states[..., 0] += self.offset
        return states

    def pose(self, state: Float[np.ndarray, "G 3 3"]) -> Pose:
        """The poses of model states."""
        x, v, a = (state[..., feature] for feature in range(3))
        return Pose(x - self.offset, self.lateral, np.zeros(x.shape), v, a)


@dataclass(frozen=True)
class PlanarLayout:
    """States [x, y, v, θ, a, ω] of Dubins' car; y counts from the centre of the target lane, θ from the road.

    A curved road is treated as straight: positions are arc length and lateral offset. That is exact on straight roads;
    on a bend of radius R, distances at the lateral position d are wrong by the factor 1 − d/R. SUMO has no yaw rate, so
    that of the vehicles that it drives is 0.
    """

    offset: Float[np.ndarray, "G 3"]
    target: Float[np.ndarray, "G 1"]
    """d [m] of the centre of the target lane."""
    road: RoadFrame
    dynamics: Dynamics = DUBINS

    def states(self, observed: Float[np.ndarray, "G 3 C"]) -> Float[np.ndarray, "G 3 6"]:
        """Model states (float64) of vehicles with the features of COLUMNS."""
        s = observed[..., _S]
        heading = _wrapped(observed[..., _HEADING] - self.road.heading_at(s.ravel()).reshape(s.shape))
        features = [s + self.offset, observed[..., _D] - self.target, observed[..., _V], heading, observed[..., _A]]
        return np.stack([*features, np.zeros_like(s)], -1)

    def pose(self, state: Float[np.ndarray, "G 3 6"]) -> Pose:
        """The poses of model states."""
        x, y, v, heading, a, _ = (state[..., feature] for feature in range(6))
        return Pose(x - self.offset, y + self.target, heading, v, a)


Layout = LongitudinalLayout | PlanarLayout


def layout_of(
    rule: GroupRule, road: RoadFrame, observed: Float[np.ndarray, "G 3 C"], length: Float[np.ndarray, "G 3"]
) -> Layout:
    """The layout for a group rule, from the states and lengths [m] observed at the take-over."""
    if isinstance(rule, CarFollowing):
        return LongitudinalLayout(model_offsets(length), observed[..., _D])
    # From the rear to the front: lag vehicle, merger, leader. The leader keeps to the centre of the target lane.
    return PlanarLayout(model_offsets(length, order=(1, 0, 2)), observed[:, 2:, _D], road)


def _wrapped(angle: Float[np.ndarray, "G 3"]) -> Float[np.ndarray, "G 3"]:
    """The same angle in [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
