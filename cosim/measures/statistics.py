"""Confidence intervals and paired tests, by scipy.

A *start* is one group at its take-over. Shares and means are over starts, which are drawn from the traffic of a
scenario. Policies are compared on the same starts, so that differences between starts cancel.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy import stats

RESAMPLES = 2000


@dataclass(frozen=True)
class Estimate:
    """A value with the ends of its 95 % confidence interval; all NaN without data. `n` is the number of values."""

    value: float
    low: float
    high: float
    n: int


@dataclass(frozen=True)
class PairedTest:
    """A difference a − b on the same starts, and the two-sided p-value of the hypothesis that there is none."""

    difference: Estimate
    p: float


_NO_DATA = Estimate(np.nan, np.nan, np.nan, 0)


def wilson(happened: Bool[np.ndarray, " S"]) -> Estimate:
    """Probability of an event at a start, with Wilson's (1927) score interval; `happened` has one flag per start."""
    if not len(happened):
        return _NO_DATA
    test = stats.binomtest(int(happened.sum()), len(happened))
    interval = test.proportion_ci(0.95, method="wilson")
    return Estimate(float(happened.mean()), float(interval.low), float(interval.high), len(happened))


def bootstrap_mean(values: Float[np.ndarray, " S"], seed: int = 0) -> Estimate:
    """The mean over S starts, with a percentile bootstrap interval (Efron 1979) from resampled starts."""
    return _bootstrap(values, np.mean, seed)


def bootstrap_median(values: Float[np.ndarray, " S"], seed: int = 0) -> Estimate:
    """The median over S starts, with a percentile bootstrap interval from resampled starts."""
    return _bootstrap(values, np.median, seed)


def _bootstrap(values: Float[np.ndarray, " S"], statistic: Callable[..., Any], seed: int) -> Estimate:
    """Values must be finite."""
    if not len(values):
        return _NO_DATA
    found = float(statistic(values, axis=-1))
    if (values == values[0]).all():
        return Estimate(found, found, found, len(values))
    rng = np.random.default_rng(seed)
    result = stats.bootstrap((values,), statistic, n_resamples=RESAMPLES, method="percentile", rng=rng)
    low, high = result.confidence_interval
    return Estimate(found, float(low), float(high), len(values))


def paired_difference(a: Float[np.ndarray, " S"], b: Float[np.ndarray, " S"], seed: int = 0) -> PairedTest:
    """The mean over starts of a − b, resampled by start; p by Fisher's (1935) sign-flip test of the mean.

    Values must be finite. p is 1 if all differences are 0 or there is only one. With many starts, p is at least
    1/(RESAMPLES + 1).
    """
    assert a.shape == b.shape, f"got shapes {a.shape} and {b.shape}, wanted one value per start in both"
    if not len(a):
        return PairedTest(_NO_DATA, np.nan)
    difference = a - b
    if not difference.any() or len(difference) == 1:
        return PairedTest(bootstrap_mean(difference, seed), 1.0)
    flipped = stats.permutation_test(
        (difference,),
        np.mean,
        permutation_type="samples",
        n_resamples=RESAMPLES,
        rng=np.random.default_rng(seed),
    )
    return PairedTest(bootstrap_mean(difference, seed), float(flipped.pvalue))


def mcnemar(a: Bool[np.ndarray, " S"], b: Bool[np.ndarray, " S"], seed: int = 0) -> PairedTest:
    """P(a) − P(b) on the same starts, resampled by start; p by McNemar's (1947) exact test.

    The test uses the starts at which a and b differ. Under the null hypothesis, the number of those with a is binomial
    with probability 1/2. p is 1 if a and b never differ.
    """
    assert a.shape == b.shape, f"got shapes {a.shape} and {b.shape}, wanted one value per start in both"
    if not len(a):
        return PairedTest(_NO_DATA, np.nan)
    only_a, only_b = int((a & ~b).sum()), int((b & ~a).sum())
    p = float(stats.binomtest(only_a, only_a + only_b, 0.5).pvalue) if only_a + only_b else 1.0
    return PairedTest(bootstrap_mean(a.astype(float) - b.astype(float), seed), p)
