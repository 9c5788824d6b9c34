"""Results of jobs as tables: long for machines, Markdown beside the paper's figures for people."""

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import pandas as pd
import torch

from gri.evaluation import out_of_distribution as ood
from gri.evaluation.metrics import Summary, summary
from gri.evaluation.out_of_distribution import Front
from gri.paper import rows
from gri.paper.jobs import Job

UNITS = {"x": "m", "y": "m", "v": "m/s"}


def score_rows(wanted: Sequence[Job], cache: Path) -> pd.DataFrame:
    """One line per scenario, row, seed and metric: mean, std over scenes, half the 95 % interval, scenes."""
    lines = []
    for job in wanted:
        result = job.result(cache)
        values = {f"rmse_{name}": summary(torch.tensor(v)) for name, v in result["rmse"].items()}
        lines += [_line(job, metric, value) for metric, value in values.items()]
        lines += [_line(job, metric, value) for metric, value in _graph_scores(result).items()]
        spent = {name: job.made(cache).get(name) for name in ("seconds", "cpu_seconds")}
        lines += [_line(job, f"training_{name}", _single(value)) for name, value in spent.items() if value is not None]
    return pd.DataFrame(lines)


def _line(job: Job, metric: str, value: Summary) -> dict[str, Any]:
    return {
        "scenario": job.scenario.name,
        "row": job.row.name,
        "seed": job.seed,
        "metric": metric,
        "mean": value.mean,
        "std": value.std,
        "half_width": value.half_width,
        "scenes": value.scenes,
    }


def _single(value: float) -> Summary:
    return Summary(value, 0.0, 0.0, 1)


def _graph_scores(result: dict[str, Any]) -> dict[str, Summary]:
    graphs = result["graphs"]
    if graphs is None:
        return {}
    scores = {
        "accuracy": summary(torch.tensor(graphs["accuracy"])),
        "driven_accuracy": summary(torch.tensor(graphs["driven_accuracy"])),
        "accuracy_renamed": _single(graphs["namings"]["types 1 to K-1"]["accuracy"]),
        "accuracy_renamed_all": _single(graphs["namings"]["all types"]["accuracy"]),
        "empty_graph_accuracy": _single(graphs["empty"]),
        "shuffle_agreement": _single(result["shuffled"]),
    }
    scores |= {f"f1_{kind}": _single(value) for kind, value in graphs["f1"].items() if value is not None}
    return scores | {f"flip {name}": _single(share["mean"]) for name, share in (result["flip"] or {}).items()}


def curve_rows(wanted: Sequence[Job], cache: Path, oracles: dict[str, list[dict]]) -> pd.DataFrame:
    """One line per scenario, row, seed, driver of vehicle 1 and headway; the oracle is a row without a seed."""
    lines = []
    for job in wanted:
        lines += [_point(job.scenario.name, job.row.name, job.seed, point) for point in job.result(cache)["ood"]]
    for scenario, points in oracles.items():
        lines += [_point(scenario, "oracle", -1, point) for point in points]
    return pd.DataFrame(lines)


def _point(scenario: str, row: str, seed: int, point: dict[str, Any]) -> dict[str, Any]:
    line = {"scenario": scenario, "row": row, "seed": seed, "front": point["front"], "headway": point["headway"]}
    for metric in ("success", "collision", "lateral"):
        line |= {metric: point[metric]["mean"], f"{metric}_half_width": point[metric]["half_width"]}
    return line


def areas(curves: pd.DataFrame) -> pd.DataFrame:
    """Area under the success curve of every scenario, row, seed and driver of vehicle 1, and over the oracle's."""
    keys = ["scenario", "row", "seed", "front"]
    lines = [
        dict(zip(keys, key, strict=True)) | {"area": _area(part)} for key, part in curves.groupby(keys, sort=False)
    ]
    table = pd.DataFrame(lines)
    best = table[table["row"] == "oracle"][["scenario", "front", "area"]].rename(columns={"area": "oracle_area"})
    table = table.merge(best, on=["scenario", "front"])
    return table.assign(share_of_oracle=table["area"] / table["oracle_area"]).drop(columns="oracle_area")


def _area(part: pd.DataFrame) -> float:
    return ood.trapezoid(list(zip(part["headway"], part["success"], strict=True)))


