"""Comparison of inferred graphs with the true relations of a simulator, and with those that the geometry suggests."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from rich.table import Table
from torch import Tensor

from gri.core.graph import Vocabulary
from gri.evaluation import metrics
from gri.evaluation.metrics import Summary


@dataclass(frozen=True)
class TruthComparison:
    """Accuracies over all edges, and confusion matrices of the edge types."""

    accuracy: dict[str, Summary]
    """Accuracy of the inferred graphs, of the hypothesis, and of the constant graph of the most frequent types."""
    confusion: dict[str, Int[Tensor, "K K"]]
    """Number of edges by true type (row) and inferred type (column)."""


def compare_with_truth(
    inferred: Int[Tensor, "S E"],
    true: Int[Tensor, "S E"],
    hypothesis: Int[Tensor, "S E"],
    unambiguous: Bool[Tensor, " S"],
) -> TruthComparison:
    """Compare the graphs on all scenes, and on the unambiguous ones alone.

    A scene is unambiguous if its graph contains all relations of its steps.
    """
    kinds = int(torch.stack([inferred, true]).max()) + 1
    accuracy, confusion, parts = {}, {}, {"": torch.ones_like(unambiguous)}
    if count := int(unambiguous.sum()):
        parts[f", {count} unambiguous scenes"] = unambiguous
    for name, chosen in parts.items():
        i, t, h = inferred[chosen], true[chosen], hypothesis[chosen]
        pairs = {"inferred, truth": (i, t), "inferred, hypothesis": (i, h), "hypothesis, truth": (h, t)}
        pairs["most frequent, truth"] = t.mode(0).values.expand_as(t), t
        accuracy |= {f"{what}{name}": metrics.summary(metrics.accuracy(*both)) for what, both in pairs.items()}
        confusion[name] = torch.bincount((t * kinds + i).flatten(), minlength=kinds * kinds).reshape(kinds, kinds)
    return TruthComparison(accuracy, confusion)


def truth_tables(found: TruthComparison, vocabulary: Vocabulary) -> Iterator[Table]:
    """The comparison as tables for the terminal."""
    accuracy = Table("accuracy, 6 edges", "mean ± std over scenes", "95 % ±", title="Beside the simulator's truth")
    for name, value in found.accuracy.items():
        accuracy.add_row(name, str(value), f"{value.half_width:.4f}")
    yield accuracy
    for name, counts in found.confusion.items():
        names = [str(kind) for kind in vocabulary[: len(counts)]]
        confusion = Table("true, inferred as", *names, title=f"Edges by type{name}")
        for kind, row in zip(names, counts.tolist(), strict=True):
            confusion.add_row(kind, *map(str, row))
        yield confusion
