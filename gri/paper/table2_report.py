"""Write Table 2 and what goes with it: Markdown beside the paper's figures, CSV, F6 and F10."""

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import torch
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

from gri.data.ngsim.extract import scene_file
from gri.data.ranges.recorded import RECORDED
from gri.data.scene_file.schema import header_of
from gri.errors import InputError
from gri.evaluation.metrics import summary
from gri.evaluation.recorded_scores import RATIOS, pooled
from gri.paper import table2, table2_lanes_report
from gri.paper.plots import COLOURS, frequency_matrix
from gri.paper.reproduce import commit
from gri.paper.rows import printed
from gri.paper.table2 import IDM, Row
from gri.paper.table2_text import PAPERS, Results, by_row, files_of, lines, printed_cell, write_figures, write_tables
from gri.progress import Progress, no_progress

NOTES = """\
Ours: mean over test scenes and seeds ± standard deviation over scenes (mean over seeds) [least seed, greatest seed].
Half of the 95 % interval of a mean over {count} scenes is {share:.2f} of the standard deviation. Paper: mean ± standard
deviation, on scenes of its own choice. Accuracy is agreement with the hypothesis, over all six edges; the empty graph
has 66.7 %, and the prior allows GRI no edges but the two of the hypothesis (docs/ngsim.md). ADE, FDE: mean and final
displacement of the roll-out of mean actions; min: the best of 20 roll-outs with drawn actions. Contacts: share of
scenes in which a net gap gets to 0 (unknown lengths count as 4.6 m).
"""
OOD_NOTES = """\
Success rate [%] against δ, the share by which the headway is shrunk: vehicle 0 starts at (1 − δ)·Δx behind vehicle 1,
which drives as recorded; only the edge 1 → 0 is left. Mean over seeds ± half of the 95 % interval over the scenes of
one seed. GRI's training also maximises the learned reward from starts shifted by −5 to 30 m, without demonstrations
there.
"""


@dataclass(frozen=True)
class Order:
    """What is wanted, and where it is kept."""

    scenario: str
    source: Path
    """A scene file, an NGSIM file, or a folder of them."""
    seeds: int
    out: Path
    cache: Path
    rows: tuple[str, ...] = ()
    """Only these; none: all."""
    finished: bool = False
    """Take what is done, and train nothing."""

    @property
    def command(self) -> str:
        """What makes the same anywhere."""
        parts = ["gri reproduce table2", f"--scenario {self.scenario}", "--ngsim DIR", f"--seeds {self.seeds}"]
        return " ".join([*parts, *[f'--row "{row}"' for row in self.rows], *["--finished"] * self.finished])


def publish(order: Order, progress: Progress = no_progress) -> list[Path]:
    """Make what is missing, then write everything; returns the files."""
    began = time.monotonic()
    path = scene_file(order.source, order.cache, progress)
    results = _results(order, path, progress)
    order.out.mkdir(parents=True, exist_ok=True)
    lanes = RECORDED[order.scenario].lanes
    page = order.out / "table2.md"
    page.write_text((table2_lanes_report.text if lanes else _text)(results, path), "utf-8")
    files = [page, *(table2_lanes_report.tables if lanes else _tables)(results, order.out)]
    files += (table2_lanes_report.figures if lanes else _figures)(results, order.out)
    made = order.out / "table2.json"
    whole = [(job, result) for job, result in results if job.site is None]
    content = {
        "command": order.command,
        "commit": commit(),
        "rows": {row.name: [job.seed for job, _ in whole if job.row == row] for row, _ in by_row(whole)},
        "scenes": header_of(path).provenance,
        "seconds": round(time.monotonic() - began, 1),
        "cpu_seconds": round(sum(result["cpu_seconds"] for _, result in results), 1),
        "torch": str(torch.__version__),
    }
    made.write_text(json.dumps(content, indent=1) + "\n")
    return [*files, made]


def _results(order: Order, path: Path, progress: Progress) -> Results:
    wanted = table2.jobs_of(order.scenario, order.seeds, table2.sites(order.scenario, path), order.rows)
    if order.finished:
        file = table2.digest(path)
        wanted = [job for job in wanted if job.is_done(order.cache, file)]
        if not any(job.site is None for job in wanted):
            raise InputError(f"got --finished, but nothing is finished in {order.cache}; leave it out to train")
    results: Results = []
    for done, job in enumerate(wanted):
        results.append((job, table2.run(job, path, order.cache, progress)))
        progress("rows and seeds", done + 1, len(wanted), results[-1][1]["cpu_seconds"])
    return results


