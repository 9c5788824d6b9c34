"""`gri bench relations`: who reacts to whom? Scores every row on every test set, with intervals.

One job is a row and a seed. A finished job is a file, so that an interrupted command goes on where it stopped. Two runs
of one version write the same bytes.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from gri.bench.car_following_scenes import DT
from gri.bench.driver_models import DRIVER_MODELS
from gri.bench.families import NEAR, WIDE, KnownScenes, TestSet, split, test_sets
from gri.bench.resumable_jobs import chosen_jobs, finish, job_file, pivot, write_whole
from gri.bench.rows import ROWS, UPDATES, WINDOW, Row
from gri.bench.scores import SCORES, score
from gri.core.edges import pairs
from gri.progress import Progress, no_progress

VERSION = 1  # of the scenes and rows; another one makes all jobs again
TRAINING, VALIDATION = 1500, 300  # scenes of each driver model and family


@dataclass(frozen=True)
class Plan:
    """What to score, and where results go."""

    out: Path
    seeds: int = 5
    scenes: int = 300
    """Of each test set."""
    rows: tuple[str, ...] = ()
    """Only rows of these names; () for all."""
    training: int = TRAINING
    validation: int = VALIDATION

    def jobs(self) -> Iterator[tuple[Row, int]]:
        """Rows and seeds; rows that do not depend on the seed are done once."""
        yield from chosen_jobs(ROWS, self.rows, self.seeds)

    def file(self, row: Row, seed: int) -> Path:
        """Where the result of a job is kept; the name changes with whatever changes the result."""
        facts = (VERSION, row.name, row.given, seed, self.scenes, self.training, self.validation, UPDATES, WINDOW)
        return job_file(self.out, facts)


def run(plan: Plan, progress: Progress = no_progress) -> pd.DataFrame:
    """Do the jobs that are not done yet, write the tables, and return the long table of scores.

    Columns: row, given, set, kind, score, value, low, high, seeds. `value` is the mean over seeds, the interval is the
    mean interval over scenes widened to the least and the greatest seed.
    """
    torch.set_num_threads(1)
    jobs = list(plan.jobs())
    table = finish(jobs, plan.file, lambda row, seed: _result(plan, row, seed), "relations", progress)
    write_whole(plan.out / "relations.csv", table.to_csv(index=False, float_format="%.4f"))
    write_whole(plan.out / "relations.md", markdown(table, plan))
    write_whole(plan.out / "relations.json", json.dumps(card(plan), indent=1))
    return table


@cache
def _training(part: str, count: int) -> tuple[KnownScenes, ...]:
    return tuple(split(part, model, family, count) for family in (NEAR, WIDE) for model in DRIVER_MODELS)


@cache
def _tests(count: int) -> tuple[TestSet, ...]:
    return tuple(test_sets(count))


def _result(plan: Plan, row: Row, seed: int) -> list[dict[str, Any]]:
    infer = row.prepare(_training("train", plan.training), _training("validation", plan.validation), seed)
    found = []
    for tested in _tests(plan.scenes):
        n = tested.scenes.state.shape[1]
        ahead = [edge for edge, (i, j) in enumerate(pairs(n)) if i > j]
        behind = [edge for edge, (i, j) in enumerate(pairs(n)) if i < j]
        every, truth = infer(tested.scenes).numpy(), tested.scenes.graph().numpy() > 0
        p, right = every[:, ahead], truth[:, ahead]
        values = {name: asdict(score(name, p, right)) for name in SCORES}
        values["false_follow_from_behind"] = asdict(score("false_follow", every[:, behind], truth[:, behind]))
        found.append({"set": tested.name, "kind": tested.kind, "scores": values})
    return found


def markdown(table: pd.DataFrame, plan: Plan) -> str:
    """The page that people read: a summary, balanced accuracy per driver model, false follow per control."""
    accuracy = table[(table["kind"] == "drivers") & (table["score"] == "balanced_accuracy")]
    false = table[(table["kind"] == "control") & (table["score"] == "false_follow")]
    parts = [
        "# Who reacts to whom: scores",
        f"{plan.scenes} scenes per set, {plan.seeds} seeds for rows that depend on one."
        " [How to read this, and how it is made](../../relations.md).",
        "## Summary",
        _summary(table),
        "## Balanced accuracy [%]",
        "Every constant answer that ignores the order has 50. Only pairs whose sender is ahead are scored. In brackets:"
        " 95 % over scenes, widened to the least and the greatest seed.",
    ]
    for family in (NEAR, WIDE):
        least, most = family.headway
        parts += [f"First headways of {least:g} to {most:g} m:", pivot(accuracy, f", {family.name}")]
    parts += [
        "## False follow in controls [%]",
        'No vehicle reacts to another one of the scene, so every "follow" is wrong.',
        pivot(false),
    ]
    return "\n\n".join(parts) + "\n"


def _summary(table: pd.DataFrame) -> str:
    """One line per row: worst and mean balanced accuracy, mean AUC, macro-F1, calibration, mean false follow."""
    lines = [
        "| row | given | balanced accuracy, worst / mean [%] | macro-F1 [%] | AUC | calibration error | false follow,"
        " worst / mean [%] |",
        "|---|---|---|---|---|---|---|",
    ]
    for (name, given), part in table.groupby(["row", "given"], sort=False):
        drivers, control = part[part["kind"] == "drivers"], part[part["kind"] == "control"]
        value = {score_: drivers.loc[drivers["score"] == score_, "value"] for score_ in SCORES}
        wrong = control.loc[control["score"] == "false_follow", "value"]
        accuracy = value["balanced_accuracy"]
        lines.append(
            f"| {name} | {given} | {100 * accuracy.min():.0f} / {100 * accuracy.mean():.0f}"
            f" | {100 * value['macro_f1'].mean():.0f} | {value['auc'].mean():.2f}"
            f" | {value['calibration_error'].mean():.2f}"
            f" | {100 * wrong.max():.0f} / {100 * wrong.mean():.0f} |"
        )
    return "\n".join(lines)


def card(plan: Plan) -> dict[str, Any]:
    """What was scored: scenes of each set, their share of true edges, and how many drawn scenes were thrown away."""
    sets = []
    for tested in _tests(plan.scenes):
        graph = tested.scenes.graph()
        ahead = [edge for edge, (i, j) in enumerate(pairs(tested.scenes.state.shape[1])) if i > j]
        sets.append(
            {
                "set": tested.name,
                "kind": tested.kind,
                "scenes": len(tested.scenes),
                "true_edges_of_scored_pairs": round(float(graph[:, ahead].double().mean()), 4),
                "drawn_scenes_kept": round(tested.scenes.acceptance, 4),
            }
        )
    return {
        "version": VERSION,
        "window_s": round((WINDOW - 1) * DT, 3),
        "training_scenes_per_model_and_family": plan.training,
        "families": {family.name: asdict(family) for family in (NEAR, WIDE)},
        "driver_models": {model.name: {"source": model.source, **model.ranges} for model in DRIVER_MODELS},
        "sets": sets,
    }
