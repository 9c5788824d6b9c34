"""Write Table 2 of recorded lane changes, by cross-validation, and what goes with it."""

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from gri.evaluation.metrics import edge_frequency, summary
from gri.evaluation.recorded_scores import RATIOS, clustered, pooled
from gri.networks.model import MERGE_BEHIND, MERGE_BETWEEN, Edge
from gri.paper.plots import COLOURS, frequency_matrix
from gri.paper.rows import printed
from gri.paper.table2 import Row
from gri.paper.table2_lanes import BESIDE, BLUR, FOLDS, TUNING
from gri.paper.table2_text import PAPERS, Results, by_row, files_of, lines, printed_cell, write_figures, write_tables

NOTES = """\
How it was trained: on scenes whose motion along the road is recorded and whose motion across it is drawn, with lateral
starts blurred by {blur[0]} m/s and {blur[1]} m/s²; no vehicle of a recorded lane change is in them. "Fine-tuned" is
that model after {updates} more updates on the recorded lane changes of all folds but one of {folds}, beside {beside}
times as many drawn ones, tested on the fold that was left out.

Mean over windows and seeds ± half of the 95 % interval, for which windows that share vehicles count as one
[least seed, greatest seed]. Paper: mean ± standard deviation, on scenes of its own choice. Accuracy is agreement with
the hypothesis over all six edges, each window under its reading of it, H1 or H2 (docs/ngsim.md); the
empty graph has 66.7 % under H1 and 50 % under H2, and the prior allows GRI no edges but those of the hypothesis, with
odds of 49 to one for following and of two to one for yielding. RMSE_v is that of the speed along the road.
"""
OOD_NOTES = """\
Success rate, and in brackets collision rate, [%] against δ, the share by which the headway is shrunk. Left are vehicle
0 and the one it yields to, 1 in H1 and 2 in H2, which drives as recorded; only the edge over which 0 yields is left.
± is half of the 95 % interval over the windows of one seed.
"""
STAGES = ("drawn only", "fine-tuned")
READINGS: dict[str, tuple[Edge, ...]] = {"H1": MERGE_BEHIND, "H2": MERGE_BETWEEN}


def text(results: Results, path: Path) -> str:
    """The Markdown page."""
    first = results[0][1]
    windows, clusters = len(first["site"]), len(set(first["cluster"]))
    parts = ["# Table II: recorded lane changing (NGSIM)\n"]
    parts += [f"{windows} recorded windows in {clusters} groups that share no vehicle, cut from {files_of(path)}.\n"]
    parts += [NOTES.format(folds=FOLDS, updates=TUNING.updates, blur=BLUR, beside=BESIDE), _table(results)]
    parts += ["\n## Out of distribution\n", OOD_NOTES, _curves(results)]
    return "\n".join(parts) + "\n"


def _at(stage: str, result: dict[str, Any]) -> dict[str, Any]:
    """A result as it was at a stage of the training."""
    return result | result["before"] if stage == "drawn only" else result


def _all_at(stage: str, results: Results) -> Results:
    return [(job, _at(stage, result)) for job, result in results]


def _label(row: Row, stage: str) -> str:
    return row.name if stage == "drawn only" else f"{row.name}, {stage}"


def _cell(seeds: Sequence[dict[str, Any]], values: Sequence[list[float]], factor: float, digits: int) -> str:
    means = [factor * fmean(v) for v in values]
    width = fmean(factor * clustered(torch.tensor(v), s["cluster"]) for v, s in zip(values, seeds, strict=True))
    return f"{fmean(means):.{digits}f} ± {width:.{digits}f} [{min(means):.{digits}f}, {max(means):.{digits}f}]"


def _table(results: Results) -> str:
    head = ["model", "RMSE_x [m]", "paper", "RMSE_y [m]", "paper", "RMSE_v [m/s]", "paper", "accuracy [%]", "paper",
            "ADE [m]", "FDE [m]", "seeds", "CPU s/seed"]  # fmt: skip
    body = []
    for row, seeds in by_row(results):
        paper = printed()["ngsim_lane_changing"].get(PAPERS.get(row.name, ""))
        for stage in STAGES:
            found, cells = [_at(stage, seed) for seed in seeds], [_label(row, stage)]
            for feature in ("x", "y", "v"):
                values = [one["errors"][f"rmse_{feature}"] for one in found]
                cells += [_cell(seeds, values, 1.0, 2), printed_cell(getattr(paper, feature, None), 2)]
            key = "accuracy" if row.meaning else "accuracy_renamed"
            right = [one["graphs"][key] for one in found if one["graphs"]]
            cells += [
                _cell(seeds, right, 100.0, 1) if right else "–",
                printed_cell(getattr(paper, "accuracy", None), 1),
            ]
            cells += [f"{fmean(fmean(one['errors'][key]) for one in found):.2f}" for key in ("ade", "fde")]
            body.append([*cells, str(len(seeds)), f"{fmean(seed['cpu_seconds'] for seed in seeds):.0f}"])
    return lines(head, body)


