"""What the two ranges of merges have in common: roles, lanes and the layout of states.

Vehicle 0 merges. Vehicle 1 is the lag vehicle in the target lane, and vehicle 2 is the leader in that lane. The road is
straight along x, and y counts to the left. The target lane has its centre at y = 0. The lane of vehicle 0 is to the
right of it. Positions are relative to the start of the leader.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import DynamicsName
from gri.core.graph import LANE_CHANGING, Vocabulary

VEHICLE_LENGTH = 5.0
"""Length of every vehicle [m]: headway − `VEHICLE_LENGTH` = net gap (docs/decisions/002-nominal-length.md)."""


class MergeRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Dynamics and edge types of merges (Sec. VI-C)."""

    @property
    def dynamics(self) -> DynamicsName:
        """Dubins' car: states [x, y, v, θ, a, ω]."""
        return DynamicsName.DUBINS

    @property
    def vocabulary(self) -> Vocabulary:
        """None, follow, yield and cut-in."""
        return LANE_CHANGING


def straight_states(
    x: Float[Tensor, "*batch"],
    y: Float[Tensor, "*batch"],
    v: Float[Tensor, "*batch"],
    a: Float[Tensor, "*batch"] | None = None,
) -> Float[Tensor, "*batch 6"]:
    """States [x, y, v, θ, a, ω] of vehicles that drive along their lane: θ = ω = 0, and a = 0 unless it is given."""
    zero = torch.zeros_like(x)
    return torch.stack([x, y, v, zero, zero if a is None else a, zero], -1)