def _text(results: Results, path: Path) -> str:
    whole = [(job, result) for job, result in results if job.site is None]
    site = np.array(whole[0][1]["site"])
    counts = ", ".join(f"{(site == s).sum()} of {s}" for s in np.unique(site))
    parts = [
        "# Table II: recorded car following (NGSIM)\n",
        f"Test scenes: {counts}, cut from {files_of(path)}.\n",
        NOTES.format(count=len(site), share=1.96 / len(site) ** 0.5),
    ]
    parts += [_table(whole), "\n## Beyond the paper\n", _beyond(whole), "\n## Out of distribution\n"]
    parts += [OOD_NOTES, _curves(whole)]
    parts += [
        "\n## Sites\n",
        "RMSE_x [m] on the test scenes of each site, by the site whose training scenes were seen.\n",
    ]
    parts += [_sites(results)]
    for idm in (result["parameters"] for job, result in whole if job.row == IDM):
        parts += ["\nCalibrated IDM: " + ", ".join(f"{name} {value}" for name, value in idm.items()) + "."]
    return "\n".join(parts) + "\n"


def _values(seeds: list[dict[str, Any]], name: str) -> list[torch.Tensor]:
    return [torch.tensor(seed["errors"][name]) for seed in seeds]


def _spread(values: list[torch.Tensor], factor: float = 1.0, digits: int = 3) -> str:
    means = [factor * float(v.mean()) for v in values]
    std = factor * fmean(summary(v).std for v in values)
    return f"{fmean(means):.{digits}f} ± {std:.{digits}f} [{min(means):.{digits}f}, {max(means):.{digits}f}]"


def _table(results: Results) -> str:
    names = [name for name in ("x", "y", "v") if f"rmse_{name}" in results[0][1]["errors"]]
    units = {"x": "m", "y": "m", "v": "m/s"}
    head = ["model"]
    for name in names:
        head += [f"RMSE_{name} [{units[name]}]", "paper"]
    body = []
    for row, seeds in by_row(results):
        paper = printed()[results[0][0].scenario].get(PAPERS.get(row.name, ""))
        cells = [row.name]
        for name in names:
            cells += [_spread(_values(seeds, f"rmse_{name}")), printed_cell(getattr(paper, name, None), 3)]
        cells += [_accuracy(row, seeds), printed_cell(getattr(paper, "accuracy", None), 2), str(len(seeds))]
        body.append([*cells, f"{fmean(seed['cpu_seconds'] for seed in seeds):.0f}"])
    return lines([*head, "accuracy [%]", "paper", "seeds", "CPU s/seed"], body)


def _accuracy(row: Row, seeds: list[dict[str, Any]]) -> str:
    name = "accuracy" if row.meaning else "accuracy_renamed"
    values = [torch.tensor(seed["graphs"][name]) for seed in seeds if seed["graphs"]]
    return _spread(values, 100.0, 2) if values else "–"


def _beyond(results: Results) -> str:
    head = ["model", "ADE [m]", "FDE [m]", "minADE [m]", "minFDE [m]", "contacts [%]", "time headway [s]",
            "W1 time headway [s]", "W1 speed [m/s]", "W1 acceleration [m/s²]"]  # fmt: skip
    body = []
    for row, seeds in by_row(results):
        cells = [f"{fmean(float(v.mean()) for v in _values(seeds, name)):.2f}" if name in seeds[0]["errors"] else "–"
                 for name in ("ade", "fde", "min_ade", "min_fde")]  # fmt: skip
        found = {key: fmean(seed["compared"][key] for seed in seeds) for key in seeds[0]["compared"]}
        cells += [f"{100 * found['collision']:.1f}", f"{found['time_headway']:.2f}"]
        cells += [f"{found[f'wasserstein_{name}']:.3f}" for name in ("time_headway", "speed", "acceleration")]
        body.append([row.name, *cells])
    found = results[0][1]["compared"]
    rates = [f"{100 * found['collision_recorded']:.1f}", f"{found['time_headway_recorded']:.2f}"]
    return lines(head, [*body, ["recorded", *["–"] * 4, *rates, *["–"] * 3]])


