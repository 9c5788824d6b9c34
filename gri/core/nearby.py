"""Vehicles near a group that belong to no group: what a policy sees of the traffic around the vehicles it drives."""

from dataclasses import dataclass

import numpy as np
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
        across, ahead, length = self.across.numpy(), self.ahead.numpy(), self.length.numpy()
        if not ahead.shape[-1]:
            return self.ahead.new_full(ahead.shape[:2], np.inf), self.ahead.new_zeros(ahead.shape[:2])
        wide = np.float32(0.5) * (self.width.numpy() + np.float32(OWN_WIDTH))
        in_path = (np.abs(across) < wide[:, None]) & (ahead > 0) & self.present.numpy()[:, None]
        gaps = np.where(in_path, ahead - length[:, None], np.float32(np.inf))
        which = gaps.argmin(-1)
        batch, vehicle = np.ogrid[: len(gaps), : gaps.shape[1]]
        gap = gaps[batch, vehicle, which]
        v = np.where(np.isfinite(gap), self.v.numpy()[batch, which], np.float32(0))
        return torch.from_numpy(gap), torch.from_numpy(v)


@dataclass(frozen=True)
class NextAhead:
    """The next vehicle ahead of each of B groups of N vehicles, of those in its path that belong to no group."""

    gap: Float[np.ndarray, "B N"]
    """Net gap [m] to it; inf where there is none."""
    v: Float[np.ndarray, "B N"]
    """Its speed [m/s]."""

    @classmethod
    def of(cls, nearby: Nearby) -> "NextAhead":
        """The next of these vehicles."""
        gap, v = nearby.next_ahead()
        return cls(gap.numpy(), v.numpy())
