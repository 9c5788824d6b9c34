"""`gri bench relations`: who reacts to whom? Scores every row on every test set, with intervals.

One job is a row and a seed. A finished job is a file, so that an interrupted command goes on where it stopped. Two runs
of one version write the same bytes.
"""

import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from gri.bench.car_following_scenes import DT
from gri.bench.driver_models import DRIVER_MODELS
from gri.bench.families import NEAR, WIDE, KnownScenes, TestSet, split, test_sets
from gri.bench.rows import ROWS, UPDATES, WINDOW, Row
from gri.bench.scores import SCORES, score
from gri.core.edges import pairs
from gri.errors import InputError
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
        known = [row.name for row in ROWS]
        if unknown := [name for name in self.rows if name not in known]:
            raise InputError(f"--row: got {unknown[0]!r}, wanted one of: {'; '.join(known)}")
        for row in ROWS:
            if not self.rows or row.name in self.rows:
                yield from ((row, seed) for seed in range(self.seeds if row.varies else 1))

    def file(self, row: Row, seed: int) -> Path:
        """Where the result of a job is kept; the name changes with whatever changes the result."""
        facts = (VERSION, row.name, row.given, seed, self.scenes, self.training, self.validation, UPDATES, WINDOW)
        return self.out / "jobs" / f"{sha256(repr(facts).encode()).hexdigest()[:16]}.json"


def run(plan: Plan, progress: Progress = no_progress) -> pd.DataFrame:
    """Do the jobs that are not done yet, write the tables, and return the long table of scores.

    Columns: row, given, set, kind, score, value, low, high, seeds. `value` is the mean over seeds, the interval is the
    mean interval over scenes widened to the least and the greatest seed.
    """
    torch.set_num_threads(1)
    jobs = list(plan.jobs())
    for done, (row, seed) in enumerate(jobs):
        progress("relations", done, len(jobs), 0.0)
        path = plan.file(row, seed)
        if not path.is_file():
            write(path, json.dumps(_result(plan, row, seed), indent=1))
    progress("relations", len(jobs), len(jobs), 0.0)
    table = _table(plan, jobs)
    write(plan.out / "relations.csv", table.to_csv(index=False, float_format="%.4f"))
    write(plan.out / "relations.md", markdown(table, plan))
    write(plan.out / "relations.json", json.dumps(card(plan), indent=1))
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


def _table(plan: Plan, jobs: Sequence[tuple[Row, int]]) -> pd.DataFrame:
    rows = []
    for row, seed in jobs:
        for part in json.loads(plan.file(row, seed).read_text()):
            for name, value in part["scores"].items():
                rows.append((row.name, row.given, part["set"], part["kind"], name, seed, *value.values()))
    columns = ["row", "given", "set", "kind", "score", "seed", "value", "low", "high"]
    long = pd.DataFrame(rows, columns=columns)
    keys = ["row", "given", "set", "kind", "score"]
    grouped = long.groupby(keys, sort=False)
    return grouped.agg(
        value=("value", "mean"), low=("low", "min"), high=("high", "max"), seeds=("seed", "size")
    ).reset_index()


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
        pivot(false, ""),
    ]
    return "\n\n".join(parts) + "\n"


def _percent(value: float, low: float, high: float) -> str:
    return "–" if np.isnan(value) else f"{100 * value:.0f} ({100 * low:.0f}–{100 * high:.0f})"


def pivot(part: pd.DataFrame, suffix: str) -> str:
    """A line per row of the benchmark, a column per test set whose name ends with the suffix."""
    sets = [name for name in dict.fromkeys(part["set"]) if name.endswith(suffix)]
    cells = {
        (line["row"], line["set"]): _percent(line["value"], line["low"], line["high"])
        for line in part.to_dict("records")
    }
    heads = [name.removesuffix(suffix) for name in sets]
    lines = [f"| row | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    rows = dict.fromkeys(part["row"])
    return "\n".join([*lines, *(f"| {row} | {' | '.join(cells[row, name] for name in sets)} |" for row in rows)])


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


def write(path: Path, text: str) -> None:
    """Write a file that appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        partial.write_text(text)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
