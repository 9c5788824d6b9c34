"""Inferred relations as a Parquet table, and what is said about them on the terminal."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Int

from gri.data.scene_file.reading import has_step_edges, read_step_edges
from gri.evaluation.graph_scores import f1_of_types
from gri.inference.step_relations import StepRelations
from gri.storage.whole_files import whole_file
from gri.table import Table

DIGITS = 6  # of probabilities in the file


def frame_of(found: StepRelations) -> pd.DataFrame:
    """One row per scene, step and ordered pair (docs/infer.md lists the columns)."""
    s, w, e, _ = found.probs.shape
    sender, receiver = np.array(found.pairs).T
    frame = pd.DataFrame(
        {
            "kind": found.kind,
            "scene": np.repeat(found.scene, w * e),
            "step": np.tile(np.repeat(found.step, e), s).astype(np.int16),
            "sender": np.tile(sender, s * w).astype(np.int8),
            "receiver": np.tile(receiver, s * w).astype(np.int8),
        }
    )
    names = [str(kind) for kind in found.vocabulary]
    frame["relation"] = np.array(names)[found.probs.argmax(-1).ravel()]
    for k, name in enumerate(names):
        frame[f"p_{name}"] = found.probs[..., k].ravel().round(DIGITS)
    frame["unknown"] = np.nan if found.unknown is None else np.repeat(found.unknown.ravel(), e).round(DIGITS)
    return frame


def write(path: Path, results: Sequence[StepRelations]) -> None:
    """All results in one Parquet file; it appears whole or not at all, and equal results give equal bytes."""
    frame = pd.concat([frame_of(found) for found in results], ignore_index=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        frame.to_parquet(part, index=False, compression="zstd")


def shares(found: StepRelations) -> Table:
    """How often each relation is the most probable one, per pair, over all scenes and steps."""
    answer, names = found.probs.argmax(-1), [str(kind) for kind in found.vocabulary]
    records = [
        {"pair": f"{i}→{j}"} | {name: float((answer[..., e] == k).mean()) for k, name in enumerate(names)}
        for e, (i, j) in enumerate(found.pairs)
    ]
    remark = ""
    if found.unknown is not None:
        remark = f"; not known to the model: {(found.unknown > 1).mean():.1%} of the steps"
    lines = [[r["pair"], *(f"{100 * r[name]:.1f}" for name in names)] for r in records]
    title = f"{found.kind}: {len(found.scene)} scenes, {len(found.step)} steps each{remark}"
    return Table("shares", ["i→j: j to i", *(f"{n} [%]" for n in names)], lines, records, title=title)


def scores(path: Path, found: StepRelations, split: str | None = None) -> Table | None:
    """Scores beside the file's own relations per step, and those of two constants; None if the file has none.

    The constants are the most frequent relation of each pair, and of each pair and step, in these same scenes. So no
    constant does better.
    """
    if not has_step_edges(path, found.kind):
        return None
    truth = np.moveaxis(read_step_edges(path, found.kind, found.vocabulary, split)[:, :, found.step], 1, 2)
    answer = found.probs.argmax(-1)
    rows = {
        "inferred": answer,
        "constant per pair": np.broadcast_to(_mode(truth.reshape(-1, truth.shape[-1])), truth.shape),
        "constant per pair and step": np.broadcast_to(_mode(truth), truth.shape),
    }
    k = len(found.vocabulary)
    records = [
        {
            "row": name,
            "step_macro_f1": float(np.nanmean(f1_of_types(given, truth, k))),
            "step_accuracy": float((given == truth).mean()),
        }
        for name, given in rows.items()
    ]
    lines = [[r["row"], f"{r['step_macro_f1']:.3f}", f"{r['step_accuracy']:.3f}"] for r in records]
    return Table(
        "scores", ["row", "macro-F1", "accuracy"], lines, records, title="Beside the file's relations, per step"
    )


def _mode(truth: Int[np.ndarray, "S *R"]) -> Int[np.ndarray, " *R"]:
    """The most frequent value over the first axis; the least one of several."""
    kinds = np.arange(truth.max() + 1)
    return (truth[None] == kinds.reshape(-1, *[1] * truth.ndim)).sum(1).argmax(0)
