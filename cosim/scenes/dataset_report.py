"""The report of a finished data set: its scenes and labels, their agreement, the rejections, and the cost."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cosim.measures.label_agreement import Agreement
from cosim.scenes.dataset import Dataset, DatasetSpec, total_tally
from gri.core.edges import LANE_CHANGING
from gri.storage.verification import write_sealed
from gri.table import Table

NAMES = [str(kind) for kind in LANE_CHANGING]


def report_of(spec: DatasetSpec, dataset: Dataset, seconds: float, folder: Path) -> dict[str, Any]:
    """The figures of a data set; also written to `report.json` in `folder`. `seconds` is the wall-clock time [s]."""
    cpu = sum(result.cpu_seconds for result in dataset.seeds)
    size = dataset.path.stat().st_size / 2**20
    cost = {
        "seconds": round(seconds, 1),
        "cpu_seconds": round(cpu, 1),
        "scenes_per_core_second": round(spec.total / cpu, 2),
        "cpu_seconds_per_scene": round(cpu / spec.total, 3),
        "simulated_seconds": round(sum(result.figures.simulated for result in dataset.seeds), 1),
        "peak_mb": round(max(result.peak_mb for result in dataset.seeds), 1),
        "fresh": dataset.new_scenes,
        "file_mb": round(size, 2),
        "seeds": len(dataset.seeds),
    }
    cost["text"] = (
        f"{spec.total} scenes of {cost['seeds']} seeds, {dataset.new_scenes} of them made now, in {seconds:.0f} s"
        f" ({dataset.new_scenes / seconds:.1f} per second); {spec.total / cpu:.1f} per second of a core"
        f" ({cpu / spec.total:.3f} s of CPU time each); peak memory of a worker {cost['peak_mb']:.0f} MB."
        f" {dataset.path}: {size:.1f} MB"
    )
    kinds = {kind: _with_agreement(total_tally(dataset.seeds, kind)) for kind in spec.kinds}
    report = {"kinds": kinds, "gold": spec.gold, "cost": cost}
    write_sealed(folder / "report.json", report)
    return report


def _with_agreement(tally: dict[str, Any]) -> dict[str, Any]:
    """The tally of a kind, with agreement of labels added and types by name."""
    for name in ("rule_gold", "hypothesis"):
        found = Agreement(np.array(tally[name]))
        tally[name] = {
            "counts": tally[name],
            "labels": found.total,
            "kappa": _rounded(found.kappa),
            "precision": {kind: _rounded(found.precision(k)) for k, kind in enumerate(NAMES)},
            "recall": {kind: _rounded(found.recall(k)) for k, kind in enumerate(NAMES)},
        }
    for name in ("edges", "step_labels"):
        tally[name] = dict(zip(NAMES, tally[name], strict=True))
    return tally


def _rounded(value: float) -> float | None:
    return None if np.isnan(value) else round(value, 4)


def tables(report: dict[str, Any]) -> Iterator[Table]:
    """The tables for the terminal: shares of relations, agreement of labels, and rejected candidates."""
    yield _shares(report["kinds"])
    yield _agreements(report["kinds"])
    found = [(kind, why, n) for kind, tally in report["kinds"].items() for why, n in tally["rejected"].items()]
    yield Table(
        "rejections",
        ["kind", "reason", "candidates"],
        [(kind, reason, str(count)) for kind, reason, count in found],
        [{"kind": kind, "reason": reason, "candidates": count} for kind, reason, count in found],
        title="Rejections: candidates by the first rule that they violate",
        labels=2,
    )


def _shares(kinds: dict[str, Any]) -> Table:
    lines, records = [], []
    for kind, tally in kinds.items():
        scenes, clear = tally["scenes"], tally["unambiguous"]
        for row, name in enumerate(("edges", "step_labels")):
            total = sum(tally[name].values())
            first = ("", "", "") if row else (kind, str(scenes), f"{100 * clear / scenes:.0f} %")
            lines.append((*first, name.replace("_", " "), *(f"{100 * tally[name][of] / total:.1f} %" for of in NAMES)))
            records.append({"kind": kind, "scenes": scenes, "unambiguous": clear, "labels": name, **tally[name]})
    head = ["kind", "scenes", "unambiguous", "labels", *NAMES]
    return Table("relations", head, lines, records, title="Relations: share of all ordered pairs", labels=1)


def _agreements(kinds: dict[str, Any]) -> Table:
    lines, records = [], []
    for kind, tally in kinds.items():
        for name, labels, reference in (("rule_gold", "rules", "interventions"), ("hypothesis", "geometry", "edges")):
            found = tally[name]
            if found["labels"]:
                scores = [f"{_shown(found['precision'][of])} / {_shown(found['recall'][of])}" for of in NAMES]
                lines.append((kind, labels, reference, _shown(found["kappa"]), *scores))
                measured = {f"{score}_{of}": found[score][of] for score in ("precision", "recall") for of in NAMES}
                compared = {"kind": kind, "labels": labels, "reference": reference, "kappa": found["kappa"]}
                records.append(compared | measured)
    head = ["kind", "labels", "reference", "Cohen's kappa", *NAMES]
    return Table("agreement", head, lines, records, title="Agreement of labels (precision / recall)", labels=3)


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
