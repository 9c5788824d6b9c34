"""`gri bench merges`: which relations hold in which step of SUMO's merges? Scores every row on every file of scenes.

One job is a file, a row and a seed. A finished job is a file, so that an interrupted command goes on where it stopped.
Two runs of one version write the same bytes.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from gri.bench.merge_rows import LEARNING_SCENES, LEARNING_UPDATES, POSTERIOR, ROWS, Row, Training, learned
from gri.bench.merge_scenes import PAIRS, Control, MergeScenes, controls, describe, read_merges
from gri.bench.merge_scores import (
    NAMES,
    STEP_SCORES,
    accuracy,
    calibration_error,
    claimed,
    with_interval,
)
from gri.bench.resumable_jobs import check_names, finish, job_file, kept
from gri.errors import InputError
from gri.progress import Progress, no_progress
from gri.storage.whole_files import write_whole

VERSION = 1  # of the rows and scores; another one makes all jobs again


@dataclass(frozen=True)
class Plan:
    """What to score, and where results go."""

    out: Path
    scenes: tuple[Path, ...]
    """Scene files to score, one site each."""
    train: tuple[Path, ...]
    """Scene files of other seeds: taught rows see their relations, label-free rows their motion."""
    seeds: int = 5
    rows: tuple[str, ...] = ()
    """Only rows of these names; () for all."""

    def jobs(self) -> list[tuple[Path, Row, int]]:
        """Files, rows and seeds; rows that do not depend on the seed are done once."""
        check_names(self.rows, [row.name for row in ROWS])
        wanted = [row for row in ROWS if not self.rows or row.name in self.rows]
        return [
            (path, row, seed)
            for path in self.scenes
            for row in wanted
            for seed in range(self.seeds if row.varies else 1)
        ]

    def file(self, path: Path, row: Row, seed: int) -> Path:
        """Where the result of a job is kept; the name changes with whatever changes the result."""
        inputs = [_digest(file) for file in (path, *self.train)]
        return self._named(row.name, row.given, seed, LEARNING_UPDATES, LEARNING_SCENES, inputs)

    def constants(self, seed: int) -> dict[str, float]:
        """Learned driver constants; once learned they are kept."""
        inputs = [_digest(file) for file in self.train]
        file = self._named("constants", seed, LEARNING_UPDATES, LEARNING_SCENES, inputs)

        def learn() -> dict[str, float]:
            found = learned([_scenes(file) for file in self.train], seed)
            return {name: round(value, 6) for name, value in found.items()}

        return kept(file, learn)

    def training(self) -> Training:
        """What rows may learn from."""
        return Training(tuple(_scenes(file) for file in self.train), self.constants)

    def _named(self, *facts: object) -> Path:
        return job_file(self.out, (VERSION, *facts))


@cache
def _digest(path: Path) -> str:
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a file of `cosim scenes`") from error


@cache
def _scenes(path: Path) -> MergeScenes:
    return read_merges(path)


def run(plan: Plan, progress: Progress = no_progress) -> pd.DataFrame:
    """Do the jobs that are not done yet, write the tables, and return the long table of scores.

    Columns: site, row, given, score, value, low, high, seeds. `value` is the mean over seeds; the interval is the one
    over scenes, widened to the least and the greatest seed.
    """
    torch.set_num_threads(1)
    _check_seeds(plan)
    jobs = plan.jobs()
    results = finish(
        jobs,
        plan.file,
        lambda path, row, seed: _result(_scenes(path), plan.training(), row, seed),
        "merges",
        progress,
    )
    table = _table(jobs, results)
    write_whole(plan.out / "merges.csv", table.to_csv(index=False, float_format="%.4f"))
    write_whole(plan.out / "merges.md", markdown(table, plan))
    write_whole(plan.out / "merges.json", json.dumps(card(plan), indent=1))
    return table


def _check_seeds(plan: Plan) -> None:
    """No recording may be in both a test file and a training file of its site."""
    for path in plan.scenes:
        for other in plan.train:
            test, train = _scenes(path), _scenes(other)
            if test.site == train.site and (both := set(test.recording) & set(train.recording)):
                raise InputError(
                    f"--train {other}: has {sorted(both)[0]} of {path} too, wanted other seeds; give another `--seed`"
                    " to `cosim scenes`"
                )


def _result(scenes: MergeScenes, train: Training, row: Row, seed: int) -> dict[str, Any]:
    infer = row.prepare(train, seed)
    found = infer(scenes)
    p, truth = found.steps.numpy(), scenes.steps.numpy()
    answer = p.argmax(-1)
    values = {name: asdict(with_interval(score, answer, truth)) for name, score in STEP_SCORES.items()}
    clear = scenes.unambiguous.numpy()
    values["step_macro_f1_unambiguous"] = asdict(
        with_interval(STEP_SCORES["step_macro_f1"], answer[clear], truth[clear])
    )
    graph, true_graph = found.graph.numpy(), scenes.graph.numpy()
    values["scene_accuracy"] = asdict(with_interval(accuracy, graph, true_graph))
    values["scene_accuracy_unambiguous"] = asdict(with_interval(accuracy, graph[clear], true_graph[clear]))
    error = calibration_error(p, truth)
    values["calibration_error"] = {"value": error, "low": error, "high": error}
    for (i, j), e in zip(PAIRS, range(len(PAIRS)), strict=True):
        values[f"step_accuracy_{i}_to_{j}"] = asdict(with_interval(accuracy, answer[..., e], truth[..., e]))
    if not row.ablation and not seed:
        for control in controls(scenes):
            name = f"false relation: {control.name}"
            values[name] = _false_relations(control, infer(control.scenes).steps.argmax(-1).numpy())
    return {"site": scenes.site, "scores": values}


def _false_relations(control: Control, answer: np.ndarray) -> dict[str, float]:
    steps = answer.shape[1]
    counts = np.arange(steps) >= (steps // 2 if control.after_change else 0)
    impossible = tuple((PAIRS.index(pair), kinds) for pair, kinds in control.impossible)
    rate = claimed(answer, impossible, counts)
    return asdict(with_interval(lambda a, _: float(a.mean()), rate, rate))


def _table(jobs: Sequence[tuple[Path, Row, int]], results: Sequence[dict[str, Any]]) -> pd.DataFrame:
    lines = []
    for (_, row, seed), result in zip(jobs, results, strict=True):
        for name, value in result["scores"].items():
            lines.append((result["site"], row.name, row.given, name, seed, *value.values()))
    columns = ["site", "row", "given", "score", "seed", "value", "low", "high"]
    grouped = pd.DataFrame(lines, columns=columns).groupby(["site", "row", "given", "score"], sort=False)
    return grouped.agg(
        value=("value", "mean"), low=("low", "min"), high=("high", "max"), seeds=("seed", "size")
    ).reset_index()


def markdown(table: pd.DataFrame, plan: Plan) -> str:
    """The page that people read: a table per site, the parts of the model, and the controls."""
    ablations = [row.name for row in ROWS if row.ablation]
    main = table[~table["row"].isin(ablations)]
    parts = [
        "# Relations in SUMO's merges: scores",
        f"{plan.seeds} seeds for rows that depend on one; in brackets 95 % over scenes, widened to the least and the"
        " greatest seed. [How to read this, and how it is made](../../relations-merges.md).",
    ]
    scores = {
        "step_macro_f1": "step macro-F1",
        "step_macro_f1_unambiguous": "same, unambiguous scenes",
        "step_balanced_accuracy": "balanced",
        "step_accuracy": "step accuracy",
        "scene_accuracy": "scenes, all",
        "scene_accuracy_unambiguous": "scenes, unambiguous",
        "calibration_error": "calibration error",
    }
    types = {f"step_f1_{name}": name for name in NAMES}
    pairs_ = {f"step_accuracy_{i}_to_{j}": f"{i} → {j}" for i, j in PAIRS}
    false = {name: name.partition(": ")[2] for name in dict.fromkeys(table["score"]) if name.startswith("false")}
    for site in dict.fromkeys(table["site"]):
        here = main[main["site"] == site]
        parts += [f"## {site}", _grid(here, scores)]
        parts += ["F1 of each relation, and accuracy of each pair (i → j: how j reacts to i):"]
        parts += [_grid(here, types | pairs_, short=True)]
        parts += ["Controls: share of steps with a relation that cannot hold [%]. Seed 0 only."]
        parts += [_grid(here, false)]
    left = table[table["row"].isin([*ablations, POSTERIOR])]
    if len(ablations_found := left[left["score"] == "step_macro_f1"]) and set(left["row"]) & set(ablations):
        sites = list(dict.fromkeys(table["site"]))
        parts += ["## What each part of the model brings", "Step macro-F1 / scenes, all. Seed 0 of the constants."]
        parts += [_ablation(left, sites, list(dict.fromkeys(ablations_found["row"])))]
    return "\n\n".join(parts) + "\n"


def _grid(part: pd.DataFrame, columns: dict[str, str], short: bool = False) -> str:
    """A line per row of the benchmark, a column per score; shares of false relations in percent."""
    lines = [f"| row | given | {' | '.join(columns.values())} |", "|---" * (len(columns) + 2) + "|"]
    cells = {
        (line["row"], line["score"]): _cell(line["score"], line["value"], line["low"], line["high"], short)
        for line in part.to_dict("records")
    }
    for row, given in dict.fromkeys(zip(part["row"], part["given"], strict=True)):
        lines.append(f"| {row} | {given} | {' | '.join(cells.get((row, name), '–') for name in columns)} |")
    return "\n".join(lines)


def _cell(score: str, value: float, low: float, high: float, short: bool) -> str:
    if np.isnan(value):
        return "–"
    factor, digits = (100, 1) if score.startswith("false") else (1, 3)
    shown, least, most = (f"{factor * number:.{digits}f}" for number in (value, low, high))
    return shown if short or low == high else f"{shown} ({least}–{most})"


def _ablation(part: pd.DataFrame, sites: Sequence[str], rows: Sequence[str]) -> str:
    value = part.set_index(["site", "row", "score"])["value"]
    lines = [f"| row | {' | '.join(sites)} |", "|---" * (len(sites) + 1) + "|"]
    for row in rows:
        pairs_ = [(value[site, row, "step_macro_f1"], value[site, row, "scene_accuracy"]) for site in sites]
        lines.append(f"| {row} | {' | '.join(f'{steps:.3f} / {graph:.3f}' for steps, graph in pairs_)} |")
    return "\n".join(lines)


def card(plan: Plan) -> dict[str, Any]:
    """What was scored and taught: sites, seeds, counts, and how often each relation occurs; and learned constants."""
    wanted = not plan.rows or POSTERIOR in plan.rows
    constants = {f"seed {seed}": plan.constants(seed) for seed in range(plan.seeds) if wanted}
    return {
        "version": VERSION,
        "pairs": [f"{i} to {j}: how {j} reacts to {i}" for i, j in PAIRS],
        "roles": {"0": "merging vehicle", "1": "lag vehicle", "2": "leader"},
        "test": [describe(path, _scenes(path)) for path in plan.scenes],
        "training": [describe(path, _scenes(path)) for path in plan.train],
        "learned_constants": constants,
    }
