"""Reward features of car following (Sec. VI-C): pure functions of states [x, v, a] and actions [jerk].

`sender` is the vehicle ahead (i in the paper), `receiver` the one that reacts (j). Leading axes are free.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

State = Float[Tensor, "*batch 3"]
Value = Float[Tensor, "*batch"]


class FollowingConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Constants of the features; the paper gives none of them. Headways count from front to front."""

    standstill: float = 1.0
    """s0 [m]."""
    time_headway: float = 1.0
    """T_h [s]."""
    comfort: float = 1.22474487
    """√(a·b) [m/s²] of the intelligent driver model, by which closing speed widens the headway."""
    minimum: float = 1.0
    """The wanted headway never falls below this [m]."""
    zeta: float = 2.0
    """Range of the collision term [m]."""
    speed_limit: float = 7.0
    """v_lim [m/s]."""


def headway(sender: State, receiver: State) -> Value:
    """max(x_i − x_j, 0)."""
    return (sender[..., 0] - receiver[..., 0]).clamp(min=0)


def idm_headway(sender: State, receiver: State, constants: FollowingConstants) -> Value:
    """Δx^IDM = s0 + v_j·T_h + v_j·(v_j − v_i) / (2·√(a·b)), not below the minimum (Treiber et al. 2000)."""
    v_i, v_j = sender[..., 1], receiver[..., 1]
    dynamic = v_j * constants.time_headway + v_j * (v_j - v_i) / (2 * constants.comfort)
    return (constants.standstill + dynamic).clamp(min=constants.minimum)


def g_idm(sender: State, receiver: State, constants: FollowingConstants) -> Value:
    """g_IDM = (max(x_i − x_j, 0) − Δx^IDM)²  [m²]."""
    return (headway(sender, receiver) - idm_headway(sender, receiver, constants)) ** 2


def g_dist(sender: State, receiver: State, constants: FollowingConstants) -> Value:
    """g_dist = exp(−max(x_i − x_j, 0)² / ζ²)  [-]."""
    return torch.exp(-((headway(sender, receiver) / constants.zeta) ** 2))


def f_speed(state: State, constants: FollowingConstants) -> Value:
    """f_v = (v_j − v_lim)²  [m²/s²]."""
    return (state[..., 1] - constants.speed_limit) ** 2


def f_acceleration(state: State) -> Value:
    """a_j²  [m²/s⁴]."""
    return state[..., 2] ** 2


def f_jerk(action: Float[Tensor, "*batch 1"]) -> Value:
    """δa_j²  [m²/s⁶]."""
    return action[..., 0] ** 2
