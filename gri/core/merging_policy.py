"""A merging driver that needs no training: IDM along the road, gap acceptance and lane keeping across it."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from gri.core.dynamics import DUBINS, Dynamics
from gri.core.policy import IntelligentDriver, PolicyState
from gri.core.trajectory import Trajectory


@dataclass(frozen=True)
class MergingDriver:
    """Vehicles right of the target lane (y < −width/2, its centre at y = 0) change to it when the gap is safe.

    Everybody follows the next vehicle ahead in the target lane by `driver`; who is in the target lane also makes room
    for one who is about to merge ahead, braking up to `courtesy`. A merger starts to move over when it has
    `smallest_gap` to both neighbours there and neither it nor the one behind would have to brake harder than
    `safe_deceleration` (the safety criterion of MOBIL, Kesting et al. 2007); else it stays in its lane. Across the road
    the wanted lateral speed is `lateral_gain`·(y* − y), at most `lateral_speed`, and the heading follows with
    `heading_gain`.
    """

    driver: IntelligentDriver
    width: float = 3.66  # [m], of a lane
    smallest_gap: float = 1.0  # [m], net
    safe_deceleration: float = 3.0  # [m/s^2]
    courtesy: float = 2.0  # [m/s^2]
    lateral_speed: float = 1.2  # [m/s]
    lateral_gain: float = 0.7  # [1/s]
    heading_gain: float = 2.5  # [1/s]
    greatest_heading: float = 0.2  # [rad]
    dynamics: Dynamics = DUBINS
    history_steps: int = 1

    @property
    def dt(self) -> float:
        return self.driver.dt

    def begin(self, history: Trajectory) -> PolicyState:
        return PolicyState(None, history.state.new_zeros(*history.state.shape[:2], 0))

    def act(self, memory: PolicyState, state: Float[Tensor, "B N 6"]) -> tuple[Float[Tensor, "B N 2"], PolicyState]:
        x, y, v, heading, a, yaw_rate = state.unbind(-1)
        there = y > -0.5 * self.width
        ahead = x[:, None, :] - x[:, :, None]  # Shape: (B, vehicle, other)
        distance = torch.where(there[:, None, :], ahead, torch.nan)
        target, headway = self._following(distance, v)
        with_mergers, _ = self._following(ahead, v)
        making_room = torch.minimum(target, with_mergers.clamp(min=-self.courtesy))
        target = torch.where(there, making_room, target)
        safe = self._safe(distance, v, headway) & (target >= -self.safe_deceleration)
        wanted_y = torch.where(there | safe, torch.zeros_like(y), -self.width)
        lateral = (self.lateral_gain * (wanted_y - y)).clamp(-self.lateral_speed, self.lateral_speed)
        wanted_heading = torch.asin((lateral / v.clamp(min=1.0)).clamp(-0.9, 0.9))
        wanted_heading = wanted_heading.clamp(-self.greatest_heading, self.greatest_heading)
        wanted_yaw = self.heading_gain * (wanted_heading - heading)
        return torch.stack([target - a, wanted_yaw - yaw_rate], -1) / self.dt, memory

    def _following(
        self, ahead: Float[Tensor, "B N N"], v: Float[Tensor, "B N"]
    ) -> tuple[Float[Tensor, "B N"], Float[Tensor, "B N"]]:
        """Acceleration behind the nearest vehicle ahead, and the headway to it."""
        headway, leader = torch.where(ahead > 0, ahead, torch.inf).min(-1)
        return self.driver.target_acceleration(v, v.gather(1, leader), headway), headway

    def _safe(
        self, distance: Float[Tensor, "B N N"], v: Float[Tensor, "B N"], headway: Float[Tensor, "B N"]
    ) -> Bool[Tensor, "B N"]:
        """Whether a vehicle finds room in the target lane, and the one behind it there can take it."""
        behind, follower = torch.where(distance <= 0, -distance, torch.inf).min(-1)
        needed = self.driver.length + self.smallest_gap
        braking = self.driver.target_acceleration(v.gather(1, follower), v, behind)
        alone = torch.isinf(behind)
        return (headway >= needed) & (alone | ((behind >= needed) & (braking >= -self.safe_deceleration)))
