"""Intervals and tests against published and hand-worked numbers, and their coverage by simulation."""

import numpy as np
import pytest

from cosim.measures.statistics import bootstrap_mean, bootstrap_median, mcnemar, paired_difference, wilson


def happened(yes: int, n: int) -> np.ndarray:
    return np.arange(n) < yes


def test_wilson_by_hand():
    """8 of 10, z = 1.96: centre (0.8 + z²/20)/(1 + z²/10) = 0.7168, half width 0.2265."""
    found = wilson(happened(8, 10))
    assert (found.value, found.n) == (0.8, 10)
    assert (found.low, found.high) == pytest.approx((0.4902, 0.9433), abs=1e-4)


def test_wilson_does_not_shrink_to_nothing_at_the_ends():
    """0 of 100: from 0 to z²/(100 + z²) = 0.0370."""
    found = wilson(happened(0, 100))
    assert (found.low, found.high) == pytest.approx((0.0, 0.0370), abs=1e-4)


def test_nothing_is_estimated_from_nothing():
    assert np.isnan(wilson(happened(0, 0)).low)
    assert np.isnan(bootstrap_mean(np.array([])).value)
    assert np.isnan(mcnemar(happened(0, 0), happened(0, 0)).p)
    assert np.isnan(paired_difference(np.array([]), np.array([])).p)


def test_mcnemar_by_hand():
    """Of 20 pairs a alone happens 6 times, b alone once: p = 2·(C(7,0) + C(7,1))/2⁷ = 0.125."""
    a = np.array([True] * 6 + [False] + [True] * 5 + [False] * 8)
    b = np.array([False] * 6 + [True] + [True] * 5 + [False] * 8)
    found = mcnemar(a, b)
    assert found.p == pytest.approx(0.125)
    assert found.difference.value == pytest.approx(0.25)
    assert mcnemar(b, a).difference.value == pytest.approx(-0.25)
    assert mcnemar(a, a).p == 1.0


def test_pairing_finds_a_small_shift_among_large_differences_between_starts(rng):
    starts = 100 * rng.standard_normal(60)
    found = paired_difference(starts + 1 + 0.5 * rng.standard_normal(60), starts)
    assert found.p < 2e-3
    assert found.difference.low > 0.7
    assert found.difference.high < 1.3
    assert paired_difference(starts, starts).p == 1.0


def test_sign_flips_by_hand():
    """Differences 1, 2, 3: of the eight ways to sign them two reach a mean of 2 or −2: p = 1/4."""
    assert paired_difference(np.array([1.0, 2.0, 3.0]), np.zeros(3)).p == pytest.approx(0.25)
    assert paired_difference(np.array([1.0]), np.zeros(1)).p == 1.0  # its sign says nothing


def test_the_mean_is_covered_about_as_often_as_promised(rng):
    hits = 0
    for _ in range(200):
        found = bootstrap_mean(rng.exponential(size=60))
        hits += found.low <= 1 <= found.high
    assert 0.87 <= hits / 200 <= 0.99


def test_the_median_resists_one_wild_value(rng):
    found = bootstrap_median(np.append(rng.uniform(0, 1, 40), 1e6))
    assert 0.2 < found.low < found.value < found.high < 0.8


def test_equal_values_leave_no_doubt():
    found = bootstrap_mean(np.full(10, 3.0))
    assert (found.value, found.low, found.high) == (3.0, 3.0, 3.0)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)