def markdown_table(scores: pd.DataFrame, scenario: rows.Scenario) -> str:
    """A table of the paper with its printed figures, ours as mean ± std over scenes, then the range over seeds."""
    ours = scores[scores["scenario"] == scenario.name]
    heads = ["model"]
    for name in scenario.features:
        heads += [f"RMSE_{name} [{UNITS[name]}]", "paper"]
    heads += ["accuracy [%]", "paper", "4 edges [%]", "F1 per type", "seeds", "CPU s/seed"]
    lines = [heads, ["---"] * len(heads)]
    for row in scenario.rows:
        part = ours[ours["row"] == row.name]
        if len(part):
            lines.append(_cells(row, part, scenario))
    empty = ours[ours["metric"] == "empty_graph_accuracy"]
    if len(empty):
        cells = ["empty graph", *["", ""] * len(scenario.features), f"{100 * empty['mean'].mean():.2f}"]
        lines.append(cells + [""] * (len(heads) - len(cells)))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cells(row: rows.Row, part: pd.DataFrame, scenario: rows.Scenario) -> list[str]:
    printed = rows.printed().get(scenario.paper, {}).get(row.printed or "")
    cells = [row.name]
    for name in scenario.features:
        cells.append(_spread(part[part["metric"] == f"rmse_{name}"], 1.0, 4))
        cells.append(_printed(getattr(printed, name, None), 3))
    accuracy = "accuracy" if row.meaning else "accuracy_renamed"
    cells.append(_spread(part[part["metric"] == accuracy], 100.0, 2))
    cells.append(_printed(getattr(printed, "accuracy", None), 2))
    cells.append(_spread(part[part["metric"] == "driven_accuracy"], 100.0, 2))
    cells.append(_f1(part))
    seconds = part[part["metric"] == "training_cpu_seconds"]["mean"]
    return [*cells, str(part["seed"].nunique()), f"{seconds.mean():.0f}" if len(seconds) else "–"]


def _spread(part: pd.DataFrame, factor: float, digits: int) -> str:
    """Mean over seeds ± mean std over scenes [least seed to greatest seed]."""
    if not len(part):
        return "–"
    mean, std = factor * part["mean"].mean(), factor * part["std"].mean()
    low, high = factor * part["mean"].min(), factor * part["mean"].max()
    return f"{mean:.{digits}f} ± {std:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _printed(value: tuple[float, float] | None, digits: int) -> str:
    return "–" if value is None else f"{value[0]:.{digits}f} ± {value[1]:.{digits}f}"


def _f1(part: pd.DataFrame) -> str:
    kinds = [metric for metric in part["metric"].unique() if metric.startswith("f1_")]
    values = [f"{kind[3:]} {part[part['metric'] == kind]['mean'].mean():.3f}" for kind in kinds]
    return ", ".join(values) or "–"


def markdown_curves(curves: pd.DataFrame, scenario: rows.Scenario, front: Front, metric: str = "success") -> str:
    """A rate [%] by headway, mean over seeds; for success also the area under the curve over the oracle's."""
    part = curves[(curves["scenario"] == scenario.name) & (curves["front"] == front)]
    headways = sorted(part["headway"].unique(), reverse=True)
    share = areas(curves)
    share = share[(share["scenario"] == scenario.name) & (share["front"] == front)]
    with_area = metric == "success"
    heads = ["model", *[f"{x:+.0f} m" for x in headways]]
    heads += ["area", "area ÷ oracle's, least seed", "seeds"] if with_area else []
    lines = [heads, ["---"] * len(heads)]
    for name in ["oracle", *[row.name for row in scenario.rows]]:
        mine, area = part[part["row"] == name], share[share["row"] == name]
        if len(mine):
            cells = [f"{100 * mine[mine['headway'] == x][metric].mean():.1f}" for x in headways]
            if with_area:
                seeds = "" if name == "oracle" else str(mine["seed"].nunique())
                cells += [f"{fmean(area['area']):.3f}", f"{min(area['share_of_oracle']):.3f}", seeds]
            lines.append([name, *cells])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def markdown_flips(scores: pd.DataFrame, scenario: rows.Scenario) -> str:
    """Share of scenes [%] in which a flipped edge does what it does in the optimum, least seed; "" if untested."""
    ours = scores[(scores["scenario"] == scenario.name) & scores["metric"].str.startswith("flip ")]
    flips = list(dict.fromkeys(ours["metric"]))
    lines = [["model", *[flip.removeprefix("flip ") for flip in flips]], ["---"] * (len(flips) + 1)]
    for name, part in ours.groupby("row", sort=False):
        found = [part[part["metric"] == flip]["mean"] for flip in flips]
        lines.append([str(name), *[f"{100 * share.min():.1f}" if len(share) else "–" for share in found]])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) if flips else ""


def markdown_weights(wanted: Sequence[Job], cache: Path, scenario: rows.Scenario) -> str:
    """Weight of every term over that of the jerk: true, and recovered (mean over seeds [range])."""
    found: dict[str, list[dict[str, list[float]]]] = {}
    for job in wanted:
        if job.scenario.name == scenario.name and (weights := job.result(cache)["weights"]):
            found.setdefault(job.row.name, []).append(weights)
    if not found:
        return ""
    terms = list(next(iter(found.values()))[0])
    lines = [["model", *terms], ["---"] * (len(terms) + 1)]
    first = next(iter(found.values()))[0]
    lines.append(["true", *[f"{first[term][1]:.2f}" for term in terms]])
    for name, seeds in found.items():
        lines.append([name, *[_range([weights[term][0] for weights in seeds]) for term in terms]])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _range(values: list[float]) -> str:
    return f"{fmean(values):.2f} [{min(values):.2f}, {max(values):.2f}]"
