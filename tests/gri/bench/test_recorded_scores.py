"""Intervals are clustered: windows of one vehicle count as one."""

import numpy as np
import pytest

from gri.bench.recorded_scores import ranking, share


def test_share_counts_only_what_it_is_told_to():
    hit = np.array([[True, False], [True, True]])
    counted = np.array([[True, False], [True, True]])
    assert share(hit, counted, np.array([1, 2])).value == 1
    assert share(hit, np.ones_like(hit), np.array([1, 2])).value == 0.75
    assert np.isnan(share(hit, np.zeros_like(hit), np.array([1, 2])).value)


def test_copies_of_windows_of_one_vehicle_do_not_narrow_the_interval():
    rng = np.random.default_rng(0)
    hit = rng.random((40, 1)) < 0.5
    once = share(hit, np.ones_like(hit), np.arange(40))
    again = share(np.repeat(hit, 10, 0), np.ones((400, 1), bool), np.repeat(np.arange(40), 10))
    apart = share(np.repeat(hit, 10, 0), np.ones((400, 1), bool), np.arange(400))
    assert (again.low, again.high) == pytest.approx((once.low, once.high))
    assert apart.high - apart.low < 0.5 * (once.high - once.low)


def test_ranking_is_the_area_under_the_curve():
    p, truth = np.array([0.9, 0.8, 0.3, 0.1]), np.array([True, False, True, False])
    found = ranking(p, truth, np.arange(4))
    assert found.value == 0.75
    assert found.low <= 0.75 <= found.high
    assert ranking(np.full(4, 0.5), truth, np.arange(4)).value == 0.5
