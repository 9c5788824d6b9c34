"""How well the relations of every step match the true ones, with intervals over scenes.

All scores are sums over scenes of counts, so that the bootstrap draws scenes and not steps.
"""

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int

from gri.bench.scores import BINS, RESAMPLES, Score

Types = Int[np.ndarray, "S *rest"]
Probabilities = Float[np.ndarray, "S *rest K"]
Counts = Float[np.ndarray, "R F"]


def confusion_counts(called: Types, truth: Types, scored: Bool[np.ndarray, "S *rest"], kinds: int) -> np.ndarray:
    """Number of scored answers of each scene by true type and called type, [S, K·K]."""
    scenes = np.broadcast_to(np.arange(len(truth)).reshape(-1, *[1] * (truth.ndim - 1)), truth.shape)
    place = (scenes * kinds + truth) * kinds + called
    return np.bincount(place[scored], minlength=len(truth) * kinds**2).reshape(len(truth), kinds**2).astype(float)


def calibration_counts(p: Probabilities, truth: Types, scored: Bool[np.ndarray, "S *rest"]) -> np.ndarray:
    """For each scene and bin of the given answer's probability: answers, right ones minus confidence, [S, 2·bins]."""
    called, confidence = p.argmax(-1), p.max(-1)
    scenes = np.broadcast_to(np.arange(len(truth)).reshape(-1, *[1] * (truth.ndim - 1)), truth.shape)
    place = (scenes * BINS + np.minimum((confidence * BINS).astype(int), BINS - 1))[scored]
    size = len(truth) * BINS
    number = np.bincount(place, minlength=size)
    surplus = np.bincount(place, ((called == truth) - confidence)[scored], minlength=size)
    return np.concatenate([number.reshape(-1, BINS), surplus.reshape(-1, BINS)], 1).astype(float)


def accuracy(counts: Counts) -> Float[np.ndarray, " R"]:
    """Share of right answers, from counts [R, K·K]."""
    matrix = _square(counts)
    return np.trace(matrix, axis1=1, axis2=2) / matrix.sum((1, 2))


def macro_f1(counts: Counts) -> Float[np.ndarray, " R"]:
    """Mean F1 of the types that are true somewhere, from counts [R, K·K]."""
    matrix = _square(counts)
    true, called, hit = matrix.sum(2), matrix.sum(1), np.diagonal(matrix, axis1=1, axis2=2)
    f1 = np.where(true > 0, 2 * hit / np.maximum(true + called, 1), np.nan)
    return np.nanmean(f1, 1)


def recall(kind: int) -> Callable[[Counts], Float[np.ndarray, " R"]]:
    """Share of the steps of a type that are found; NaN where it does not occur."""

    def share(counts: Counts) -> Float[np.ndarray, " R"]:
        matrix = _square(counts)
        true = matrix[:, kind].sum(-1)
        return np.where(true > 0, matrix[:, kind, kind] / np.maximum(true, 1), np.nan)

    return share


def false_relation(counts: Counts) -> Float[np.ndarray, " R"]:
    """Share of the steps without a relation for which one is claimed; type 0 is "none"."""
    matrix = _square(counts)
    return 1 - matrix[:, 0, 0] / matrix[:, 0].sum(-1)


def calibration_error(counts: Counts) -> Float[np.ndarray, " R"]:
    """Expected calibration error of the given answer over ten equal bins, from `calibration_counts`."""
    return np.abs(counts[:, BINS:]).sum(1) / counts[:, :BINS].sum(1)


def with_interval(
    function: Callable[[Counts], Float[np.ndarray, " R"]], counts: Float[np.ndarray, "S F"], seed: int = 0
) -> Score:
    """A score of the sum of the scenes' counts, with a percentile bootstrap over scenes; NaN where nothing counts."""
    if not counts.sum():
        return Score(float("nan"), float("nan"), float("nan"))
    with np.errstate(invalid="ignore", divide="ignore"):
        values = function(_resamples(len(counts), seed) @ counts)
    value = float(function(counts.sum(0, keepdims=True))[0])
    if np.isnan(values).all():
        return Score(value, float("nan"), float("nan"))
    low, high = np.nanquantile(values, (0.025, 0.975))
    return Score(value, float(low), float(high))


@cache
def _resamples(scenes: int, seed: int) -> Float[np.ndarray, "R S"]:
    """How often each scene is drawn in each bootstrap sample."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(scenes, np.full(scenes, 1 / scenes), size=RESAMPLES).astype(float)


def scores_of(
    p: Float[np.ndarray, "S T E K"],
    truth: Int[np.ndarray, "S T E"],
    scored: Bool[np.ndarray, "S T E"],
    names: tuple[str, ...],
) -> Mapping[str, Score]:
    """Scores of every step: accuracy, macro-F1, the recall of each type by its name, calibration error."""
    counts = confusion_counts(p.argmax(-1), truth, scored, len(names))
    found = {"accuracy": with_interval(accuracy, counts), "macro_f1": with_interval(macro_f1, counts)}
    found |= {f"recall_{name}": with_interval(recall(kind), counts) for kind, name in enumerate(names)}
    return found | {"calibration_error": with_interval(calibration_error, calibration_counts(p, truth, scored))}


def _square(counts: Counts) -> Float[np.ndarray, "R K K"]:
    kinds = round(counts.shape[1] ** 0.5)
    return counts.reshape(-1, kinds, kinds)
