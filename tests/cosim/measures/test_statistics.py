"""Intervals and tests against published and hand-worked numbers; their coverage and errors by simulation."""

import numpy as np
import pytest
from scipy import stats

from cosim.measures.statistics import LEVEL, Estimate, PairedTest, corrected, mean, median, paired_difference, share

REPEATS = 400
NORMAL = stats.norm.ppf(0.975)


def alone(n: int) -> np.ndarray:
    """Each start is a cluster of its own."""
    return np.arange(n)


def clustered(rng: np.random.Generator, clusters: int, size: int, correlation: float) -> tuple[np.ndarray, np.ndarray]:
    """Standard normal values with this correlation inside a cluster, and the cluster of each."""
    common, own = rng.standard_normal((clusters, 1)), rng.standard_normal((clusters, size))
    values = np.sqrt(correlation) * common + np.sqrt(1 - correlation) * own
    return values.ravel(), np.repeat(np.arange(clusters), size)


def test_nothing_is_estimated_from_nothing():
    empty = np.array([])
    assert np.isnan(share(empty.astype(bool), empty).low)
    assert np.isnan(mean(empty, empty).value)
    assert np.isnan(median(empty, empty).value)
    assert np.isnan(paired_difference(empty, empty, empty).p)


def test_one_cluster_says_nothing_about_others():
    values, clusters = np.array([1.0, 2.0, 6.0]), np.zeros(3)
    for found in (mean(values, clusters), median(values, clusters), share(values > 1, clusters)):
        assert (found.n, found.clusters) == (3, 1)
        assert np.isnan(found.low)
        assert np.isnan(found.high)
    assert mean(values, clusters).value == 3.0
    assert paired_difference(values, np.zeros(3), clusters).p == 1.0


def test_a_mean_by_hand():
    """Clusters {1, 3}, {5}, {3, 3}: mean 3, residual sums −2, 2, 0; s.e. = √(3/2 · 8)/5; t(2) = 4.3027."""
    found = mean(np.array([1.0, 3.0, 5.0, 3.0, 3.0]), np.array(["a", "a", "b", "c", "c"]))
    assert (found.value, found.n, found.clusters) == (3.0, 5, 3)
    assert found.high - 3 == pytest.approx(4.3027 * np.sqrt(12) / 5, rel=1e-4)
    assert 3 - found.low == pytest.approx(found.high - 3)


def test_two_clusters_are_enough_for_an_interval():
    """1 and 3: mean 2, s.e. 1, t(1) = 12.706; of shares the exact interval of 2·(1.96/12.706)²/2 starts."""
    two = mean(np.array([1.0, 3.0]), alone(2))
    assert (two.low, two.high) == pytest.approx((2 - 12.7062, 2 + 12.7062), abs=1e-4)
    n = 2 * (NORMAL / stats.t.ppf(0.975, 1)) ** 2 / 2
    half = share(np.array([True, False]), alone(2))
    assert (half.low, half.high) == pytest.approx(
        (stats.beta.ppf(0.025, n / 2, n / 2 + 1), stats.beta.ppf(0.975, n / 2 + 1, n / 2))
    )


@pytest.mark.parametrize("happened", [False, True])
def test_what_happens_never_or_always_in_one_cluster_has_no_interval(happened: bool):
    found = share(np.full(5, happened), np.zeros(5))
    assert found.value == happened
    assert np.isnan([found.low, found.high]).all()


def test_what_always_happens_has_the_upper_end_1():
    """100 of 100 in ten clusters is 0 of 100 the other way round."""
    clusters = np.repeat(np.arange(10), 10)
    never, always = share(np.zeros(100, dtype=bool), clusters), share(np.ones(100, dtype=bool), clusters)
    assert (always.low, always.high) == pytest.approx((1 - never.high, 1.0))


