"""Comparison of inferred graphs with the true relations of a simulator, and with those that the geometry suggests."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from gri.core.graph import Vocabulary
from gri.evaluation import metrics
from gri.evaluation.metrics import Summary
from gri.table import Table


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
    """The comparison as tables."""
    yield Table(
        "truth",
        ["accuracy, 6 edges", "mean ± std over scenes", "95 % ±"],
        [[name, str(value), f"{value.half_width:.4f}"] for name, value in found.accuracy.items()],
        [{"metric": name, **summary_record(value)} for name, value in found.accuracy.items()],
        title="Beside the simulator's truth",
    )
    for name, counts in found.confusion.items():
        names = [str(kind) for kind in vocabulary[: len(counts)]]
        rows = list(zip(names, counts.tolist(), strict=True))
        yield Table(
            f"confusion{name}",
            ["true, inferred as", *names],
            [[kind, *map(str, row)] for kind, row in rows],
            [{"true": kind, **dict(zip(names, row, strict=True))} for kind, row in rows],
            title=f"Edges by type{name}",
        )


def summary_record(value: Summary) -> dict[str, float]:
    """The numbers of a summary for CSV and JSON."""
    return {"mean": value.mean, "std": value.std, "half_width": value.half_width, "scenes": value.scenes}
