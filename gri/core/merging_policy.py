"""A merging policy that needs no training: IDM along the road, gap acceptance and lane keeping across it."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import DUBINS, Dynamics
from gri.core.nearby import Nearby
from gri.core.policy import IntelligentDriver, PolicyState
from gri.core.trajectory import Trajectory

LATERAL_GAIN_PER_ACTION, HEADING_GAIN_PER_ACTION = 0.18, 0.5
"""Upper limits of gain·Δt. With them a lane change at 5 to 33 m/s overshoots by less than 0.2 m for Δt up to 1 s."""


@dataclass(frozen=True)
class MergingDriver:
    """Vehicles to the right of the target lane change into it when the gap is safe.

    The centre of the target lane is at y = 0; a vehicle with y < −width/2 is to the right of it. Every vehicle follows
    the next vehicle ahead in the target lane by `driver`. A vehicle in the target lane also brakes, up to `courtesy`,
    for a vehicle ahead that is still in the right lane. A merging vehicle starts its lane change if it has
    `smallest_gap` to both neighbours in the target lane, and if neither it nor the lag vehicle would have to brake
    harder than `safe_deceleration` (the safety criterion of MOBIL, Kesting et al. 2007). Else it stays in its lane.
    The desired lateral speed is `lateral_gain`·(y* − y), at most `lateral_speed`. The heading follows with
    `heading_gain`. Both gains are smaller where the time between two actions is long, so that the car does not swing.
    """

    driver: IntelligentDriver
    width: float = 3.66
    """Width of a lane [m]."""
    smallest_gap: float = 1.0
    """Least net gap to both neighbours [m]."""
    safe_deceleration: float = 3.0
    """[m/s²]."""
    courtesy: float = 2.0
    """Largest deceleration for a vehicle that still has to merge [m/s²]."""
    lateral_speed: float = 1.2
    """[m/s]."""
    lateral_gain: float = 0.7
    """[1/s]."""
    heading_gain: float = 2.5
    """[1/s]."""
    greatest_heading: float = 0.2
    """[rad]."""
    dynamics: Dynamics = DUBINS
    history_steps: int = 1

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        return self.driver.dt

    @property
    def sees_nearby(self) -> bool:
        """Whether it also follows vehicles in its path that are not in the group."""
        return self.driver.sees_nearby

    def begin(self, history: Trajectory) -> PolicyState:
        """Nothing to infer."""
        return PolicyState.empty(history)

    def act(
        self, memory: PolicyState, state: Float[Tensor, "B N 6"], nearby: Nearby | None = None
    ) -> tuple[Float[Tensor, "B N 2"], PolicyState]:
        """Jerk and yaw acceleration of every vehicle."""
        x, y, v, heading, a, yaw_rate = state.unbind(-1)
        merged = y > -0.5 * self.width
        ahead = x[:, None, :] - x[:, :, None]  # Shape: (B, vehicle, other)
        distance = torch.where(merged[:, None, :], ahead, torch.nan)
        target, headway = self._following(distance, v)
        with_mergers, _ = self._following(ahead, v)
        yielding = torch.minimum(target, with_mergers.clamp(min=-self.courtesy))
        target = torch.where(merged, yielding, target)
        if nearby is not None:
            target = torch.minimum(target, self.driver.behind_others(v, nearby))
        safe = self._safe(distance, v, headway) & (target >= -self.safe_deceleration)
        desired_y = torch.where(merged | safe, torch.zeros_like(y), -self.width)
        desired_yaw_rate = self.yaw_rate_to(desired_y, y, v, heading)
        return torch.stack([target - a, desired_yaw_rate - yaw_rate], -1) / self.dt, memory

    def yaw_rate_to(
        self,
        desired_y: Float[Tensor, "*batch"],
        y: Float[Tensor, "*batch"],
        v: Float[Tensor, "*batch"],
        heading: Float[Tensor, "*batch"],
    ) -> Float[Tensor, "*batch"]:
        """The yaw rate [rad/s] that brings a vehicle to a lateral position [m]."""
        lateral = (min(self.lateral_gain, LATERAL_GAIN_PER_ACTION / self.dt) * (desired_y - y)).clamp(
            -self.lateral_speed, self.lateral_speed
        )
        desired_heading = torch.asin((lateral / v.clamp(min=1.0)).clamp(-0.9, 0.9))
        desired_heading = desired_heading.clamp(-self.greatest_heading, self.greatest_heading)
        return min(self.heading_gain, HEADING_GAIN_PER_ACTION / self.dt) * (desired_heading - heading)

    def _following(
        self, ahead: Float[Tensor, "B N N"], v: Float[Tensor, "B N"]
    ) -> tuple[Float[Tensor, "B N"], Float[Tensor, "B N"]]:
        """Acceleration behind the nearest vehicle ahead [m/s²], and the headway to it [m]; infinite if there is none.

        `ahead` [m] is the headway from each vehicle to each other, nan where the other does not count.
        """
        headway, leader = torch.where(ahead > 0, ahead, torch.inf).min(-1)
        return self.driver.target_acceleration(v, v.gather(1, leader), headway), headway

    def _safe(
        self, distance: Float[Tensor, "B N N"], v: Float[Tensor, "B N"], headway: Float[Tensor, "B N"]
    ) -> Bool[Tensor, "B N"]:
        """Whether the gap in the target lane is large enough, and the lag vehicle there need not brake too hard."""
        behind, follower = torch.where(distance <= 0, -distance, torch.inf).min(-1)
        needed = self.driver.length + self.smallest_gap
        braking = self.driver.target_acceleration(v.gather(1, follower), v, behind)
        alone = torch.isinf(behind)
        return (headway >= needed) & (alone | ((behind >= needed) & (braking >= -self.safe_deceleration)))
