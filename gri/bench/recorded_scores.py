"""Scores of inferred relations in recorded traffic, with intervals clustered by vehicle."""

import numpy as np
from jaxtyping import Bool, Float, Int

from gri.bench.scores import Score, auc

RESAMPLES = 400


def share(
    hit: Bool[np.ndarray, "S F"], counted: Bool[np.ndarray, "S F"], cluster: Int[np.ndarray, " S"], seed: int = 0
) -> Score:
    """Share of the counted pairs that are a hit, with a 95 % bootstrap interval over clusters; NaN if none counts."""
    sums = [np.bincount(_places(cluster), weights=part.sum(1)) for part in (hit & counted, counted)]
    if not sums[1].sum():
        return Score(*(float("nan"),) * 3)
    drawn = np.stack([np.bincount(rows, minlength=len(sums[0])) for rows in _draws(len(sums[0]), seed)])
    with np.errstate(invalid="ignore"):
        values = (drawn @ sums[0]) / (drawn @ sums[1])
    return Score(float(sums[0].sum() / sums[1].sum()), *map(float, np.nanquantile(values, (0.025, 0.975))))


def ranking(
    p: Float[np.ndarray, " P"], truth: Bool[np.ndarray, " P"], cluster: Int[np.ndarray, " P"], seed: int = 0
) -> Score:
    """Area under the ROC curve of P(follow), with a 95 % bootstrap interval over clusters."""
    place = _places(cluster)
    members = [np.flatnonzero(place == which) for which in range(place.max() + 1)]
    values = []
    for rows in _draws(len(members), seed):
        chosen = np.concatenate([members[which] for which in rows])
        values.append(auc(p[chosen, None], truth[chosen, None]))
    value = auc(p[:, None], truth[:, None])
    if np.isnan(values).all():
        return Score(value, float("nan"), float("nan"))
    return Score(value, *map(float, np.nanquantile(values, (0.025, 0.975))))


def _places(cluster: Int[np.ndarray, " S"]) -> Int[np.ndarray, " S"]:
    return np.unique(cluster, return_inverse=True)[1]


def _draws(clusters: int, seed: int) -> Int[np.ndarray, "R C"]:
    return np.random.default_rng(seed).integers(clusters, size=(RESAMPLES, clusters))
