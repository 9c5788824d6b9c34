"""How well inferred relations match the true ones: scores of P(follow) over ordered pairs, with intervals.

A pair (i, j) is *scored* where i is ahead of j: only there can j follow i. Pairs from behind are counted apart, as
their true answer is always "none".

A row that does not know can abstain. `risk_curve` is its share of wrong answers among the pairs that it trusts most,
and `abstention_area` the mean of that share over all coverages. `unknown_auc` asks whether a row trusts itself less in
an unknown world than in the known one.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import rankdata

BINS = 10  # of the calibration error
RESAMPLES = 300

Probabilities = Float[np.ndarray, "S F"]
"""P(follow) of F scored pairs in S scenes."""
Truth = Bool[np.ndarray, "S F"]
Uncertainty = Float[np.ndarray, "S F"]
"""How little a row trusts each answer; only the order counts."""
COVERAGES = tuple(np.linspace(0.05, 1.0, 20).round(2).tolist())


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


def reliability(p: Probabilities, truth: Truth) -> dict[str, list[float]]:
    """The reliability diagram over ten equal bins of P(follow): pairs, their mean P(follow) and share of true edges.

    Sums instead of means, so that seeds can be added.
    """
    place = np.minimum((p * BINS).astype(int), BINS - 1).ravel()
    return {
        "pairs": np.bincount(place, minlength=BINS).astype(float).tolist(),
        "p": np.bincount(place, p.ravel(), BINS).tolist(),
        "true": np.bincount(place, truth.ravel(), BINS).tolist(),
    }


def _errors_by_trust(p: Probabilities, truth: Truth, uncertainty: Uncertainty) -> Float[np.ndarray, " P"]:
    """Wrong answers (0 or 1), those that are trusted most first; pairs trusted alike share their mean."""
    wrong = ((p > 0.5) != truth).ravel().astype(float)
    _, group = np.unique(uncertainty.ravel(), return_inverse=True)
    mean = np.bincount(group, wrong) / np.bincount(group)
    return mean[np.sort(group)]


def risk_curve(p: Probabilities, truth: Truth, uncertainty: Uncertainty) -> list[float]:
    """Share of wrong answers among the share of pairs that is trusted most, at each of `COVERAGES`."""
    wrong = _errors_by_trust(p, truth, uncertainty)
    counts = np.ceil(np.array(COVERAGES) * len(wrong)).astype(int)
    return (wrong.cumsum()[counts - 1] / counts).tolist()


def abstention_area(p: Probabilities, truth: Truth, uncertainty: Uncertainty) -> float:
    """Area under the curve of risk against coverage (Geifman and El-Yaniv 2017); the smaller, the better.

    A row whose trust says nothing has its share of wrong answers here.
    """
    wrong = _errors_by_trust(p, truth, uncertainty)
    return float((wrong.cumsum() / np.arange(1, len(wrong) + 1)).mean())


def unknown_auc(uncertainty: Float[np.ndarray, " S"], unknown: Bool[np.ndarray, " S"]) -> float:
    """Probability that a scene of an unknown world is trusted less than one of the known world; ties count half."""
    return auc(uncertainty[:, None], unknown[:, None])


SCORES: dict[str, Callable[[Probabilities, Truth], float]] = {
    "balanced_accuracy": balanced_accuracy,
    "macro_f1": macro_f1,
    "auc": auc,
    "false_follow": false_follow,
    "calibration_error": calibration_error,
}


def score(name: str, p: Probabilities, truth: Truth, seed: int = 0) -> Score:
    """One of `SCORES` with its interval."""
    return bootstrap(SCORES[name], p, truth, seed=seed)


def bootstrap(function: Callable[..., float], *values: np.ndarray, seed: int = 0) -> Score:
    """A score of arrays that share the axis of scenes, with a percentile bootstrap over scenes.

    Pairs of one scene are not independent, so that whole scenes are drawn.
    """
    rng = np.random.default_rng(seed)
    draws = rng.integers(len(values[0]), size=(RESAMPLES, len(values[0])))
    found = np.array([function(*(value[rows] for value in values)) for rows in draws])
    if np.isnan(found).all():
        return Score(function(*values), float("nan"), float("nan"))
    low, high = np.nanquantile(found, (0.025, 0.975))
    return Score(function(*values), float(low), float(high))
