"""Numbers worked out by hand."""

from math import exp

import msgspec
import pytest
import torch
from torch import Tensor
from torch.func import grad

from gri.rewards import lane_changing_features as lane
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import GoalForm, LaneConstants

CONSTANTS = LaneConstants(
    following=FollowingConstants(standstill=2.0, time_headway=1.5, comfort=1.25, zeta=4.0, speed_limit=12.0),
    width=4.0,
    boundary=0.5,
    yield_headway=15.0,
)
PRINTED = msgspec.structs.replace(CONSTANTS, goal=GoalForm.PRINTED)
# Features: x, y, v, heading, a, yaw rate
AHEAD = torch.tensor([20.0, 0.5, 8.0, 0.0, 0.0, 0.0])
BEHIND = torch.tensor([8.0, -3.0, 10.0, 0.1, -1.5, 0.2])


def value(result: Tensor) -> float:
    return pytest.approx(result.item(), rel=1e-6)  # type: ignore[return-value]


def in_lane(state: Tensor, y: float) -> Tensor:
    return torch.cat([state[:1], torch.tensor([y]), state[2:]])


def test_longitudinal_features_are_those_of_car_following():
    # wanted headway: 2 + 10·1.5 + 10·(10 − 8)/(2·1.25) = 25
    assert value(lane.g_idm(AHEAD, BEHIND, CONSTANTS)) == (12.0 - 25.0) ** 2
    assert value(lane.g_dist(AHEAD, BEHIND, CONSTANTS)) == exp(-9.0)
    assert value(lane.g_dist(BEHIND, AHEAD, CONSTANTS)) == 1.0
    assert value(lane.f_speed(BEHIND, CONSTANTS)) == 4.0


@pytest.mark.parametrize(("y", "center"), [(0.5, 0.0), (-1.9, 0.0), (-2.1, -4.0), (-5.9, -4.0), (2.5, 4.0)])
def test_the_nearest_centre_is_a_multiple_of_the_width(y: float, center: float):
    assert value(lane.g_center(torch.tensor(y), CONSTANTS)) == center


def test_g_lat_counts_from_the_senders_centre():
    assert value(lane.g_lat(AHEAD, BEHIND, CONSTANTS)) == 9.0
    assert value(lane.g_lat(BEHIND, AHEAD, CONSTANTS)) == (0.5 + 4.0) ** 2


@pytest.mark.parametrize(("headway", "wanted"), [(30.0, 9.0), (10.0, 0.5 * 9.0 + 0.5 * 1.0), (-30.0, 1.0)])
def test_g_lat_keeps_who_is_not_clear_in_the_lane_beside(headway: float, wanted: float):
    patient = msgspec.structs.replace(CONSTANTS, clear_headway=10.0)
    sender = BEHIND + torch.tensor([headway, 3.5, 0, 0, 0, 0])  # its lane is at 0, the one beside at -4
    assert value(lane.g_lat(sender, BEHIND, patient)) == wanted


def test_g_lat_is_clear_gradually():
    """0.4 m beyond the clear headway, w = 1/(1 + 1/e); a receiver to the left has the lane beside on its left."""
    patient = msgspec.structs.replace(CONSTANTS, clear_headway=10.0)
    sender = BEHIND + torch.tensor([10.4, 3.5, 0, 0, 0, 0])
    clear = 1 / (1 + exp(-1))
    assert value(lane.g_lat(sender, BEHIND, patient)) == clear * 9.0 + (1 - clear) * 1.0
    assert value(lane.g_lat(sender, in_lane(BEHIND, 3.0), patient)) == clear * 9.0 + (1 - clear) * 1.0
    assert value(lane.g_lat(in_lane(sender, 4.5), in_lane(BEHIND, 1.0), patient)) == clear * 9.0 + (1 - clear) * 1.0


def test_the_longitudinal_part_is_position_speed_and_acceleration():
    assert lane.longitudinal(torch.tensor([1.0, 2, 3, 4, 5, 6])).tolist() == [1.0, 3.0, 5.0]


def test_the_centre_has_no_gradient():
    def of_sender(y: Tensor) -> Tensor:
        return lane.g_lat(torch.cat([AHEAD[:1], y[None], AHEAD[2:]]), BEHIND, CONSTANTS)

    assert grad(of_sender)(torch.tensor(0.5)).item() == 0.0


def test_g_goal_punishes_being_too_close_and_the_printed_form_being_too_far():
    far = AHEAD + torch.tensor([10.0, 0, 0, 0, 0, 0])  # 22 m ahead
    assert value(lane.g_goal(AHEAD, BEHIND, CONSTANTS)) == (15.0 - 12.0) ** 2
    assert value(lane.g_goal(far, BEHIND, CONSTANTS)) == 0.0
    assert value(lane.g_goal(AHEAD, BEHIND, PRINTED)) == 0.0
    assert value(lane.g_goal(far, BEHIND, PRINTED)) == (22.0 - 15.0) ** 2


def test_g_goal_counts_also_below_one_metre():
    """12 m are there: 0.5 m less than 12.5 m, and 0.5 m more than 11.5 m."""
    for goal, headway in ((GoalForm.ONE_SIDED, 12.5), (GoalForm.PRINTED, 11.5)):
        constants = msgspec.structs.replace(CONSTANTS, goal=goal, yield_headway=headway)
        assert value(lane.g_goal(AHEAD, BEHIND, constants)) == 0.25


def test_whoever_is_still_in_front_of_the_vehicle_it_yields_to_is_drawn_back():
    """max(x_i − x_j, 0) would end the slope there (docs/decisions/010-yield-goal.md)."""
    assert value(lane.g_goal(BEHIND, AHEAD, CONSTANTS)) == (15.0 + 12.0) ** 2


def test_g_yield_is_the_goal_across_lanes_and_idm_within_one():
    assert value(lane.g_yield(AHEAD, BEHIND, CONSTANTS)) == 9.0
    assert value(lane.g_yield(AHEAD, BEHIND, PRINTED)) == 0.0
    assert value(lane.g_yield(AHEAD, in_lane(BEHIND, 1.0), CONSTANTS)) == 13.0**2


def test_cutting_in_is_yielding_with_the_roles_exchanged():
    assert value(lane.g_goal_cut_in(BEHIND, AHEAD, CONSTANTS)) == 9.0
    assert value(lane.g_dist_cut_in(BEHIND, AHEAD, CONSTANTS)) == exp(-9.0)


@pytest.mark.parametrize(("y", "distance"), [(0.0, 2.0), (1.5, 0.5), (-2.0, 0.0), (-2.5, 0.5), (-4.0, 2.0)])
def test_f_lane_is_one_on_a_boundary(y: float, distance: float):
    assert value(lane.f_lane(in_lane(AHEAD, y), CONSTANTS)) == exp(-2 * distance**2)
