"""Vehicles near a group that belong to no group: what a policy sees of the traffic around the vehicles it drives."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

OWN_WIDTH = 1.8  # [m], of a vehicle of a group


@dataclass(frozen=True)
class Nearby:
    """Up to M vehicles near each of B groups of N vehicles; which of the M are there is in `present`.

    Distances are from the vehicle of the group to the other one. They need no common frame.
    """

    ahead: Float[Tensor, "B N M"]
    """From front to front along the road [m]; negative where the other is behind."""
    across: Float[Tensor, "B N M"]
    """Between the centres across the road [m]; positive where the other is to the left, as in the states of the group
    (the side of the target lane, in a merge). Lanes are 3 to 3.7 m wide."""
    v: Float[Tensor, "B M"]
    """Speed [m/s]."""
    length: Float[Tensor, "B M"]
    """[m]"""
    width: Float[Tensor, "B M"]
    """[m]"""
    present: Bool[Tensor, "B M"]
    lane_left: Float[Tensor, "B N"] | None = None
    """From the front of each vehicle of the group to the end of the lane that ends [m]; None where none ends."""

    def repeated(self, times: int) -> "Nearby":
        """The same for groups that are listed so many times in a row, all groups once, then again."""
        fields = ("ahead", "across", "v", "length", "width", "present")
        left = None if self.lane_left is None else torch.cat([self.lane_left] * times)
        return Nearby(*(torch.cat([getattr(self, name)] * times) for name in fields), lane_left=left)

    def next_ahead(self) -> tuple[Float[Tensor, "B N"], Float[Tensor, "B N"]]:
        """Net gap [m] to the next vehicle ahead in the path of each vehicle of the group, and its speed [m/s].

        In the path are those that overlap it across the road. The gap is inf, and the speed 0, where none is.
        """
        in_path = self.across.abs() < 0.5 * (self.width + OWN_WIDTH)[:, None]
        in_path = in_path & (self.ahead > 0) & self.present[:, None]
        gaps = torch.where(in_path, self.ahead - self.length[:, None], torch.inf)
        if not gaps.shape[-1]:
            return gaps.new_full(gaps.shape[:2], torch.inf), gaps.new_zeros(gaps.shape[:2])
        gap, which = gaps.min(-1)
        return gap, torch.where(gap.isfinite(), self.v.gather(1, which), torch.zeros_like(gap))