def _curves(results: Results) -> str:
    body = []
    for row, seeds in by_row(results):
        cells = []
        for place in range(len(RATIOS)):
            points = [seed["ood"][place] for seed in seeds]
            mean = fmean(point["success"] for point in points)
            cells.append(f"{100 * mean:.1f} ± {100 * pooled(mean, points[0]['scenes']).half_width:.1f}")
        body.append([row.name, *cells])
    return lines(["model", *[f"δ {ratio:g}" for ratio in RATIOS]], body)


def _sites(results: Results) -> str:
    sites = sorted(set(results[0][1]["site"]))
    body = []
    for row, trained in dict.fromkeys((job.row, job.site) for job, _ in results):
        mine = [result for job, result in results if (job.row, job.site) == (row, trained)]
        cells = []
        for site in sites:
            chosen = torch.tensor([s == site for s in mine[0]["site"]])
            cells.append(_spread([v[chosen] for v in _values(mine, "rmse_x")], digits=2))
        body.append([row.name, trained or "both", *cells])
    return lines(["model", "trained on", *[f"tested on {site}" for site in sites]], body)


def _tables(results: Results, out: Path) -> list[Path]:
    scores, curves = [], []
    for job, result in results:
        names = {"row": job.row.name, "seed": job.seed, "trained_on": job.site or "both"}
        values = {name: summary(torch.tensor(v)) for name, v in result["errors"].items()}
        if result["graphs"]:
            values |= {name: summary(torch.tensor(result["graphs"][name])) for name in ("accuracy", "driven_accuracy")}
        scores += [names | {"metric": name} | asdict(value) for name, value in values.items()]
        scores += [names | {"metric": name, "mean": v} for name, v in result["compared"].items()]
        curves += [names | point for point in result["ood"]]
    return write_tables(scores, curves, out)


def _figures(results: Results, out: Path) -> list[Path]:
    whole = [(job, result) for job, result in results if job.site is None]
    return write_figures({"f6_edge_frequencies_ngsim": _frequencies, "f10_success_ngsim": _success}, whole, out)


def _frequencies(results: Results) -> Figure:
    """F6: one matrix per edge type and row, mean over seeds."""
    found = {row.name: np.mean([seed["graphs"]["frequency"] for seed in seeds], 0)
             for row, seeds in by_row(results) if seeds[0]["graphs"]}  # fmt: skip
    kinds = results[0][0].scenes.vocabulary
    size = (1.55 * len(found) + 0.3, 1.95 * len(kinds) + 0.4)
    figure, axes = plt.subplots(len(kinds), len(found), figsize=size, squeeze=False)
    for column, (name, matrices) in zip(axes.T, found.items(), strict=True):
        for axis, kind, matrix in zip(column, kinds, matrices, strict=True):
            frequency_matrix(axis, matrix, f"{name}\n{kind}")
    figure.suptitle("Recorded car following (NGSIM): share of test scenes with the type", fontsize=9)
    figure.tight_layout(h_pad=1.5)
    return figure


def _success(results: Results) -> Figure:
    """F10: success rate against δ, mean over seeds, with 95 % bands over the scenes of one seed."""
    figure, axis = plt.subplots(figsize=(5.2, 3.2))
    for row, seeds in by_row(results):
        means = [fmean(seed["ood"][place]["success"] for seed in seeds) for place in range(len(RATIOS))]
        widths = [pooled(m, seeds[0]["ood"][0]["scenes"]).half_width for m in means]
        colour = COLOURS.get(row.name, "#CC79A7" if row.name.startswith("GRI") else "0.45")
        axis.plot(RATIOS, means, marker="o", markersize=3, label=row.name, color=colour)
        low, high = np.clip([np.subtract(means, widths), np.add(means, widths)], 0, 1)
        axis.fill_between(RATIOS, low, high, color=colour, alpha=0.15, lw=0)
    axis.set_xlabel("δ: share by which the starting headway is shrunk")
    axis.set_ylabel("success rate")
    axis.set_ylim(-0.05, 1.05)
    axis.legend(fontsize=7, frameon=False)
    return figure
