"""How far two sets of labels agree."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int


@dataclass(frozen=True)
class Agreement:
    """Counts of labels that one source (row) and the truth (column) gave the same things."""

    counts: Int[np.ndarray, "K K"]

    def __add__(self, other: "Agreement") -> "Agreement":
        return Agreement(self.counts + other.counts)

    @property
    def total(self) -> int:
        return int(self.counts.sum())

    @property
    def kappa(self) -> float:
        """Cohen's kappa: agreement beyond what the two sources' frequencies alone would give; nan without labels."""
        total = self.counts.sum()
        if not total:
            return float("nan")
        agreed = np.trace(self.counts) / total
        by_chance = float((self.counts.sum(0) / total) @ (self.counts.sum(1) / total))
        return float((agreed - by_chance) / (1 - by_chance)) if by_chance < 1 else 1.0

    def precision(self, kind: int) -> float:
        """Share of the labels of a kind that are true; nan where there are none."""
        return _share(self.counts[kind, kind], self.counts[kind].sum())

    def recall(self, kind: int) -> float:
        """Share of the truth of a kind that is labelled so; nan where there is none."""
        return _share(self.counts[kind, kind], self.counts[:, kind].sum())


def agreement(labels: Int[np.ndarray, "..."], truth: Int[np.ndarray, "..."], kinds: int) -> Agreement:
    """Compare labels 0 to kinds - 1 with the truth about the same things."""
    counts = np.bincount(labels.ravel() * kinds + truth.ravel(), minlength=kinds * kinds)
    return Agreement(counts.reshape(kinds, kinds))


def _share(part: np.integer, whole: np.integer) -> float:
    return float(part / whole) if whole else float("nan")
