"""The next vehicles ahead, and which groups can be driven in one branch."""

import time

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cosim.world.groups import SAME_LANE, Group, everybody_ahead, isolated, next_ahead
from tests.cosim.world.test_group_search import traffic

A, B, C = (Group((f"{name}0", f"{name}1", f"{name}2"), 0.0) for name in "abc")


def vehicles(name: str, front: float, d: float) -> list[tuple[str, float, float]]:
    """Three vehicles in one lane, 20 m apart; the vehicle 2 is at `front`."""
    return [(f"{name}{role}", front - 20.0 * (2 - role), d) for role in range(3)]


def test_groups_beside_each_other_share_a_branch():
    now = traffic(*vehicles("a", 500, 0), *vehicles("b", 510, 3.5), *vehicles("c", 495, -3.5))
    assert isolated([A, B, C], now) == [(A, B, C)]


def test_a_vehicle_2_beside_or_behind_a_driven_vehicle_does_not():
    """Vehicle 1 of the first group is at 480 m."""
    beside = traffic(*vehicles("a", 500, 0), *vehicles("b", 480, 3.5))
    assert isolated([A, B], beside) == [(A,), (B,)]
    just_ahead = traffic(*vehicles("a", 500, 0), *vehicles("b", 480.1, 3.5))
    assert isolated([A, B], just_ahead) == [(A, B)]


def test_groups_in_one_lane_do_not_however_far_apart():
    now = traffic(*vehicles("a", 900, 0), *vehicles("b", 300, 0), *vehicles("c", 310, 3.5))
    assert isolated([A, B, C], now) == [(A,), (B, C)]


def test_every_group_is_in_exactly_one_set_and_the_first_stays_first():
    now = traffic(*vehicles("a", 900, 0), *vehicles("b", 300, 0), *vehicles("c", 905, 3.5))
    assert isolated([A, B, C], now) == [(A, C), (B,)]
    assert isolated([], now) == []


def nearest_of_all_pairs(s: np.ndarray, d: np.ndarray) -> list[int]:
    """The definition, over all V × V pairs of vehicles."""
    distance = s[None] - s[:, None]
    distance = np.where((np.abs(d[None] - d[:, None]) < SAME_LANE) & (distance > 0), distance, np.inf)
    return [int(row.argmin()) if np.isfinite(row.min()) else -1 for row in distance] if len(s) else []


rounded = st.integers(-40, 40).map(lambda k: k / 4)
near_lines = st.builds(lambda k, off: k + off * 2.0**-60, st.integers(-3, 3), st.integers(-300, 300))
places = st.floats(-200, 200) | rounded | near_lines
offsets = st.floats(-6, 6) | rounded | near_lines


@given(st.lists(st.tuples(places, offsets), max_size=40))
@example([(0.0, -2e-247), (1.0, -1.0), (-1.0, -1.0)])
def test_everybody_ahead_is_the_definition(vehicles):
    now = traffic(*((str(k), s, d) for k, (s, d) in enumerate(vehicles)))
    expected = nearest_of_all_pairs(now.s, now.d)
    assert everybody_ahead(now).tolist() == expected
    assert next_ahead(now, np.arange(len(vehicles))).tolist() == expected


@pytest.mark.parametrize("spread", [0.1, 40.0])
def test_everybody_ahead_is_not_quadratic(spread):
    """16 times as many vehicles take less than 80 times as long; all pairs would take 256 times as long."""
    rng, spent = np.random.default_rng(3), []
    for count in (1000, 16000):
        lanes = rng.integers(0, 4, count) * 3.5
        s, d = rng.uniform(0, 6.0 * count, count), lanes + rng.normal(0, spread, count)
        now = traffic(*((str(k), *place) for k, place in enumerate(zip(s, d, strict=True))))
        times = []
        for _ in range(5):
            began = time.process_time()
            everybody_ahead(now)
            times.append(time.process_time() - began)
        spent.append(min(times))
    assert spent[1] < 80 * spent[0]
