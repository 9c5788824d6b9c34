"""Results of jobs as data frames: one line per row, seed and score, and one per point of the success curves."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from gri.evaluation import out_of_distribution as ood
from gri.evaluation.metrics import Summary, summary
from gri.evaluation.recorded_scores import clustered_half_width
from gri.paper.job_cache import Job

STAGES = ("drawn only", "fine-tuned")
"""Of the training on recorded lane changes."""
ORACLE_SEED = -1
"""Stands in the curves for the oracle, which has no seed."""


def score_frame(jobs: Sequence[Job], cache: Path) -> pd.DataFrame:
    """One line per row, seed and metric: mean, standard deviation over scenes, half the 95 % interval, scenes.

    Lines of recorded car following also name the site that was trained on, those of lane changes the stage of the
    training. `page_only` marks scores that the files leave out.
    """
    return pd.DataFrame([line for job in jobs for line in _score_lines(job, cache)])


def released(scores: pd.DataFrame) -> pd.DataFrame:
    """The scores that are written to files."""
    return scores[~scores["page_only"]].drop(columns="page_only")


def _score_lines(job: Job, cache: Path) -> list[dict[str, Any]]:
    result = job.result(cache)
    if job.scenario.recorded is None:
        return _synthetic(job, result, job.made(cache))
    return _car_following(job, result) if job.scenario.cross_validation is None else _lane_changes(job, result)


def _line(names: dict[str, Any], metric: str, value: Summary, page_only: bool = False) -> dict[str, Any]:
    return names | {"metric": metric} | asdict(value) | {"page_only": page_only}


def _single(value: float) -> Summary:
    """A score without a spread over scenes."""
    return Summary(value, 0.0, 0.0, 1)


def _summaries(values: dict[str, list[float]]) -> dict[str, Summary]:
    return {name: summary(torch.tensor(each)) for name, each in values.items()}


def _synthetic(job: Job, result: dict[str, Any], made: dict[str, Any]) -> list[dict[str, Any]]:
    scores = {f"rmse_{name}": value for name, value in _summaries(result["rmse"]).items()}
    graphs = result["graphs"]
    if graphs is not None:
        scores |= _summaries({name: graphs[name] for name in ("accuracy", "driven_accuracy")})
        scores |= {
            "accuracy_renamed": _single(graphs["namings"]["types 1 to K-1"]["accuracy"]),
            "accuracy_renamed_all": _single(graphs["namings"]["all types"]["accuracy"]),
            "empty_graph_accuracy": _single(graphs["empty"]),
            "shuffle_agreement": _single(result["shuffled"]),
        }
        scores |= {f"f1_{kind}": _single(value) for kind, value in graphs["f1"].items() if value is not None}
        scores |= {f"flip {name}": _single(share["mean"]) for name, share in (result["flip"] or {}).items()}
    spent = {name: made.get(name) for name in ("seconds", "cpu_seconds")}
    scores |= {f"training_{name}": _single(value) for name, value in spent.items() if value is not None}
    names = {"scenario": job.scenario.name, "row": job.row.name, "seed": job.seed}
    return [_line(names, metric, value) for metric, value in scores.items()]


def _car_following(job: Job, result: dict[str, Any]) -> list[dict[str, Any]]:
    names = {"row": job.row.name, "seed": job.seed, "trained_on": job.site or "both"}
    graphs, errors = result["graphs"] or {}, result["errors"]
    scores = _summaries(errors | {name: graphs[name] for name in ("accuracy", "driven_accuracy") if graphs})
    lines = [_line(names, metric, value) for metric, value in scores.items()]
    lines += [names | {"metric": m, "mean": value, "page_only": False} for m, value in result["compared"].items()]
    of_page = {f"rmse_x at {site}": [] for site in sorted(set(result["site"]))}
    for site, value in zip(result["site"], errors["rmse_x"], strict=True):
        of_page[f"rmse_x at {site}"].append(value)
    of_page |= {"accuracy_renamed": graphs["accuracy_renamed"]} if graphs else {}
    of_page |= {"training_cpu_seconds": [result["cpu_seconds"]]}
    return lines + [_line(names, metric, value, page_only=True) for metric, value in _summaries(of_page).items()]


def _lane_changes(job: Job, result: dict[str, Any]) -> list[dict[str, Any]]:
    lines = []
    for stage in STAGES:
        names = {"row": job.row.name, "seed": job.seed, "stage": stage}
        found = at_stage(result, stage)
        for metric, values in (found["errors"] | (found["graphs"] or {})).items():
            value, half_width = (
                summary(torch.tensor(values)),
                clustered_half_width(torch.tensor(values), result["cluster"]),
            )
            line = _line(names, metric, Summary(value.mean, value.std, half_width, value.scenes))
            lines.append(line)
        lines.append(_line(names, "training_cpu_seconds", _single(result["cpu_seconds"]), page_only=True))
    for line in lines:
        line["windows"] = line.pop("scenes")
    return lines


def at_stage(result: dict[str, Any], stage: str) -> dict[str, Any]:
    """The result of a lane-change job at a stage of the training."""
    return result | result["before"] if stage == "drawn only" else result


def curve_frame(jobs: Sequence[Job], cache: Path, oracles: dict[str, list[dict[str, Any]]]) -> pd.DataFrame:
    """One line per point of the out-of-distribution curves, of rows and of the oracles of synthetic scenarios.

    Synthetic: a point is a driver of vehicle 1 and a headway [m]. Recorded: a ratio by which the headway is shrunk.
    """
    lines = []
    for job in jobs:
        result, names = job.result(cache), {"row": job.row.name, "seed": job.seed}
        if job.scenario.recorded is None:
            lines += [_point(job.scenario.name, job.row.name, job.seed, point) for point in result["ood"]]
        elif job.scenario.cross_validation is None:
            lines += [names | {"trained_on": job.site or "both"} | point for point in result["ood"]]
        else:
            lines += [names | {"stage": stage} | p for stage in STAGES for p in at_stage(result, stage)["ood"]]
    for scenario, points in oracles.items():
        lines += [_point(scenario, "oracle", ORACLE_SEED, point) for point in points]
    return pd.DataFrame(lines)


def _point(scenario: str, row: str, seed: int, point: dict[str, Any]) -> dict[str, Any]:
    line = {"scenario": scenario, "row": row, "seed": seed, "front": point["front"], "headway": point["headway"]}
    for metric in ("success", "collision", "lateral"):
        line |= {metric: point[metric]["mean"], f"{metric}_half_width": point[metric]["half_width"]}
    return line


def rates(curves: pd.DataFrame) -> pd.DataFrame:
    """Curves of recorded scenes with rates of success and collision where they have counts of scenes."""
    if "hits" not in curves:
        return curves
    return curves.assign(success=curves["hits"] / curves["scenes"], collision=curves["contacts"] / curves["scenes"])


def areas(curves: pd.DataFrame) -> pd.DataFrame:
    """Area under the success curve of every scenario, row, seed and driver of vehicle 1, and its share of the oracle's.

    The area is the mean success rate over the tested headways.
    """
    keys = ["scenario", "row", "seed", "front"]
    lines = [
        dict(zip(keys, key, strict=True))
        | {"area": ood.mean_height(list(zip(part["headway"], part["success"], strict=True)))}
        for key, part in curves.groupby(keys, sort=False)
    ]
    table = pd.DataFrame(lines)
    best = table[table["row"] == "oracle"][["scenario", "front", "area"]].rename(columns={"area": "oracle_area"})
    table = table.merge(best, on=["scenario", "front"])
    return table.assign(share_of_oracle=table["area"] / table["oracle_area"]).drop(columns="oracle_area")


def weight_frame(jobs: Sequence[Job], cache: Path) -> pd.DataFrame:
    """One line per row, seed and reward term: learned (`mean`) and true weight over the weight of the jerk."""
    lines = [
        {"row": job.row.name, "seed": job.seed, "metric": term, "mean": learned, "true": true}
        for job in jobs
        for term, (learned, true) in (job.result(cache)["weights"] or {}).items()
    ]
    return pd.DataFrame(lines, columns=["row", "seed", "metric", "mean", "true"])
