"""Confidence intervals and paired tests for clustered starts, by scipy.

A *start* is one group at its take-over. Starts of one seed share their traffic, so their results resemble each other.
They form a *cluster*. All intervals and tests below take clusters as the independent units, not starts. They hold 95 %
and 5 % in simulations with 6 to 20 clusters and with correlation inside them (tests/cosim/measures/test_statistics.py).
The percentile bootstrap over clusters does not: with 6 clusters it covers 85 %.

Policies are compared on the same starts, so that differences between starts cancel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Shaped
from scipy import stats

RESAMPLES = 9999
LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """A value with the ends of its 95 % confidence interval.

    `n` is the number of values, `clusters` that of their clusters. All numbers are NaN without data; the ends are NaN
    with one cluster, which says nothing about the spread between clusters. Where some outcomes are unknown, they count
    as not happened in `value` and `low`, and as happened in `most` and `high`; otherwise `most` is NaN.
    """

    value: float
    low: float
    high: float
    n: int
    clusters: int
    most: float = np.nan


@dataclass(frozen=True)
class PairedTest:
    """A difference a − b on the same starts, and the two-sided p-value of the hypothesis that there is none.

    `p_corrected` is p, corrected for the number of tests in the table (`corrected`); NaN before that.
    """

    difference: Estimate
    p: float
    p_corrected: float = np.nan

    @property
    def significant(self) -> bool:
        """Whether there is a difference, at 5 % after the correction."""
        return bool(self.p_corrected < 1 - LEVEL)


_NO_DATA = Estimate(np.nan, np.nan, np.nan, 0, 0)


def share(happened: Bool[np.ndarray, " S"], clusters: Shaped[np.ndarray, " S"]) -> Estimate:
    """Probability of an event at a start, with the interval of Korn and Graubard (1998) for clustered data.

    It is the exact binomial interval (Clopper and Pearson 1934) of a smaller number of independent starts: as many as
    have the standard error of these clusters.
    """
    if not len(happened):
        return _NO_DATA
    n, groups = _effective_size(happened.astype(float), clusters), len(np.unique(clusters))
    value = float(happened.mean())
    low, high = _binomial_interval(value, n) if groups > 1 else (np.nan, np.nan)
    return Estimate(value, low, high, len(happened), groups)


def mean(values: Float[np.ndarray, " S"], clusters: Shaped[np.ndarray, " S"]) -> Estimate:
    """The mean over starts, with a t-interval from the sums of the clusters; values must be finite.

    The standard error is that of a ratio, sum over number (Cochran 1977, Sec. 6.3 and 9A). One start weighs as much as
    any other.
    """
    if not len(values):
        return _NO_DATA
    value, groups = float(values.mean()), len(np.unique(clusters))
    margin = stats.t.ppf((1 + LEVEL) / 2, groups - 1) * _standard_error(values, clusters) if groups > 1 else np.nan
    return Estimate(value, float(value - margin), float(value + margin), len(values), groups)


def median(values: Float[np.ndarray, " S"], clusters: Shaped[np.ndarray, " S"]) -> Estimate:
    """The median over starts, with the interval of Woodruff (1952); values must be finite.

    Its ends are the quantiles at the ends of the interval of the share of values up to the median.
    """
    if not len(values):
        return _NO_DATA
    value, groups = float(np.median(values)), len(np.unique(clusters))
    if groups == 1:
        return Estimate(value, np.nan, np.nan, len(values), groups)
    n = _effective_size((values <= value).astype(float), clusters)
    low, high = np.quantile(values, _binomial_interval(0.5, n))
    return Estimate(value, float(low), float(high), len(values), groups)


def paired_difference(
    a: Shaped[np.ndarray, " S"], b: Shaped[np.ndarray, " S"], clusters: Shaped[np.ndarray, " S"], seed: int = 0
) -> PairedTest:
    """The mean over starts of a − b; p by Fisher's (1935) sign-flip test of the clusters' sums.

    The null hypothesis is that exchanging both policies in all starts of a cluster changes nothing. Values must be
    finite numbers or booleans. If each start is a cluster of its own, the test of booleans is McNemar's (1947) exact
    test. p is 1 for one cluster, at least 2/2^G for G clusters, and at least 1/(RESAMPLES + 1).

    The interval of a difference of shares (booleans) also covers the one with two starts more, each a cluster of its
    own: one at which only a happened, one at which only b did (Bonett and Price 2012). So it has a width where a and b
    never differ.
    """
    assert a.shape == b.shape, f"got shapes {a.shape} and {b.shape}, wanted one value per start in both"
    if not len(a):
        return PairedTest(_NO_DATA, np.nan)
    shares, difference = a.dtype == bool, a.astype(float) - b.astype(float)
    found = mean(difference, clusters)
    index = np.unique(clusters, return_inverse=True)[1]
    if shares and found.clusters > 1:
        added = mean(np.append(difference, [1.0, -1.0]), np.append(index, [-1, -2]))
        low, high = min(added.low, found.low), max(added.high, found.high)
        found = Estimate(found.value, max(low, -1.0), min(high, 1.0), found.n, found.clusters)
    sums = np.bincount(index, difference)
    sums = sums[sums != 0]  # flipping the others changes nothing
    if len(sums) < 2:
        return PairedTest(found, 1.0)
    flipped = stats.permutation_test(
        (sums,), np.mean, permutation_type="samples", n_resamples=RESAMPLES, rng=np.random.default_rng(seed)
    )
    return PairedTest(found, float(flipped.pvalue))


def with_correction(tests: Sequence[PairedTest]) -> list[PairedTest]:
    """The tests of one table with `p_corrected`."""
    p = corrected(np.array([test.p for test in tests], dtype=float))
    return [replace(test, p_corrected=float(found)) for test, found in zip(tests, p, strict=True)]


def corrected(p: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
    """The p-values of K tests, corrected for their number by Benjamini and Hochberg (1995); NaN stays NaN.

    Among the tests with a corrected p-value below 5 %, the expected share of true null hypotheses is at most 5 %. This
    holds for independent and for positively dependent tests.
    """
    known = np.isfinite(p)
    adjusted = np.full(p.shape, np.nan)
    adjusted[known] = stats.false_discovery_control(p[known])
    return adjusted


def _standard_error(values: Float[np.ndarray, " S"], clusters: Shaped[np.ndarray, " S"]) -> float:
    """Standard error of the mean over starts, from the clusters' sums; there are at least two clusters."""
    index = np.unique(clusters, return_inverse=True)[1]
    residuals = np.bincount(index, values - values.mean())
    groups = len(residuals)
    return float(np.sqrt(groups / (groups - 1) * (residuals**2).sum()) / len(values))


def _effective_size(values: Float[np.ndarray, " S"], clusters: Shaped[np.ndarray, " S"]) -> float:
    """Number of independent starts whose mean is known as well as that of these; at most their number.

    It is smaller, too, by the ratio of normal and t quantiles, because few clusters know their spread badly.
    """
    groups = len(np.unique(clusters))
    if groups < 2:
        return np.nan
    variance = float(values.var())
    effect = _standard_error(values, clusters) ** 2 / (variance / len(values)) if variance else 1.0
    quantile = (1 + LEVEL) / 2
    few = float(stats.norm.ppf(quantile) / stats.t.ppf(quantile, groups - 1)) ** 2
    return few * len(values) / max(effect, 1.0)


def _binomial_interval(p: float, n: float) -> tuple[float, float]:
    """The exact interval of a share p of n independent starts; n may be a fraction."""
    tail, happened = (1 - LEVEL) / 2, p * n
    low = stats.beta.ppf(tail, happened, n - happened + 1) if p > 0 else 0.0
    high = stats.beta.ppf(1 - tail, happened + 1, n - happened) if p < 1 else 1.0
    return float(low), float(high)
