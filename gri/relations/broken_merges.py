"""Merges that are broken on purpose: some relations cannot hold in them, whatever drivers do.

They are the negative controls of the benchmark of merges, and what an encoder learns from not to recite where vehicles
are.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.relations.merge_motion import NOMINAL_LENGTH, motion_of

MERGER, LAG, LEADER = 0, 1, 2
X, Y, V = 0, 1, 2  # features of a state
ANY, FOLLOW, CUT_IN = (1, 2, 3), (1,), (3,)  # indices into `gri.core.edges.LANE_CHANGING`

Impossible = tuple[tuple[tuple[int, int], tuple[int, ...]], ...]
"""((i, j), types): relations of the pair i → j that no vehicle can have."""
DEAF_LAG: Impossible = (((MERGER, LAG), ANY), ((LEADER, LAG), ANY), ((LAG, MERGER), CUT_IN))
"""The lag vehicle reacts to nobody of the scene."""
OTHER_LANE: Impossible = (((MERGER, LAG), FOLLOW), ((LAG, MERGER), CUT_IN))
"""The merging vehicle never changes lanes."""


@dataclass(frozen=True)
class Merges:
    """S merges: vehicle 0 changes lanes between a lag vehicle (1) and a leader (2)."""

    state: Float[Tensor, "S 3 T D"]
    """x, y, v and more [m, m, m/s]."""
    length: Float[Tensor, "S 3"]
    """[m]; 0 where not known."""
    lane_width: float
    """[m]"""
    dt: float
    """[s]"""

    def __len__(self) -> int:
        return len(self.state)

    def __getitem__(self, scenes: Int[Tensor, " K"]) -> "Merges":
        return Merges(self.state[scenes], self.length[scenes], self.lane_width, self.dt)


def strangers(mean_speed: Float[Tensor, " S"], related: Bool[Tensor, "S S"]) -> Int[Tensor, " S"]:
    """For each scene another, unrelated one whose lag vehicle has the nearest mean speed."""
    return (mean_speed[:, None] - mean_speed[None]).abs().masked_fill(related, torch.inf).argmin(-1)


def with_stranger(merges: Merges, related: Bool[Tensor, "S S"]) -> Merges:
    """The lag vehicle of an unrelated scene with the nearest mean speed, put where the lag vehicle was at first."""
    donor = strangers(merges.state[:, LAG, :, V].mean(-1), related)
    return _with_lag_vehicle(merges, merges.state[donor, LAG], merges.length[donor, LAG])


def with_constant_speed(merges: Merges) -> Merges:
    """The lag vehicle keeps its first speed."""
    lag = merges.state[:, LAG].clone()
    lag[..., V] = lag[:, :1, V]
    lag[..., V + 1 :] = 0.0
    time = torch.arange(lag.shape[1], dtype=lag.dtype) * merges.dt
    lag[..., X] = lag[:, :1, X] + lag[:, :1, V] * time
    return _with_lag_vehicle(merges, lag, merges.length[:, LAG])


def kept_in_lane(merges: Merges) -> Merges:
    """The merging vehicle does not move sideways."""
    state = merges.state.clone()
    state[:, MERGER, :, Y] = state[:, MERGER, :1, Y]
    return Merges(state, merges.length, merges.lane_width, merges.dt)


def _with_lag_vehicle(merges: Merges, lag: Float[Tensor, "S T D"], length: Float[Tensor, " S"]) -> Merges:
    state, lengths, placed = merges.state.clone(), merges.length.clone(), lag.clone()
    placed[..., X] += merges.state[:, LAG, :1, X] - lag[:, :1, X]
    placed[..., Y] = merges.state[:, LAG, :, Y]
    state[:, LAG], lengths[:, LAG] = placed, length
    return Merges(state, lengths, merges.lane_width, merges.dt)


def apart(merges: Merges) -> Int[Tensor, " K"]:
    """The scenes in which the lag vehicle overlaps no vehicle of its lane."""
    motion = motion_of(merges.state, merges.lane_width, merges.dt, merges.length)
    length = torch.where(merges.length > 0, merges.length, NOMINAL_LENGTH)
    good = torch.ones(len(merges), dtype=torch.bool)
    for other in (MERGER, LEADER):
        gap = merges.state[:, other, :, X] - merges.state[:, LAG, :, X] - length[:, other, None]
        good &= ~(motion.same_lane(other, LAG) & (gap < 0)).any(-1)
    return torch.nonzero(good)[:, 0]
