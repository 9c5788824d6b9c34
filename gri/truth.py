"""Inferred graphs beside the relations that a simulator knows, and beside what the geometry suggests."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from rich.table import Table
from torch import Tensor

from gri import metrics
from gri.graph import Vocabulary
from gri.metrics import Summary


@dataclass(frozen=True)
class BesideTruth:
    """Accuracies over all six edges, and who is taken for what."""

    accuracy: dict[str, Summary]
    """Of inferred graphs and of the hypothesis."""
    confusion: Int[Tensor, "K K"]
    """Edges by true type (row) and inferred type (column)."""


def beside_truth(
    inferred: Int[Tensor, "S E"],
    true: Int[Tensor, "S E"],
    hypothesis: Int[Tensor, "S E"],
    unambiguous: Bool[Tensor, " S"],
) -> BesideTruth:
    """Compare graphs, also on those scenes alone whose one graph says all that their steps say."""
    pairs = {
        "inferred, truth": (inferred, true),
        "inferred, hypothesis": (inferred, hypothesis),
        "hypothesis, truth": (hypothesis, true),
    }
    accuracy = {name: metrics.summary(metrics.accuracy(*both)) for name, both in pairs.items()}
    if bool(unambiguous.any()):
        for name, (one, other) in pairs.items():
            right = metrics.accuracy(one[unambiguous], other[unambiguous])
            accuracy[f"{name}, {int(unambiguous.sum())} unambiguous scenes"] = metrics.summary(right)
    kinds = int(torch.stack([inferred, true]).max()) + 1
    counts = torch.bincount((true * kinds + inferred).flatten(), minlength=kinds * kinds)
    return BesideTruth(accuracy, counts.reshape(kinds, kinds))


def truth_tables(found: BesideTruth, vocabulary: Vocabulary) -> Iterator[Table]:
    """What a person reads."""
    accuracy = Table("accuracy, 6 edges", "mean ± std over scenes", "95 % ±", title="Beside the simulator's truth")
    for name, value in found.accuracy.items():
        accuracy.add_row(name, str(value), f"{value.half_width:.4f}")
    yield accuracy
    names = [str(kind) for kind in vocabulary[: len(found.confusion)]]
    confusion = Table("true, inferred as", *names, title="Edges by type")
    for name, row in zip(names, found.confusion.tolist(), strict=True):
        confusion.add_row(name, *map(str, row))
    yield confusion
