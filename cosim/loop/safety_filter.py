"""A filter of any policy's actions after RSS: a safe distance along the road, no move into an occupied place across it.

RSS (Shalev-Shwartz et al. 2017) asks for the distance at which a vehicle can still stop behind one that brakes at its
hardest. Here the response time is that of the loop: an action changes the acceleration of the next step and the speed
of the one after it. Until then the present acceleration goes on, so RSS's a_max is what the vehicle really does.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from cosim.loop.limits import Limits
from cosim.loop.near_vehicles import NearVehicles
from cosim.spec.scenario import RssFilter

SIDE_MARGIN = 0.1  # [m]; vehicles less apart across the road count as in each other's path
LOOK_AHEAD = 1.0  # [s] in which a vehicle that moves over counts as in the path
BESIDE = 1.0  # [m] along the road before and behind a vehicle in which its place is occupied
COMFORTABLE = 4.0  # [m/s²] at most for a vehicle that is not in the path yet, and of a vehicle behind
BEHIND_RESPONSE = 0.5  # [s] of a vehicle behind
MOVING = 0.05  # [m/s] across the road
AWAY = 0.5  # [m/s] away from a vehicle that is closer than TOO_CLOSE across the road
TOO_CLOSE = 0.4  # [m]


@dataclass(frozen=True)
class SafetyFilter:
    """The filter with its parameters; `dt` [s] is the step of the loop."""

    rss: RssFilter
    dt: float

    def limits(self, near: NearVehicles, planned_across: Float[np.ndarray, "G 3"]) -> Limits:
        """The greatest accelerations, and where lateral motion must stop.

        `planned_across` [m/s] is the lateral speed to the left that the policy wants.
        """
        side, direction = near.side_gap, near.direction
        closing = direction * (near.across[..., None] - near.across_of)
        in_path = side < SIDE_MARGIN
        entering = ~in_path & (closing > MOVING) & (side < closing * LOOK_AHEAD) & (near.gap_ahead > 0)
        limit = self.greatest_acceleration(near)
        milder = np.where(in_path, limit, np.maximum(limit, -COMFORTABLE))
        along = np.where(near.ahead & (in_path | entering), milder, np.inf).min(-1)
        towards = direction * np.maximum(direction * planned_across[..., None], direction * near.across[..., None])
        wanted = direction * towards
        reach = self.rss.margin_across + np.maximum(wanted, 0) * LOOK_AHEAD
        blocked = near.other & (wanted > MOVING) & (side >= 0) & (side < reach) & self._occupied(near, limit)
        closest = np.where(blocked, side, np.inf)
        away = np.take_along_axis(direction, closest.argmin(-1)[..., None], -1)[..., 0]
        across = np.where(closest.min(-1) < TOO_CLOSE, -AWAY * away, 0.0)
        return Limits(along, np.where(blocked.any(-1), across, np.nan))

    def greatest_acceleration(self, near: NearVehicles) -> Float[np.ndarray, "G 3 V"]:
        """The acceleration [m/s²] of the next step after which the vehicle can still stop behind each vehicle ahead.

        With gap g, speed v and acceleration a, v₁ = v + a·Δt is the speed of the next step whatever is decided. The
        speed v₂ after it must fulfil v·Δt + v₁·Δt + v₂·Δt/2 + v₂²/(2b) ≤ g − margin + v_o²/(2b_o).
        """
        v, v_1 = near.pose.v[..., None], np.maximum(near.pose.v + near.pose.a * self.dt, 0.0)[..., None]
        b, dt = self.rss.braking, self.dt
        room = near.gap_ahead - self.rss.margin + near.v**2 / (2 * self.rss.other_braking) - (v + v_1) * dt
        v_2 = b * (np.sqrt(dt**2 / 4 + 2 * np.maximum(room, 0.0) / b) - dt / 2)
        return np.maximum((v_2 - v_1) / dt, -b)

    def _occupied(self, near: NearVehicles, limit: Float[np.ndarray, "G 3 V"]) -> Bool[np.ndarray, "G 3 V"]:
        """Whether the place beside the vehicle belongs to another one: beside it, or too close ahead or behind."""
        v = near.pose.v[..., None]
        beside = (near.gap_ahead < BESIDE) & (near.gap_behind < BESIDE)
        too_close_ahead = near.ahead & (limit < -COMFORTABLE)
        needed = near.v * BEHIND_RESPONSE + np.maximum(near.v**2 - v**2, 0.0) / (2 * COMFORTABLE) + self.rss.margin
        too_close_behind = ~near.ahead & (near.gap_behind < needed)
        return beside | too_close_ahead | too_close_behind
