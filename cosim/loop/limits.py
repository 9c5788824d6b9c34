"""Limits on a policy's actions, and their use: what becomes of an action, and how often and how hard it was changed."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from cosim.world.episode import FilterUse
from gri.core.dynamics import Dynamics

NOTABLE = 0.05  # [m/s²], from which on a changed acceleration counts
LATERAL_ACCELERATION = 5.0  # [m/s²] at most where lateral motion is stopped
SLOWEST = 1.0  # [m/s], below which headings are not changed


@dataclass(frozen=True)
class Limits:
    """The greatest acceleration [m/s²] of the next step (inf: none), and a lateral speed to the left (NaN: none)."""

    along: Float[np.ndarray, "G 3"]
    across: Float[np.ndarray, "G 3"]


@dataclass(frozen=True)
class Limited:
    """Actions within limits: `action`, by how much the acceleration was reduced [m/s²], and where steering changed."""

    action: Float[np.ndarray, "G 3 A"]
    reduced: Float[np.ndarray, "G 3"]
    steered: Bool[np.ndarray, "G 3"]


def planned_across(
    state: Float[np.ndarray, "G 3 D"], action: Float[np.ndarray, "G 3 A"], dynamics: Dynamics, side: int, dt: float
) -> Float[np.ndarray, "G 3"]:
    """The lateral speed [m/s] to the left to which an action leads; 0 for a vehicle that cannot steer."""
    if "heading" not in dynamics.state:
        return np.zeros(state.shape[:2])
    heading, yaw_rate = (state[..., dynamics.index(name)] for name in ("heading", "yaw_rate"))
    later = heading + yaw_rate * dt + (yaw_rate + action[..., 1] * dt) * dt
    return side * state[..., dynamics.speed] * np.sin(later)


def within(
    limits: Limits,
    state: Float[np.ndarray, "G 3 D"],
    action: Float[np.ndarray, "G 3 A"],
    dynamics: Dynamics,
    side: int,
    dt: float,
) -> Limited:
    """The actions within the limits; `side` is −1 where the model's lateral axis points to the right.

    The first action is the jerk. Where the lateral speed is limited, the yaw rate of the next step turns the vehicle to
    the heading of that speed.
    """
    changed = action.copy()
    a = state[..., dynamics.index("a")]
    following = a + action[..., 0] * dt
    reduced = np.maximum(following - limits.along, 0.0)
    changed[..., 0] = np.where(reduced > 0, (limits.along - a) / dt, action[..., 0])
    reduced = np.where(reduced > NOTABLE, reduced, 0.0)
    if "heading" not in dynamics.state:
        return Limited(changed, reduced, np.zeros(reduced.shape, dtype=bool))
    heading, yaw_rate = (state[..., dynamics.index(name)] for name in ("heading", "yaw_rate"))
    v = np.maximum(state[..., dynamics.speed], SLOWEST)
    steered = ~np.isnan(limits.across)
    wanted = np.arcsin(np.clip(side * np.where(steered, limits.across, 0.0) / v, -0.3, 0.3))
    turn = np.clip((wanted - heading - yaw_rate * dt) / dt, -LATERAL_ACCELERATION / v, LATERAL_ACCELERATION / v)
    changed[..., 1] = np.where(steered, (turn - yaw_rate) / dt, action[..., 1])
    return Limited(changed, reduced, steered)


class FilterRecord:
    """How the safety filter changed the actions of the driven vehicles, step by step."""

    def __init__(self) -> None:
        self._steps: list[tuple[float, Limited]] = []

    def add(self, time: float, limited: Limited) -> None:
        """Add the decision at `time` [s]."""
        self._steps.append((time, limited))

    def of(self, group: int, roles: list[int], end: float) -> FilterUse:
        """The use in one group up to its `end` [s]."""
        kept = [limited for time, limited in self._steps if time < end - 1e-6]
        reduced = np.array([limited.reduced[group, roles] for limited in kept])
        steered = np.array([limited.steered[group, roles] for limited in kept])
        if not kept:
            return FilterUse(0.0, 0.0, 0.0)
        return FilterUse(float((reduced > 0).mean()), float(steered.mean()), float(reduced.max()))
