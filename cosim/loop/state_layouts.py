"""Between the world's road frame and the states that a policy's dynamics move; one layout per dynamics.

A model state counts every vehicle ahead as `NOMINAL_LENGTH` long (`cosim.world.road_frame.model_offsets`).
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
    """Where vehicles are in the road frame: s, d [m], heading relative to the road [rad], v [m/s], a [m/s²]."""

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
class Along:
    """[x, v, a] of a 1-D point mass; vehicles keep the lateral position they were taken at."""

    offset: Float[np.ndarray, "G 3"]
    lateral: Float[np.ndarray, "G 3"]
    dynamics: Dynamics = POINT_MASS_1D

    def states(self, seen: Float[np.ndarray, "G 3 C"]) -> Float[np.ndarray, "G 3 3"]:
        """Model states (float64) of vehicles with the features of COLUMNS."""
        states = seen[..., [_S, _V, _A]]
        states[..., 0] += self.offset
        return states

    def pose(self, state: Float[np.ndarray, "G 3 3"]) -> Pose:
        """Where the dynamics put the vehicles."""
        x, v, a = (state[..., feature] for feature in range(3))
        return Pose(x - self.offset, self.lateral, np.zeros(x.shape), v, a)


@dataclass(frozen=True)
class InPlane:
    """[x, y, v, θ, a, ω] of Dubins' car; y counts from the centre of the target lane, θ from the road.

    A curved road is rolled out straight: positions are arc length and offset, which is exact on straight roads and
    short by the factor 1 − d/R on a bend of radius R. Nobody but the dynamics knows a yaw rate; that of vehicles
    which SUMO drives counts as 0, as they keep to their lane's direction.
    """

    offset: Float[np.ndarray, "G 3"]
    target: Float[np.ndarray, "G 1"]
    """d [m] of the centre of the target lane."""
    road: RoadFrame
    dynamics: Dynamics = DUBINS

    def states(self, seen: Float[np.ndarray, "G 3 C"]) -> Float[np.ndarray, "G 3 6"]:
        """Model states (float64) of vehicles with the features of COLUMNS."""
        s = seen[..., _S]
        heading = _wrapped(seen[..., _HEADING] - self.road.heading_at(s.ravel()).reshape(s.shape))
        features = [s + self.offset, seen[..., _D] - self.target, seen[..., _V], heading, seen[..., _A]]
        return np.stack([*features, np.zeros_like(s)], -1)

    def pose(self, state: Float[np.ndarray, "G 3 6"]) -> Pose:
        """Where the dynamics put the vehicles."""
        x, y, v, heading, a, _ = (state[..., feature] for feature in range(6))
        return Pose(x - self.offset, y + self.target, heading, v, a)


Layout = Along | InPlane


def layout_of(
    rule: GroupRule, road: RoadFrame, seen: Float[np.ndarray, "G 3 C"], length: Float[np.ndarray, "G 3"]
) -> Layout:
    """The layout a group rule is driven with, from what was seen at the take-over."""
    if isinstance(rule, CarFollowing):
        return Along(model_offsets(length), seen[..., _D])
    # From the rear to the front: lag vehicle, merger, leader. The leader keeps to the centre of the target lane.
    return InPlane(model_offsets(length, order=(1, 0, 2)), seen[:, 2:, _D], road)


def _wrapped(angle: Float[np.ndarray, "G 3"]) -> Float[np.ndarray, "G 3"]:
    """The same angle in [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
