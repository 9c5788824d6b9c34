"""Numbers worked out by hand."""

from math import exp

import pytest
import torch
from torch import Tensor

from gri.rewards.car_following_features import (
    FollowingConstants,
    f_acceleration,
    f_jerk,
    f_speed,
    g_dist,
    g_idm,
    headway,
    idm_headway,
)

CONSTANTS = FollowingConstants(standstill=2.0, time_headway=1.5, comfort=1.25, minimum=1.0, zeta=4.0, speed_limit=12.0)
AHEAD = torch.tensor([20.0, 8.0, 0.0])
BEHIND = torch.tensor([8.0, 10.0, -1.5])


def value(result: Tensor) -> float:
    return pytest.approx(result.item(), rel=1e-6)  # type: ignore[return-value]


def test_headway_counts_only_ahead():
    assert value(headway(AHEAD, BEHIND)) == 12.0
    assert value(headway(BEHIND, AHEAD)) == 0.0
    assert value(headway(BEHIND + torch.tensor([0.5, 0, 0]), BEHIND)) == 0.5


def test_idm_headway():
    # 2 + 10·1.5 + 10·(10 − 8)/(2·1.25)
    assert value(idm_headway(AHEAD, BEHIND, CONSTANTS)) == 25.0


def test_idm_headway_has_a_floor():
    fast_leader = torch.tensor([20.0, 40.0, 0.0])
    assert value(idm_headway(fast_leader, BEHIND, CONSTANTS)) == 1.0


def test_g_idm_is_the_squared_error_of_the_headway():
    assert value(g_idm(AHEAD, BEHIND, CONSTANTS)) == (12.0 - 25.0) ** 2


def test_g_dist():
    assert value(g_dist(AHEAD, BEHIND, CONSTANTS)) == exp(-9.0)
    assert value(g_dist(BEHIND, AHEAD, CONSTANTS)) == 1.0


def test_node_features():
    assert value(f_speed(BEHIND, CONSTANTS)) == 4.0
    assert value(f_acceleration(BEHIND)) == 2.25
    assert value(f_jerk(torch.tensor([3.0]))) == 9.0
