"""Limits on a policy's actions, and their use: what becomes of an action, and how often and how hard it was changed."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from cosim.loop.state_layouts import Layout, PlanarLayout
from cosim.world.episode import FilterUse

NOTABLE = 0.05  # [m/s²], from which on a changed acceleration counts
LATERAL_ACCELERATION = 3.0  # [m/s²] at most where the filter steers
SLOWEST = 1.0  # [m/s], below which a lateral speed asks for no greater heading
LATERAL_GAIN, HEADING_GAIN = 0.8, 2.5  # [1/s]
LATERAL_SPEED, GREATEST_HEADING = 1.2, 0.2  # [m/s], [rad]


@dataclass(frozen=True)
class Limits:
    """The greatest and least acceleration [m/s²] of the next step, and the lateral position d [m] to steer to.

    Where that `place` is NaN, the policy steers. The greatest acceleration counts if both contradict each other.
    `turned` are the greatest headings [rad] to the left and to the right, whoever steers; None: any.
    """

    along: Float[np.ndarray, "G N"]
    place: Float[np.ndarray, "G N"]
    least: Float[np.ndarray, "G N"]
    turned: tuple[Float[np.ndarray, "G N"], Float[np.ndarray, "G N"]] | None = None


@dataclass(frozen=True)
class Limited:
    """Actions within limits: `action`, by how much the acceleration changed [m/s²], and where steering changed."""

    action: Float[np.ndarray, "G N A"]
    changed: Float[np.ndarray, "G N"]
    steered: Bool[np.ndarray, "G N"]


def planned_across(
    state: Float[np.ndarray, "G N D"], action: Float[np.ndarray, "G N A"], layout: Layout, dt: float
) -> Float[np.ndarray, "G N"]:
    """The lateral speed [m/s] to the left to which an action leads; 0 for a vehicle that cannot steer."""
    if not isinstance(layout, PlanarLayout):
        return np.zeros(state.shape[:2])
    dynamics = layout.dynamics
    heading, yaw_rate = (state[..., dynamics.index(name)] for name in ("heading", "yaw_rate"))
    later = heading + yaw_rate * dt + (yaw_rate + action[..., 1] * dt) * dt
    return layout.side * state[..., dynamics.speed] * np.sin(later)


def within(
    limits: Limits, state: Float[np.ndarray, "G N D"], action: Float[np.ndarray, "G N A"], layout: Layout, dt: float
) -> Limited:
    """The actions within the limits. The first action is the jerk."""
    new, dynamics = action.copy(), layout.dynamics
    a = state[..., dynamics.index("a")]
    following = a + action[..., 0] * dt
    allowed = np.minimum(np.maximum(following, limits.least), limits.along)
    new[..., 0] = np.where(allowed != following, (allowed - a) / dt, action[..., 0])
    changed = np.abs(allowed - following)
    changed = np.where(changed > NOTABLE, changed, 0.0)
    if not isinstance(layout, PlanarLayout):
        return Limited(new, changed, np.zeros(changed.shape, dtype=bool))
    steered = ~np.isnan(limits.place)
    new[..., 1] = np.where(steered, _yaw_acceleration_to(limits.place, state, layout, dt), action[..., 1])
    if limits.turned is not None:
        left, right = limits.turned if layout.side > 0 else limits.turned[::-1]
        heading, yaw_rate = (state[..., dynamics.index(name)] for name in ("heading", "yaw_rate"))
        decided = heading + yaw_rate * dt
        wanted = yaw_rate + new[..., 1] * dt
        turn = np.clip(wanted, (-right - decided) / dt, (left - decided) / dt)
        steered = steered | (turn != wanted)
        new[..., 1] = np.where(turn != wanted, (turn - yaw_rate) / dt, new[..., 1])
    return Limited(new, changed, steered)


def _yaw_acceleration_to(
    place: Float[np.ndarray, "G N"], state: Float[np.ndarray, "G N 6"], layout: PlanarLayout, dt: float
) -> Float[np.ndarray, "G N"]:
    """The yaw acceleration [rad/s²] that brings a vehicle to the place, without swinging.

    The lateral speed is proportional to the way that is left, the yaw rate to the heading that is missing. The heading
    of the next step is decided already.
    """
    y, heading, yaw_rate = (state[..., layout.dynamics.index(name)] for name in ("y", "heading", "yaw_rate"))
    v = np.maximum(state[..., layout.dynamics.speed], SLOWEST)
    left = layout.side * (np.where(np.isnan(place), 0.0, place) - layout.target) - y
    lateral = np.clip(LATERAL_GAIN * left, -LATERAL_SPEED, LATERAL_SPEED)
    wanted = np.clip(np.arcsin(np.clip(lateral / v, -1.0, 1.0)), -GREATEST_HEADING, GREATEST_HEADING)
    greatest = LATERAL_ACCELERATION / v
    turn = np.clip(HEADING_GAIN * (wanted - heading - yaw_rate * dt), -greatest, greatest)
    return (turn - yaw_rate) / dt


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
        changed = np.array([limited.changed[group, roles] for limited in kept])
        steered = np.array([limited.steered[group, roles] for limited in kept])
        if not kept:
            return FilterUse(0.0, 0.0, 0.0)
        return FilterUse(float((changed > 0).mean()), float(steered.mean()), float(changed.max()))
