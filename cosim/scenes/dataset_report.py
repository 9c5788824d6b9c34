"""What a finished data set holds, how well its labels agree, and what it cost."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich.table import Table

from cosim.measures.label_agreement import Agreement
from cosim.scenes.dataset import Made, Order, totals
from gri.core.edges import LANE_CHANGING

NAMES = [str(kind) for kind in LANE_CHANGING]


def report_of(order: Order, made: Made, seconds: float, folder: Path) -> dict[str, Any]:
    """The figures of a data set; also written as `report.json` beside it."""
    cpu = sum(brought.cpu_seconds for brought in made.brought)
    size = made.path.stat().st_size / 2**20
    cost = {
        "seconds": round(seconds, 1),
        "cpu_seconds": round(cpu, 1),
        "scenes_per_core_second": round(order.total / cpu, 2),
        "cpu_seconds_per_scene": round(cpu / order.total, 3),
        "simulated_seconds": round(sum(brought.figures.simulated for brought in made.brought), 1),
        "peak_mb": round(max(brought.peak_mb for brought in made.brought), 1),
        "fresh": made.fresh,
        "file_mb": round(size, 2),
        "seeds": len(made.brought),
    }
    cost["text"] = (
        f"{order.total} scenes of {cost['seeds']} seeds, {made.fresh} of them made in these {seconds:.0f} s"
        f" ({made.fresh / seconds:.1f} per second); {order.total / cpu:.1f} per second of a core"
        f" ({cpu / order.total:.3f} s each); peak memory of a worker {cost['peak_mb']:.0f} MB."
        f" {made.path}: {size:.1f} MB"
    )
    kinds = {kind: _kind(totals(made.brought, kind)) for kind in order.kinds}
    report = {"kinds": kinds, "gold": order.gold, "cost": cost}
    (folder / "report.json").write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=1) + b"\n")
    return report


def _kind(tally: dict[str, Any]) -> dict[str, Any]:
    """A kind's tally with shares and agreement."""
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
    """What a person reads in the end."""
    shares = Table("kind", "scenes", "unambiguous", "of", *NAMES, title="Relations")
    for kind, tally in report["kinds"].items():
        scenes, clear = str(tally["scenes"]), f"{100 * tally['unambiguous'] / tally['scenes']:.0f} %"
        for row, name in enumerate(("edges", "step_labels")):
            total = sum(tally[name].values())
            counted = [f"{100 * tally[name][of] / total:.1f} %" for of in NAMES]
            first = ("", "", "") if row else (kind, scenes, clear)
            shares.add_row(*first, name.replace("_", " "), *counted)
    yield shares
    agreement = Table("kind", "labels", "against", "kappa", *NAMES, title="Agreement (precision / recall)")
    for kind, tally in report["kinds"].items():
        for name, labels, truth in (("rule_gold", "rules", "interventions"), ("hypothesis", "geometry", "edges")):
            found = tally[name]
            if found["labels"]:
                scores = [f"{_shown(found['precision'][of])} / {_shown(found['recall'][of])}" for of in NAMES]
                agreement.add_row(kind, labels, truth, _shown(found["kappa"]), *scores)
    yield agreement
    rejected = Table("kind", "turned down", "candidates", title="Rejections")
    for kind, tally in report["kinds"].items():
        for reason, count in tally["rejected"].items():
            rejected.add_row(kind, reason, str(count))
    yield rejected


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
