"""The safety filter: how far it lets a vehicle go, and where it stops lateral motion."""

import numpy as np
import pytest

from cosim.loop.limits import FilterRecord, Limited, Limits, planned_across, within
from cosim.loop.safety_filter import SafetyFilter
from cosim.spec.scenario import RssFilter
from gri.core.dynamics import DUBINS, POINT_MASS_1D
from tests.cosim.loop.near import near

DT = 0.2
FILTER = SafetyFilter(RssFilter(), DT)


def limits(*vehicles, planned: float = 0.0, a: float = 0.0) -> tuple[float, float]:
    """The greatest acceleration of vehicle 0 and its lateral speed to the left (NaN where it is free)."""
    found = FILTER.limits(near(*vehicles, a=a), np.array([[planned, 0.0, 0.0]]))
    return float(found.along[0, 0]), float(found.across[0, 0])


@pytest.mark.parametrize(("v", "gap", "v_ahead"), [(15.0, 40.0, 0.0), (15.0, 12.0, 15.0), (25.0, 40.0, 20.0)])
def test_a_vehicle_at_the_limit_stops_behind_one_that_brakes_hardest(v, gap, v_ahead):
    """The vehicle follows the limit in every step while the other brakes with 8 m/s²; a safe start stays safe."""
    own, other, a, least = [0.0, v], [gap + 5.0, v_ahead], 0.0, np.inf
    assert limits((0.0, 0.0, v, 0.0), (gap + 5.0, 0.0, v_ahead, 0.0))[0] > -8.0
    for _ in range(40):
        along, _ = limits((own[0], 0.0, own[1], 0.0), (other[0], 0.0, other[1], 0.0), a=a)
        own = [own[0] + own[1] * DT, max(own[1] + a * DT, 0.0)]
        a = min(along, 1.5)
        braked = max(other[1] - 8.0 * DT, 0.0)
        other = [other[0] + 0.5 * (other[1] + braked) * DT, braked]
        least = min(least, other[0] - 5.0 - own[0])
    assert 0.0 < least < 6.0


def test_a_vehicle_far_ahead_or_in_the_next_lane_is_no_limit_for_what_a_policy_does():
    assert limits((0.0, 0.0, 15.0, 0.0), (100.0, 0.0, 15.0, 0.0))[0] > 5.0
    assert limits((0.0, 0.0, 15.0, 0.0), (12.0, 3.5, 5.0, 0.0))[0] > 5.0
    assert limits((0.0, 0.0, 15.0, 0.0), (-12.0, 0.0, 30.0, 0.0))[0] > 5.0


def test_a_vehicle_that_moves_into_the_lane_counts_before_it_is_there_but_with_comfortable_braking():
    assert limits((0.0, 0.0, 15.0, 0.0), (12.0, 2.5, 5.0, -1.0))[0] == pytest.approx(-4.0)
    assert limits((0.0, 0.0, 15.0, 0.0), (12.0, 2.5, 5.0, 1.0))[0] > 5.0


@pytest.mark.parametrize(
    ("other", "free"),
    [
        ((1.0, 3.5, 15.0, 0.0), False),  # beside
        ((9.0, 3.5, 10.0, 0.0), False),  # 4 m ahead and 5 m/s slower
        ((-9.0, 3.5, 25.0, 0.0), False),  # 4 m behind and 10 m/s faster
        ((60.0, 3.5, 15.0, 0.0), True),
        ((-60.0, 3.5, 15.0, 0.0), True),
        ((1.0, 7.0, 15.0, 0.0), True),  # two lanes away
        ((1.0, -3.5, 15.0, 0.0), True),  # on the other side
    ],
)
def test_lateral_motion_stops_before_an_occupied_place(other, free):
    across = limits((0.0, 0.0, 15.0, 0.0), other, planned=1.2)[1]
    assert np.isnan(across) == free
    assert np.isnan(limits((0.0, 0.0, 15.0, 0.0), other)[1]), "without lateral motion there is nothing to stop"


def test_a_vehicle_that_is_too_close_across_the_road_is_left():
    assert limits((0.0, 0.0, 15.0, 0.2), (0.0, 2.2, 15.0, 0.0), planned=0.5)[1] == -0.5


def test_limits_change_only_what_exceeds_them():
    state = np.zeros((1, 3, 3))
    state[..., 1], action = 10.0, np.full((1, 3, 1), 5.0)  # the acceleration of the next step is 1 m/s²
    free, tight = Limits(np.full((1, 3), 2.0), np.full((1, 3), np.nan)), Limits(np.full((1, 3), -3.0), np.zeros((1, 3)))
    assert (within(free, state, action, POINT_MASS_1D, 1, DT).action == action).all()
    limited = within(tight, state, action, POINT_MASS_1D, 1, DT)
    assert limited.action[0, 0, 0] * DT == pytest.approx(-3.0)
    assert limited.reduced[0].tolist() == pytest.approx([4.0] * 3)
    assert not limited.steered.any()


@pytest.mark.parametrize("side", [1, -1])
def test_lateral_motion_ends_within_some_steps(side):
    state = np.zeros((1, 3, 6))
    state[..., 2], state[..., 3] = 12.0, 0.1
    for _ in range(8):
        limit = Limits(np.full((1, 3), np.inf), np.zeros((1, 3)))
        action = within(limit, state, np.zeros((1, 3, 2)), DUBINS, side, DT).action
        state = DUBINS.step(state, action, DT)
    assert np.abs(planned_across(state, np.zeros((1, 3, 2)), DUBINS, side, DT)).max() < 0.02


def test_the_use_counts_steps_of_driven_vehicles_up_to_the_end():
    record, none = FilterRecord(), np.zeros((1, 3), dtype=bool)
    for time, reduced in ((0.0, [2.0, 0.0, 9.0]), (0.2, [0.0, 0.0, 9.0]), (0.4, [5.0, 5.0, 9.0])):
        record.add(time, Limited(np.zeros((1, 3, 1)), np.array([reduced]), none))
    use = record.of(0, [0, 1], end=0.4)
    assert (use.along, use.across, use.hardest) == (0.25, 0.0, 2.0)