def _rates(seeds: Sequence[dict[str, Any]], place: int, key: str) -> tuple[float, int]:
    points = [seed["ood"][place] for seed in seeds]
    return sum(p[key] for p in points) / sum(p["scenes"] for p in points), points[0]["scenes"]


def _curves(results: Results) -> str:
    body = []
    for stage in STAGES:
        for row, seeds in by_row(_all_at(stage, results)):
            cells = [_label(row, stage)]
            for place in range(len(RATIOS)):
                (mean, scenes), (contacts, _) = (_rates(seeds, place, key) for key in ("hits", "contacts"))
                cells.append(f"{100 * mean:.0f} ± {100 * pooled(mean, scenes).half_width:.0f} ({100 * contacts:.0f})")
            body.append(cells)
    return lines(["model", *[f"δ {ratio:g}" for ratio in RATIOS]], body)


def tables(results: Results, out: Path) -> list[Path]:
    """CSV: a line per row, seed and metric, and per point of the curves."""
    scores, curves = [], []
    for job, result in results:
        names = {"row": job.row.name, "seed": job.seed}
        for stage in STAGES:
            found = _at(stage, result)
            values = {**found["errors"], **(found["graphs"] or {})}
            for metric, each in values.items():
                value, width = summary(torch.tensor(each)), clustered(torch.tensor(each), result["cluster"])
                scores.append(names | {"stage": stage, "metric": metric, "mean": value.mean, "std": value.std,
                                       "half_width": width, "windows": value.scenes})  # fmt: skip
            curves += [names | {"stage": stage} | point for point in found["ood"]]
    return write_tables(scores, curves, out)


def figures(results: Results, out: Path) -> list[Path]:
    """F6 by reading, where a row infers graphs, and F11; of the models before they are fine-tuned."""
    drawn = {"f6_edge_frequencies_ngsim_lanes": _frequencies, "f11_success_ngsim_lanes": _success}
    return write_figures(drawn, _all_at("drawn only", results), out)


def _frequencies(results: Results) -> Figure:
    kinds = results[0][0].scenes.vocabulary
    rows: list[tuple[Row, list[dict[str, Any]]]] = [r for r in by_row(results) if r[1][0]["graphs"]]
    columns = [(row, seeds, reading) for row, seeds in rows for reading in READINGS]
    size = (1.55 * len(columns) + 0.3, 1.95 * len(kinds) + 0.4)
    figure, axes = plt.subplots(len(kinds), len(columns), figsize=size, squeeze=False)
    for axis_column, (row, seeds, reading) in zip(axes.T, columns, strict=True):
        true = np.array(seeds[0]["hypothesis"]) == list(READINGS).index(reading)
        matrices = np.mean(
            [edge_frequency(torch.tensor(seed["inferred"])[true], len(kinds)).numpy() for seed in seeds], 0
        )
        for axis, kind, matrix in zip(axis_column, kinds, matrices, strict=True):
            frequency_matrix(axis, matrix, f"{row.name}, {reading}\n{kind}")
    figure.suptitle("Recorded lane changing (NGSIM): share of windows with the type", fontsize=9)
    figure.tight_layout(h_pad=1.5)
    return figure


def _success(results: Results) -> Figure:
    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.2), sharey=True)
    for axis, key, label in zip(axes, ("hits", "contacts"), ("success rate", "collision rate"), strict=True):
        for row, seeds in by_row(results):
            found = [_rates(seeds, place, key) for place in range(len(RATIOS))]
            means, widths = [m for m, _ in found], [pooled(m, n).half_width for m, n in found]
            colour = COLOURS.get(row.name, "#CC79A7" if row.name.startswith("GRI") else "0.45")
            axis.plot(RATIOS, means, marker="o", markersize=3, label=row.name, color=colour)
            low, high = np.clip([np.subtract(means, widths), np.add(means, widths)], 0, 1)
            axis.fill_between(RATIOS, low, high, color=colour, alpha=0.15, lw=0)
        axis.set_xlabel("δ: share by which the starting headway is shrunk")
        axis.set_ylabel(label)
        axis.set_ylim(-0.05, 1.05)
    axes[0].legend(fontsize=7, frameon=False)
    figure.tight_layout()
    return figure
