"""Reward features of lane changing (Sec. VI-C): pure functions of states [x, y, v, θ, a, ω] and actions [δa,
δω].

`sender` is i in the paper, `receiver` the vehicle j that reacts. Leading axes are free. Lanes run along x, y
counts to the left, and the lane centres lie at whole multiples of the lane width. Longitudinal features are
those of car following, read from [x, v, a].
"""

from enum import StrEnum

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.rewards import car_following_features
from gri.rewards.car_following_features import FollowingConstants

SOFT = 0.4  # [m] of headway over which "clear of the sender" goes from 27 to 50 %

State = Float[Tensor, "*batch 6"]
Action = Float[Tensor, "*batch 2"]
Value = Float[Tensor, "*batch"]


class GoalForm(StrEnum):
    """How g_goal reads the wanted headway (docs/decisions/010-yield-goal.md)."""

    ONE_SIDED = "one_sided"
    """max(Δx^yield − (x_i − x_j), 0)²: being closer costs."""
    PRINTED = "printed"
    """max(x_i − x_j − Δx^yield, 0)²: being farther away costs, as the equation stands in the paper."""


class LaneConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Constants of the lane-changing features; the paper gives none of them."""

    following: FollowingConstants = FollowingConstants()
    width: float = 3.5
    """Of a lane [m]."""
    boundary: float = 0.4
    """Range of f_lane about a lane boundary [m]."""
    yield_headway: float = 5.0
    """Δx^yield [m]."""
    goal: GoalForm = GoalForm.ONE_SIDED
    clear_headway: float | None = None
    """Headway [m] from which on a receiver belongs in the sender's lane, nearer in the lane beside it (decision 012).

    None: in the sender's lane at any headway, as in the paper.
    """


def longitudinal(state: State) -> Float[Tensor, "*batch 3"]:
    """[x, v, a] of [x, y, v, θ, a, ω]."""
    return torch.stack([state[..., 0], state[..., 2], state[..., 4]], -1)


def g_center(y: Value, constants: LaneConstants) -> Value:
    """Lateral position of the nearest lane centre [m]; piecewise constant, so it has no gradient."""
    return torch.round(y / constants.width) * constants.width


def g_idm(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_IDM = (max(x_i − x_j, 0) − Δx^IDM)²  [m²]."""
    return car_following_features.g_idm(longitudinal(sender), longitudinal(receiver), constants.following)


def g_dist(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_dist = exp(−max(x_i − x_j, 0)² / ζ²)  [-]."""
    return car_following_features.g_dist(longitudinal(sender), longitudinal(receiver), constants.following)


def g_lat(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_lat = (y_j − g_center(y_i))²  [m²]: the receiver belongs in the sender's lane.

    With a `clear_headway` Δx^c it is w·(y_j − g_center(y_i))² + (1 − w)·(y_j − y_beside)², where
    w = σ((x_i − x_j − Δx^c)/0.4 m).
    """
    own, there = receiver[..., 1], g_center(sender[..., 1], constants)
    if constants.clear_headway is None:
        return (own - there) ** 2
    clear = torch.sigmoid((sender[..., 0] - receiver[..., 0] - constants.clear_headway) / SOFT)
    beside = there + torch.where(own < there, -constants.width, constants.width)
    return clear * (own - there) ** 2 + (1 - clear) * (own - beside) ** 2


def g_goal(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_goal = max(Δx^yield − (x_i − x_j), 0)²  [m²], or the printed form max(x_i − x_j − Δx^yield, 0)²."""
    excess = sender[..., 0] - receiver[..., 0] - constants.yield_headway
    return (excess if constants.goal is GoalForm.PRINTED else -excess).clamp(min=0) ** 2


def g_yield(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_yield = g_IDM in the same lane, g_goal in different lanes  [m²]."""
    same_lane = g_center(sender[..., 1], constants) == g_center(receiver[..., 1], constants)
    return torch.where(same_lane, g_idm(sender, receiver, constants), g_goal(sender, receiver, constants))


def g_goal_cut_in(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_goal(x_j, x_i)  [m²]: the receiver belongs in front of the sender."""
    return g_goal(receiver, sender, constants)


def g_dist_cut_in(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_dist(x_j, x_i)  [-]."""
    return g_dist(receiver, sender, constants)


def f_speed(state: State, constants: LaneConstants) -> Value:
    """f_v = (v_j − v_lim)²  [m²/s²]."""
    return (state[..., 2] - constants.following.speed_limit) ** 2


def f_lane(state: State, constants: LaneConstants) -> Value:
    """f_lane = exp(−d² / 2σ²)  [-] with the distance d to the nearest lane boundary."""
    distance = 0.5 * constants.width - (state[..., 1] - g_center(state[..., 1], constants)).abs()
    return torch.exp(-0.5 * (distance / constants.boundary) ** 2)
