"""How well inferred relations match the true ones: scores of P(follow) over ordered pairs, with intervals.

A pair (i, j) is *scored* where i is ahead of j: only there can j follow i. Pairs from behind are counted apart, as
their true answer is always "none".
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import rankdata

BINS = 10  # of the calibration error
RESAMPLES = 1000

Probabilities = Float[np.ndarray, "S F"]
"""P(follow) of F scored pairs in S scenes."""
Truth = Bool[np.ndarray, "S F"]


@dataclass(frozen=True)
class Score:
    """A figure with its 95 % interval over scenes; NaN where it has no meaning for these scenes."""

    value: float
    low: float
    high: float


def balanced_accuracy(p: Probabilities, truth: Truth) -> float:
    """Mean of the shares of true edges found and of missing edges left out; .5 for every constant answer."""
    if truth.all() or not truth.any():
        return float("nan")
    called = p > 0.5
    return float((called[truth].mean() + (~called[~truth]).mean()) / 2)


def false_follow(p: Probabilities, truth: Truth) -> float:
    """Share of the pairs without an edge that are called "follow"."""
    return float((p[~truth] > 0.5).mean()) if (~truth).any() else float("nan")


def macro_f1(p: Probabilities, truth: Truth) -> float:
    """Mean of the F1 scores of "follow" and "none"."""
    if truth.all() or not truth.any():
        return float("nan")
    called = p > 0.5
    values = []
    for right, answer in ((truth, called), (~truth, ~called)):
        hit = (right & answer).sum()
        values.append(2 * hit / (right.sum() + answer.sum()))
    return float(np.mean(values))


def auc(p: Probabilities, truth: Truth) -> float:
    """Probability that a true edge gets a higher P(follow) than a missing one; ties count half."""
    positives = int(truth.sum())
    negatives = truth.size - positives
    if not positives or not negatives:
        return float("nan")
    ranks = rankdata(p.ravel())
    return float((ranks[truth.ravel()].sum() - positives * (positives + 1) / 2) / (positives * negatives))


def calibration_error(p: Probabilities, truth: Truth) -> float:
    """Expected calibration error of the given answer's probability, over ten equal bins from .5 to 1."""
    confidence = np.maximum(p, 1 - p).ravel()
    right = ((p > 0.5) == truth).ravel()
    place = np.minimum(((confidence - 0.5) * 2 * BINS).astype(int), BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    gaps = np.bincount(place, right, BINS) - np.bincount(place, confidence, BINS)
    return float(np.abs(gaps).sum() / counts.sum())


SCORES: dict[str, Callable[[Probabilities, Truth], float]] = {
    "balanced_accuracy": balanced_accuracy,
    "macro_f1": macro_f1,
    "auc": auc,
    "false_follow": false_follow,
    "calibration_error": calibration_error,
}


def score(name: str, p: Probabilities, truth: Truth, seed: int = 0) -> Score:
    """A score with a percentile bootstrap over scenes, as pairs of one scene are not independent."""
    function = SCORES[name]
    rng = np.random.default_rng(seed)
    draws = rng.integers(len(p), size=(RESAMPLES, len(p)))
    values = np.array([function(p[rows], truth[rows]) for rows in draws])
    if np.isnan(values).all():
        return Score(function(p, truth), float("nan"), float("nan"))
    low, high = np.nanquantile(values, (0.025, 0.975))
    return Score(function(p, truth), float(low), float(high))
