"""Reward features of lane changing (Sec. VI-C): functions of states [x, y, v, θ, a, ω] and actions [δa, δω], SI units.

`sender` is vehicle i in the paper, and `receiver` is vehicle j, which reacts to it. Leading axes are free. Lanes run
along x, and y counts to the left. Lane centres are at whole multiples of the lane width. Longitudinal features are
those of car following, applied to [x, v, a]. Every feature is a cost, 0 or more: the reward subtracts it. `g_yield` is
the term for yielding, `g_goal_cut_in` and `g_dist_cut_in` those for cutting in.
"""

from enum import StrEnum

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.rewards import car_following_features
from gri.rewards.car_following_features import FollowingConstants

CLEAR_HEADWAY_WIDTH = 0.4  # [m], the width of the sigmoid w in `g_lat`

State = Float[Tensor, "*batch 6"]
Action = Float[Tensor, "*batch 2"]
Value = Float[Tensor, "*batch"]


class GoalForm(StrEnum):
    """The two forms of g_goal (docs/decisions/010-yield-goal.md)."""

    ONE_SIDED = "one_sided"
    """max(Δx^yield − (x_i − x_j), 0)²: a headway below Δx^yield costs."""
    PRINTED = "printed"
    """max(x_i − x_j − Δx^yield, 0)²: a headway above Δx^yield costs, as printed in the paper."""


class LaneConstants(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Constants of the lane-changing features. The paper gives none of them."""

    following: FollowingConstants = FollowingConstants()
    width: float = 3.5
    """Width of a lane [m]."""
    boundary: float = 0.4
    """σ of f_lane, the range of the term around a lane boundary [m]."""
    yield_headway: float = 5.0
    """Δx^yield, the desired headway of a yielding vehicle [m]."""
    goal: GoalForm = GoalForm.ONE_SIDED
    clear_headway: float | None = None
    """Δx^c, the headway from which the receiver is drawn into the sender's lane [m]; below it, the receiver is drawn
    into the lane beside it (docs/decisions/012-clear-headway.md). None: into the sender's lane at any headway, as in
    the paper.
    """


def longitudinal(state: State) -> Float[Tensor, "*batch 3"]:
    """The longitudinal part [x, v, a] of [x, y, v, θ, a, ω]."""
    return torch.stack([state[..., 0], state[..., 2], state[..., 4]], -1)


def g_center(y: Value, constants: LaneConstants) -> Value:
    """Lateral position of the nearest lane centre [m]; piecewise constant, so it has no gradient."""
    return torch.round(y / constants.width) * constants.width


def g_idm(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_IDM = (max(x_i − x_j, 0) − Δx^IDM)²  [m²]: the headway differs from the desired one."""
    return car_following_features.g_idm(longitudinal(sender), longitudinal(receiver), constants.following)


def g_dist(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_dist = exp(−max(x_i − x_j, 0)² / ζ²)  [-]: the receiver is close to a collision."""
    return car_following_features.g_dist(longitudinal(sender), longitudinal(receiver), constants.following)


def g_lat(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_lat = (y_j − g_center(y_i))²  [m²]: the receiver is off the centre of the sender's lane.

    With a `clear_headway` Δx^c it is w·(y_j − g_center(y_i))² + (1 − w)·(y_j − y_beside)² with
    w = σ((x_i − x_j − Δx^c) / 0.4 m); y_beside is the centre of the lane beside the sender's on the receiver's side.
    """
    y, center = receiver[..., 1], g_center(sender[..., 1], constants)
    if constants.clear_headway is None:
        return (y - center) ** 2
    clear = torch.sigmoid((sender[..., 0] - receiver[..., 0] - constants.clear_headway) / CLEAR_HEADWAY_WIDTH)
    beside = center + torch.where(y < center, -constants.width, constants.width)
    return clear * (y - center) ** 2 + (1 - clear) * (y - beside) ** 2


def g_goal(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_goal = max(Δx^yield − (x_i − x_j), 0)²  [m²], or the form printed in the paper (`GoalForm`)."""
    excess = sender[..., 0] - receiver[..., 0] - constants.yield_headway
    return (excess if constants.goal is GoalForm.PRINTED else -excess).clamp(min=0) ** 2


def g_yield(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """The term for yielding  [m²]: g_yield = g_IDM in the same lane, g_goal in different lanes."""
    same_lane = g_center(sender[..., 1], constants) == g_center(receiver[..., 1], constants)
    return torch.where(same_lane, g_idm(sender, receiver, constants), g_goal(sender, receiver, constants))


def g_goal_cut_in(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """The term for cutting in  [m²]: g_goal(x_j, x_i), the receiver is not far enough ahead of the sender."""
    return g_goal(receiver, sender, constants)


def g_dist_cut_in(sender: State, receiver: State, constants: LaneConstants) -> Value:
    """g_dist(x_j, x_i)  [-]: the sender is close to a collision with the receiver ahead of it."""
    return g_dist(receiver, sender, constants)


def f_speed(state: State, constants: LaneConstants) -> Value:
    """f_v = (v_j − v_lim)²  [m²/s²]: the speed differs from the speed limit."""
    return (state[..., 2] - constants.following.speed_limit) ** 2


def f_lane(state: State, constants: LaneConstants) -> Value:
    """f_lane = exp(−d² / 2σ²)  [-]: the vehicle is near a lane boundary, at the distance d [m]."""
    distance = 0.5 * constants.width - (state[..., 1] - g_center(state[..., 1], constants)).abs()
    return torch.exp(-0.5 * (distance / constants.boundary) ** 2)
