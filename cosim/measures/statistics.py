"""Intervals and paired tests, by scipy. Every function says what it estimates.

A *start* is one group at its take-over. Shares and means are over starts that were drawn from the traffic of a
scenario; policies are compared on the same starts, so that differences between starts drop out.
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
    """A value with the ends of its 95 % confidence interval; all NaN where there is nothing to estimate from."""

    value: float
    low: float
    high: float
    n: int


@dataclass(frozen=True)
class PairedTest:
    """A difference a − b on the same starts, and the two-sided p-value of "there is none"."""

    difference: Estimate
    p: float


_NOTHING = Estimate(np.nan, np.nan, np.nan, 0)


def wilson(happened: Bool[np.ndarray, " S"]) -> Estimate:
    """The probability that something happens from a start, with Wilson's (1927) score interval."""
    if not len(happened):
        return _NOTHING
    test = stats.binomtest(int(happened.sum()), len(happened))
    interval = test.proportion_ci(0.95, method="wilson")
    return Estimate(float(happened.mean()), float(interval.low), float(interval.high), len(happened))


def bootstrap_mean(values: Float[np.ndarray, " S"], seed: int = 0) -> Estimate:
    """The mean over starts, with a percentile bootstrap interval (Efron 1979) from resampled starts."""
    return _bootstrap(values, np.mean, seed)


def bootstrap_median(values: Float[np.ndarray, " S"], seed: int = 0) -> Estimate:
    """The median over starts, with an interval made likewise."""
    return _bootstrap(values, np.median, seed)


def _bootstrap(values: Float[np.ndarray, " S"], statistic: Callable[..., Any], seed: int) -> Estimate:
    """Values must be finite."""
    if not len(values):
        return _NOTHING
    found = float(statistic(values, axis=-1))
    if (values == values[0]).all():
        return Estimate(found, found, found, len(values))
    rng = np.random.default_rng(seed)
    result = stats.bootstrap((values,), statistic, n_resamples=RESAMPLES, method="percentile", rng=rng)
    low, high = result.confidence_interval
    return Estimate(found, float(low), float(high), len(values))


def paired_difference(a: Float[np.ndarray, " S"], b: Float[np.ndarray, " S"], seed: int = 0) -> PairedTest:
    """The mean over starts of a − b, resampled by start; p by Fisher's (1935) sign-flip test of the mean.

    Values must be finite. p is 1 where all differences are 0 or there is one only, and never below 1/(RESAMPLES + 1)
    where starts are many.
    """
    assert a.shape == b.shape, f"pairs wanted, got {a.shape} and {b.shape}"
    if not len(a):
        return PairedTest(_NOTHING, np.nan)
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

    The test looks only at the starts where the two differ: if a and b are equally likely to be the one that happens,
    how often it is a is binomial with probability 1/2. p is 1 where they never differ.
    """
    assert a.shape == b.shape, f"pairs wanted, got {a.shape} and {b.shape}"
    if not len(a):
        return PairedTest(_NOTHING, np.nan)
    only_a, only_b = int((a & ~b).sum()), int((b & ~a).sum())
    p = float(stats.binomtest(only_a, only_a + only_b, 0.5).pvalue) if only_a + only_b else 1.0
    return PairedTest(bootstrap_mean(a.astype(float) - b.astype(float), seed), p)
