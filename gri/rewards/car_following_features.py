"""Reward features of car following (Sec. VI-C): functions of states [x, v, a] and actions [jerk] in SI units.

`sender` is the leader (i in the paper), and `receiver` is the follower that reacts to it (j). Leading axes are free.
Every feature is a cost, 0 or more: the reward subtracts it.
"""

from typing import Protocol, runtime_checkable

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

State = Float[Tensor, "*batch 3"]
Value = Float[Tensor, "*batch"]


class FollowingConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Constants of the features. The paper gives none of them. Headways are from front to front."""

    standstill: float = 1.0
    """s0, the headway at standstill [m]."""
    time_headway: float = 1.0
    """T_h, the time headway [s]."""
    comfort: float = 1.22474487
    """√(a·b) of the intelligent driver model [m/s²], with acceleration a and comfortable deceleration b."""
    minimum: float = 1.0
    """Least value of the desired headway Δx^IDM [m]."""
    zeta: float = 2.0
    """ζ, the range of the collision term g_dist [m]."""
    speed_limit: float = 7.0
    """v_lim, the speed limit [m/s]."""


@runtime_checkable
class Constants(Protocol):
    """The constants that the features read: given ones (`FollowingConstants`) or learned ones (`LearnedConstants`)."""

    @property
    def standstill(self) -> float | Tensor: ...
    @property
    def time_headway(self) -> float | Tensor: ...
    @property
    def comfort(self) -> float | Tensor: ...
    @property
    def minimum(self) -> float | Tensor: ...
    @property
    def zeta(self) -> float | Tensor: ...
    @property
    def speed_limit(self) -> float | Tensor: ...


def headway(sender: State, receiver: State) -> Value:
    """max(x_i − x_j, 0), the headway of the follower [m]."""
    return (sender[..., 0] - receiver[..., 0]).clamp(min=0)


def idm_headway(sender: State, receiver: State, constants: Constants) -> Value:
    """Δx^IDM = s0 + v_j·T_h + v_j·(v_j − v_i) / (2·√(a·b)), at least `minimum` [m] (Treiber et al. 2000)."""
    v_i, v_j = sender[..., 1], receiver[..., 1]
    dynamic = v_j * constants.time_headway + v_j * (v_j - v_i) / (2 * constants.comfort)
    return (constants.standstill + dynamic).clamp(min=constants.minimum)


def g_idm(sender: State, receiver: State, constants: Constants) -> Value:
    """g_IDM = (max(x_i − x_j, 0) − Δx^IDM)²  [m²]: the headway differs from the desired one."""
    return (headway(sender, receiver) - idm_headway(sender, receiver, constants)) ** 2


def g_dist(sender: State, receiver: State, constants: Constants) -> Value:
    """g_dist = exp(−max(x_i − x_j, 0)² / ζ²)  [-]: the follower is close to a collision."""
    return torch.exp(-((headway(sender, receiver) / constants.zeta) ** 2))


def f_speed(state: State, constants: Constants) -> Value:
    """f_v = (v_j − v_lim)²  [m²/s²]: the speed differs from the speed limit."""
    return (state[..., 1] - constants.speed_limit) ** 2


def f_acceleration(state: State) -> Value:
    """a_j²  [m²/s⁴]: the acceleration."""
    return state[..., 2] ** 2


def f_jerk(action: Float[Tensor, "*batch 1"]) -> Value:
    """δa_j²  [m²/s⁶]: the jerk."""
    return action[..., 0] ** 2