def test_the_median_of_tied_values_by_hand():
    """Six of ten values are the median: 60 % are at most it; the interval is that of 10 · 0.9 · (1.96/t₉)² starts."""
    values = np.array([0.0] * 6 + [1.0, 2.0, 3.0, 4.0])
    n = 0.9 * 10 * (NORMAL / stats.t.ppf(0.975, 9)) ** 2
    found = median(values, alone(10))
    assert (found.value, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(np.quantile(values, stats.beta.ppf(0.975, n / 2 + 1, n / 2)))


def test_a_mean_of_single_starts_has_students_interval(rng):
    values = rng.exponential(size=30)
    low, high = stats.ttest_1samp(values, 0).confidence_interval()
    found = mean(values, alone(30))
    assert (found.low, found.high) == pytest.approx((low, high))


def test_a_share_of_single_starts_has_the_exact_interval_of_slightly_fewer():
    """8 of 10: as the exact interval of 10 · (1.96/t₉)² = 7.507 starts, times 0.9 for the variance over n − 1."""
    found = share(np.arange(10) < 8, alone(10))
    n = 0.9 * 10 * (NORMAL / stats.t.ppf(0.975, 9)) ** 2
    assert found.value == 0.8
    assert found.low == pytest.approx(stats.beta.ppf(0.025, 0.8 * n, 0.2 * n + 1))
    assert found.high == pytest.approx(stats.beta.ppf(0.975, 0.8 * n + 1, 0.2 * n))


def test_a_share_does_not_shrink_to_nothing_at_the_ends():
    """0 of 100 in ten clusters: up to 1 − 0.025^(1/n) with n = 100 · (1.96/2.262)² = 75.07, which is 4.8 %."""
    found = share(np.zeros(100, dtype=bool), np.repeat(np.arange(10), 10))
    assert (found.low, found.high) == pytest.approx((0.0, 1 - 0.025 ** (1 / 75.07)), abs=1e-4)


def test_starts_that_repeat_each_other_count_once():
    """Ten copies of each of ten starts tell what the ten tell."""
    once, copied = np.arange(10) < 4, np.repeat(np.arange(10) < 4, 10)
    few, many = share(once, alone(10)), share(copied, np.repeat(np.arange(10), 10))
    assert (few.low, few.high) == pytest.approx((many.low, many.high))
    independent = share(copied, alone(100))
    assert independent.high - independent.low < 0.5 * (many.high - many.low)


@pytest.mark.parametrize(("clusters", "size"), [(6, 10), (10, 10), (20, 5)])
@pytest.mark.parametrize("correlation", [0.0, 0.3])
def test_intervals_cover_95_percent_with_correlated_starts(rng, clusters, size, correlation):
    """The standard error of a coverage is 1.1 points; a mean is not to be covered too often either."""
    means = medians = 0
    shares = {0.1: 0, 0.5: 0}
    for _ in range(REPEATS):
        values, cluster = clustered(rng, clusters, size, correlation)
        found = mean(values, cluster)
        means += found.low <= 0 <= found.high
        found = median(values, cluster)
        medians += found.low <= 0 <= found.high
        for p in shares:
            found = share(values < stats.norm.ppf(p), cluster)
            shares[p] += found.low <= p <= found.high
    assert 0.92 <= means / REPEATS <= 0.98
    assert medians / REPEATS >= 0.92
    assert min(shares.values()) / REPEATS >= 0.92


def test_intervals_that_ignore_clusters_cover_far_less(rng):
    """The reason for all this: the same starts, each taken as a cluster of its own."""
    hits = 0
    for _ in range(REPEATS):
        values, _ = clustered(rng, 10, 10, 0.3)
        found = mean(values, alone(100))
        hits += found.low <= 0 <= found.high
    assert hits / REPEATS < 0.8


def test_the_median_resists_one_wild_value(rng):
    found = median(np.append(rng.uniform(0, 1, 40), 1e6), alone(41))
    assert 0.2 < found.low < found.value < found.high < 0.8


def test_equal_values_leave_no_doubt():
    for found in (mean(np.full(10, 3.0), alone(10)), median(np.full(10, 3.0), alone(10))):
        assert (found.value, found.low, found.high) == (3.0, 3.0, 3.0)


def test_sign_flips_by_hand():
    """Differences 1, 2, 3: of the eight ways to sign them two reach a mean of 2 or −2: p = 1/4."""
    assert paired_difference(np.array([1.0, 2.0, 3.0]), np.zeros(3), alone(3)).p == pytest.approx(0.25)
    assert paired_difference(np.array([1.0]), np.zeros(1), alone(1)).p == 1.0  # its sign says nothing


def test_two_differences_have_four_signs():
    """1 and 2: two of the four ways to sign them reach a mean of 1.5 or −1.5."""
    assert paired_difference(np.array([1.0, 2.0]), np.zeros(2), alone(2)).p == pytest.approx(0.5)


def test_a_difference_of_numbers_has_the_interval_of_its_mean():
    a, b = np.array([1.0, 0.5, 0.25, 0.75]), np.array([0.5, 0.25, 0.25, 0.0])
    assert paired_difference(a, b, alone(4)).difference == mean(a - b, alone(4))


@pytest.mark.parametrize("n", [2, 4])
def test_a_difference_of_shares_has_the_interval_with_one_start_more_for_either(n: int):
    """Only a happened at the first of n starts: 1, 0, … and for the second interval 1, 0, …, 1, −1 (Bonett, Price)."""
    a = np.arange(n) == 0
    plain = stats.ttest_1samp(a.astype(float), 0).confidence_interval()
    added = stats.ttest_1samp([*a.astype(float), 1.0, -1.0], 0).confidence_interval()
    found = paired_difference(a, np.zeros(n, dtype=bool), alone(n)).difference
    wanted = max(min(plain.low, added.low), -1.0), min(max(plain.high, added.high), 1.0)
    assert (found.value, found.low, found.high) == pytest.approx((1 / n, *wanted))
    assert (found.n, found.clusters) == (n, n)


def test_a_difference_of_shares_is_within_minus_1_and_1():
    always, never = np.ones(3, dtype=bool), np.zeros(3, dtype=bool)
    assert paired_difference(always, never, alone(3)).difference.high == 1.0
    assert paired_difference(never, always, alone(3)).difference.low == -1.0


def test_a_difference_of_shares_in_one_cluster_has_no_interval():
    found = paired_difference(np.array([True, True]), np.array([True, False]), np.zeros(2)).difference
    assert found.value == 0.5
    assert np.isnan([found.low, found.high]).all()


def test_sign_flips_of_single_booleans_are_mcnemars_test():
    """Of 20 pairs a alone happens 6 times, b alone once: p = 2·(C(7,0) + C(7,1))/2⁷ = 0.125."""
    a = np.array([True] * 6 + [False] + [True] * 5 + [False] * 8)
    b = np.array([False] * 6 + [True] + [True] * 5 + [False] * 8)
    found = paired_difference(a, b, alone(20))
    assert found.p == pytest.approx(0.125)
    assert found.difference.value == pytest.approx(0.25)
    assert paired_difference(b, a, alone(20)).difference.value == pytest.approx(-0.25)
    assert paired_difference(a, a, alone(20)).p == 1.0


def test_starts_of_one_cluster_flip_together():
    """Six differences in three clusters have 2³ signs, not 2⁶: the smallest p is 1/4."""
    assert paired_difference(np.ones(6), np.zeros(6), alone(6)).p == pytest.approx(2 / 64)
    assert paired_difference(np.ones(6), np.zeros(6), np.repeat(np.arange(3), 2)).p == pytest.approx(0.25)


def test_policies_that_never_differ_may_still_differ_elsewhere():
    same = np.ones(100, dtype=bool)
    found = paired_difference(same, same, np.repeat(np.arange(10), 10))
    assert found.p == 1.0
    assert found.difference.low < -0.01 < 0.01 < found.difference.high


def test_pairing_finds_a_small_shift_among_large_differences_between_starts(rng):
    starts = 100 * rng.standard_normal(60)
    found = paired_difference(starts + 1 + 0.5 * rng.standard_normal(60), starts, np.repeat(np.arange(12), 5))
    assert found.p < 2e-3
    assert found.difference.low > 0.7
    assert found.difference.high < 1.3
    assert paired_difference(starts, starts, alone(60)).p == 1.0


@pytest.mark.parametrize("clusters", [6, 10])
def test_equal_policies_differ_in_5_percent_of_the_tests(rng, clusters):
    """Shares of two equal policies, whose failures come in clusters; the interval of their difference covers 0."""
    wrong = ignoring = covered = 0
    for _ in range(REPEATS):
        values, cluster = clustered(rng, clusters, 10, 0.4)
        other, _ = clustered(rng, clusters, 10, 0.4)
        a, b = values < -0.5, other < -0.5
        found = paired_difference(a, b, cluster)
        wrong += found.p < 0.05
        covered += found.difference.low <= 0 <= found.difference.high
        ignoring += stats.binomtest(int((a & ~b).sum()), max(int((a ^ b).sum()), 1)).pvalue < 0.05
    assert wrong / REPEATS <= 0.075
    assert covered / REPEATS >= 0.92
    assert ignoring / REPEATS > 0.15, "McNemar's test of the starts as if they were independent"


def test_benjamini_and_hochbergs_example():
    """Their Table of 15 p-values (1995, Sec. 3.1): the four smallest are significant at 5 %."""
    p = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590]
    found = corrected(np.array([1.0, *p, np.nan]))
    assert (found < 0.05).sum() == 4
    assert np.isnan(found[-1])
    assert found[1] == pytest.approx(15 * 0.0001)


def test_tests_without_a_p_value_are_not_corrected():
    assert np.isnan(corrected(np.array([np.nan, np.nan]))).all()
    assert corrected(np.array([np.nan, 0.04]))[1] == 0.04


def test_correction_keeps_false_discoveries_rare(rng):
    """Of 40 tests without any effect, 5 % seem to have one; after the correction whole tables are clean."""
    any_raw = any_corrected = 0
    for _ in range(200):
        p = rng.uniform(size=40)
        any_raw += (p < 0.05).any()
        any_corrected += (corrected(p) < 0.05).any()
    assert any_raw / 200 > 0.75
    assert any_corrected / 200 <= 0.1


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)


def test_no_starts_are_no_data_and_no_error():
    found = mean(np.empty(0), np.empty(0))
    assert np.isnan([found.value, found.low, found.high]).all()
    assert (found.n, found.clusters) == (0, 0)


def test_a_p_value_at_the_level_is_not_below_it():
    difference = Estimate(1.0, 0.5, 1.5, 9, 9)
    assert not PairedTest(difference, 0.01, 1 - LEVEL).significant
    assert PairedTest(difference, 0.01, np.nextafter(1 - LEVEL, 0)).significant
