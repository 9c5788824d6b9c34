"""`gri bench relations`: who reacts to whom? Scores every row on every test set, with intervals.

One job is a row and a seed. A finished job is a file, so that an interrupted command goes on where it stopped. Two runs
of one version write the same bytes.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float

from gri.bench.answers import Infer, ask
from gri.bench.car_following_scenes import DT
from gri.bench.driver_models import DRIVER_MODELS
from gri.bench.families import NEAR, WIDE, KnownScenes, TestSet, split, test_sets
from gri.bench.figures import Curves, draw_abstention, draw_reliability
from gri.bench.resumable_jobs import (
    chosen_jobs,
    finish,
    job_file,
    left_out,
    number,
    pivot,
    score_table,
)
from gri.bench.rows import ROWS, UPDATES, WINDOW, Row
from gri.bench.scores import SCORES, abstention_area, bootstrap, reliability, risk_curve, score, unknown_auc
from gri.core.edges import pairs
from gri.progress import Progress, no_progress
from gri.storage.whole_files import write_whole

VERSION = 2  # of the scenes and rows; another one makes all jobs again
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

    def jobs(self) -> list[tuple[Row, int]]:
        """Rows and seeds; rows that do not depend on the seed are done once."""
        return chosen_jobs(ROWS, self.rows, self.seeds)

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
    jobs = plan.jobs()
    results = finish(jobs, plan.file, lambda row, seed: _result(plan, row, seed), "relations", progress)
    table = score_table(jobs, [result["sets"] for result in results])
    write_whole(plan.out / "relations.csv", table.to_csv(index=False, float_format="%.4f"))
    write_whole(plan.out / "relations.md", markdown(table, plan))
    curves = _curves(jobs, results)
    write_whole(plan.out / "relations_reliability.svg", draw_reliability(curves))
    write_whole(plan.out / "relations_abstention.svg", draw_abstention(curves))
    write_whole(plan.out / "relations.json", json.dumps(card(plan), indent=1))
    return table


@cache
def _training(part: str, count: int) -> tuple[KnownScenes, ...]:
    return tuple(split(part, model, family, count) for family in (NEAR, WIDE) for model in DRIVER_MODELS)


@cache
def _tests(count: int) -> tuple[TestSet, ...]:
    return tuple(test_sets(count))


@dataclass(frozen=True)
class Marked:
    """What a row said of the scored pairs of a test set, beside the truth; S scenes, F pairs whose sender is ahead."""

    p: Float[np.ndarray, "S F"]
    truth: Bool[np.ndarray, "S F"]
    uncertainty: Float[np.ndarray, "S F"]
    behind: Float[np.ndarray, "S B"]
    """P(follow) of the pairs from behind, which are never true."""


def mark(infer: Infer, known: KnownScenes) -> Marked:
    """Ask a row about scenes."""
    every = pairs(known.state.shape[1])
    ahead, behind = ([edge for edge, (i, j) in enumerate(every) if (i > j) is wanted] for wanted in (True, False))
    answer, truth = ask(infer, known), known.graph().numpy() > 0
    p = answer.follow.numpy()
    return Marked(p[:, ahead], truth[:, ahead], answer.uncertainty.numpy()[:, ahead], p[:, behind])


def scores_of(marked: Marked) -> dict[str, dict[str, float]]:
    """All scores of a test set, each with its interval."""
    values = {name: asdict(score(name, marked.p, marked.truth)) for name in SCORES}
    values["abstention_area"] = asdict(bootstrap(abstention_area, marked.p, marked.truth, doubt(marked.p)))
    values["false_follow_from_behind"] = asdict(
        score("false_follow", marked.behind, np.zeros_like(marked.behind, bool))
    )
    return values


def _result(plan: Plan, row: Row, seed: int) -> dict[str, Any]:
    infer = row.prepare(_training("train", plan.training), _training("validation", plan.validation), seed)
    marked = {tested.name: (tested.kind, mark(infer, tested.scenes[: row.most])) for tested in _tests(plan.scenes)}
    known = [part for kind, part in marked.values() if kind == "drivers"]
    everyday = np.concatenate([part.uncertainty.mean(1) for part in known])
    sets = []
    for name, (kind, part) in marked.items():
        values = scores_of(part)
        if kind == "unknown":
            uncertainty = np.concatenate([everyday, part.uncertainty.mean(1)])
            strange = np.arange(len(uncertainty)) >= len(everyday)
            values["unknown_auc"] = asdict(bootstrap(unknown_auc, uncertainty, strange))
        sets.append({"set": name, "kind": kind, "scores": values})
    p, truth = (np.concatenate([getattr(part, what) for part in known]) for what in ("p", "truth"))
    return {"sets": sets, "reliability": reliability(p, truth), "risk": risk_curve(p, truth, doubt(p))}


def doubt(p: Float[np.ndarray, "S F"]) -> Float[np.ndarray, "S F"]:
    """1 − the probability of the answer that is given: the order in which a row abstains."""
    return 1 - np.maximum(p, 1 - p)


def _curves(jobs: Sequence[tuple[Row, int]], results: Sequence[dict[str, Any]]) -> dict[str, Curves]:
    """The diagrams of each row over all foreign drivers: pairs of all seeds together, mean risk."""
    found: dict[str, list[dict[str, Any]]] = {}
    for (row, _), result in zip(jobs, results, strict=True):
        found.setdefault(row.name, []).append(result)
    return {
        name: Curves(
            pairs=np.sum([part["reliability"]["pairs"] for part in parts], 0),
            p=np.sum([part["reliability"]["p"] for part in parts], 0),
            true=np.sum([part["reliability"]["true"] for part in parts], 0),
            risk=np.mean([part["risk"] for part in parts], 0),
        )
        for name, parts in found.items()
    }


def markdown(table: pd.DataFrame, plan: Plan) -> str:
    """The page that people read: a summary, balanced accuracy per driver model, false follow per control."""
    accuracy = table[(table["kind"] == "drivers") & (table["score"] == "balanced_accuracy")]
    false = table[(table["kind"] == "control") & (table["score"] == "false_follow")]
    missing = [row.name for row in left_out(ROWS) if not plan.rows]
    fewer = "".join(f" ({row.name}: {row.most})" for row in ROWS if row.most and row.most < plan.scenes)
    parts = [
        "# Who reacts to whom: scores",
        f"{plan.scenes} scenes per set{fewer}, {plan.seeds} seeds for rows that"
        " depend on one."
        " [How to read this, and how it is made](../../relations.md).",
        *([f"Left out: {', '.join(missing)}; install the extra `bench`."] if missing else []),
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
        "## Unknown worlds: AUROC of uncertainty",
        "Probability that a row trusts itself less in a scene of an unknown world than in one of the drivers above; 0.5"
        " is chance. The uncertainty of a scene is the mean over its scored pairs.",
        pivot(table[table["score"] == "unknown_auc"], "", number),
        "## How far probabilities can be trusted",
        "Foreign drivers, all seeds together. Left out of the diagram: bins with fewer than 20 pairs.",
        "![Share of true edges against P(follow), one panel per row](relations_reliability.svg)",
        "![Share of wrong answers against coverage, one panel per row](relations_abstention.svg)",
    ]
    return "\n\n".join(parts) + "\n"


def _summary(table: pd.DataFrame) -> str:
    """One line per row: worst and mean balanced accuracy, mean AUC, macro-F1, calibration, mean false follow."""
    lines = [
        "| row | given | balanced accuracy, worst / mean [%] | macro-F1 [%] | AUC | calibration error | abstention area"
        " | false follow, worst / mean [%] | unknown worlds, AUROC |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (name, given), part in table.groupby(["row", "given"], sort=False):
        drivers, control = part[part["kind"] == "drivers"], part[part["kind"] == "control"]
        value = dict(tuple(drivers.groupby("score")["value"]))
        wrong = control.loc[control["score"] == "false_follow", "value"]
        accuracy = value["balanced_accuracy"]
        lines.append(
            f"| {name} | {given} | {100 * accuracy.min():.0f} / {100 * accuracy.mean():.0f}"
            f" | {100 * value['macro_f1'].mean():.0f} | {value['auc'].mean():.2f}"
            f" | {value['calibration_error'].mean():.2f} | {value['abstention_area'].mean():.2f}"
            f" | {100 * wrong.max():.0f} / {100 * wrong.mean():.0f}"
            f" | {part.loc[part['score'] == 'unknown_auc', 'value'].mean():.2f} |"
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
