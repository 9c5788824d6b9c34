"""Constants of drivers that are learned: time headway, standstill gap, comfort, wished speed and the others."""

import msgspec
import torch
from torch import Tensor, nn

from gri.rewards.car_following_features import FollowingConstants

NAMES = FollowingConstants.__struct_fields__
"""Names of the constants, in the order of `LearnedConstants.log_ratio`."""


class LearnedConstants(nn.Module):
    """The constants of `FollowingConstants` as first value × e^r, with one learned logarithm of a ratio r for each.

    All constants are positive, and a wrong first value is wrong by a factor; so the logarithm is the natural scale.
    It has the fields of `FollowingConstants`, as tensors, and takes its place in the features.
    """

    first: Tensor

    def __init__(self, first: FollowingConstants) -> None:
        super().__init__()
        self.register_buffer("first", torch.tensor(msgspec.structs.astuple(first)), persistent=False)
        self.log_ratio = nn.Parameter(torch.zeros(len(NAMES)))

    def values(self) -> dict[str, float]:
        """The present values by name, in SI units."""
        return dict(zip(NAMES, (self.first * self.log_ratio.detach().exp()).tolist(), strict=True))

    def _value(self, name: str) -> Tensor:
        place = NAMES.index(name)
        return self.first[place] * self.log_ratio[place].exp()

    @property
    def standstill(self) -> Tensor:
        """s0, the headway at standstill [m]."""
        return self._value("standstill")

    @property
    def time_headway(self) -> Tensor:
        """T_h, the time headway [s]."""
        return self._value("time_headway")

    @property
    def comfort(self) -> Tensor:
        """√(a·b) [m/s²]."""
        return self._value("comfort")

    @property
    def minimum(self) -> Tensor:
        """Least value of the desired headway [m]."""
        return self._value("minimum")

    @property
    def zeta(self) -> Tensor:
        """ζ, the range of the collision term [m]."""
        return self._value("zeta")

    @property
    def speed_limit(self) -> Tensor:
        """v_lim, the wished speed [m/s]."""
        return self._value("speed_limit")
