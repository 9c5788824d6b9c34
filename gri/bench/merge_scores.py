"""How well inferred relations of merges match the true ones, per step and per scene, with intervals over scenes."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from gri.bench.scores import Score
from gri.core.edges import LANE_CHANGING, EdgeType
from gri.evaluation.graph_scores import f1_of_types

K = len(LANE_CHANGING)
RESAMPLES = 200
LEAST_SHARE = 0.01  # of a pair's steps; a rarer relation is not scored in "balanced"
BINS = 10

Answer = Int[np.ndarray, "S T E"]


def macro_f1(answer: Answer, truth: Answer) -> float:
    """Mean F1 of the relations that occur, over all pairs and steps together."""
    return float(np.nanmean(f1_by_type(answer, truth)))


def f1_by_type(answer: Answer, truth: Answer) -> Float[np.ndarray, " K"]:
    """F1 of each relation; NaN for one that does not occur."""
    return f1_of_types(answer, truth, K)


def accuracy(answer: Int[np.ndarray, "S *E"], truth: Int[np.ndarray, "S *E"]) -> float:
    """Share of right answers over all pairs, and steps if there are any."""
    return float((answer == truth).mean())


def balanced_accuracy(answer: Answer, truth: Answer) -> float:
    """Every relation of a pair weighs equally, in each half of a scene; so no constant exceeds about one half.

    Pairs and halves with one relation only are left out, and relations with less than 1 % of a half's steps.
    """
    middle, found = truth.shape[1] // 2, []
    for half in (slice(None, middle), slice(middle, None)):
        for e in range(truth.shape[2]):
            true, given = truth[:, half, e], answer[:, half, e]
            kinds = [k for k in range(K) if (true == k).mean() >= LEAST_SHARE]
            if len(kinds) > 1:
                found.append(np.mean([(given[true == k] == k).mean() for k in kinds]))
    return float(np.mean(found)) if found else float("nan")


def _f1_of(k: int) -> Callable[[Answer, Answer], float]:
    return lambda answer, truth: float(f1_by_type(answer, truth)[k])


STEP_SCORES: dict[str, Callable[[Answer, Answer], float]] = {
    "step_macro_f1": macro_f1,
    "step_accuracy": accuracy,
    "step_balanced_accuracy": balanced_accuracy,
    **{f"step_f1_{kind}": _f1_of(k) for k, kind in enumerate(LANE_CHANGING)},
}


def with_interval(
    function: Callable[[np.ndarray, np.ndarray], float], answer: np.ndarray, truth: np.ndarray, seed: int = 0
) -> Score:
    """A score with its 95 % interval by bootstrap over scenes; NaN without scenes."""
    if not len(answer):
        return Score(float("nan"), float("nan"), float("nan"))
    rng = np.random.default_rng(seed)
    draws = (rng.integers(len(answer), size=len(answer)) for _ in range(RESAMPLES))
    values = [function(answer[rows], truth[rows]) for rows in draws]
    if np.isnan(values).all():
        return Score(function(answer, truth), float("nan"), float("nan"))
    low, high = np.nanquantile(values, (0.025, 0.975))
    return Score(function(answer, truth), float(low), float(high))


def calibration_error(p: Float[np.ndarray, "S T E K"], truth: Answer) -> float:
    """Expected calibration error of the most probable relation, over ten bins from 1/K to 1."""
    confidence, right = p.max(-1).ravel(), (p.argmax(-1) == truth).ravel()
    place = np.minimum(((confidence - 1 / K) / (1 - 1 / K) * BINS).astype(int), BINS - 1)
    gaps = np.bincount(place, right, BINS) - np.bincount(place, confidence, BINS)
    return float(np.abs(gaps).sum() / len(right))


def claimed(
    answer: Answer, impossible: tuple[tuple[int, tuple[int, ...]], ...], counts: Bool[np.ndarray, " T"]
) -> Float[np.ndarray, " S"]:
    """Share of the counted steps of each scene in which one of the impossible relations is inferred.

    `impossible` holds (place of the pair, relations).
    """
    wrong = [np.isin(answer[:, counts, e], kinds) for e, kinds in impossible]
    return np.stack(wrong).any(0).mean(-1)


NAMES = tuple(str(EdgeType(kind)) for kind in LANE_CHANGING)
