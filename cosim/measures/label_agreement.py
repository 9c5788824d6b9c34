"""Agreement of two sets of labels: confusion matrix, Cohen's kappa, precision and recall."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True)
class Agreement:
    """Confusion matrix: `counts[i, j]` items have label i (of K) from the source and label j in the reference."""

    counts: Int[np.ndarray, "K K"]

    def __add__(self, other: "Agreement") -> "Agreement":
        return Agreement(self.counts + other.counts)

    @property
    def total(self) -> int:
        return int(self.counts.sum())

    @property
    def kappa(self) -> float:
        """Cohen's (1960) kappa: agreement beyond the one expected by chance; NaN without labels."""
        total = self.counts.sum()
        if not total:
            return float("nan")
        observed = np.trace(self.counts) / total
        expected = float((self.counts.sum(0) / total) @ (self.counts.sum(1) / total))
        return float((observed - expected) / (1 - expected)) if expected < 1 else 1.0

    def precision(self, kind: int) -> float:
        """Share of the labels of this kind that the reference confirms; NaN without such labels."""
        return _share(self.counts[kind, kind], self.counts[kind].sum())

    def recall(self, kind: int) -> float:
        """Share of this kind in the reference that has this label; NaN without such items."""
        return _share(self.counts[kind, kind], self.counts[:, kind].sum())


def agreement(labels: Int[np.ndarray, "..."], reference: Int[np.ndarray, "..."], kinds: int) -> Agreement:
    """Compare labels (0 to kinds − 1) with reference labels of the same items and the same shape."""
    counts = np.bincount(labels.ravel() * kinds + reference.ravel(), minlength=kinds * kinds)
    return Agreement(counts.reshape(kinds, kinds))


def _share(part: np.integer, whole: np.integer) -> float:
    return float(part / whole) if whole else float("nan")
