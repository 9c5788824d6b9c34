"""`gri bench lanes`: who reacts to whom in merges? Scores every row at every step of every test set, with intervals.

Two runs of one version write the same bytes, and an interrupted one goes on where it stopped (`resumable_jobs`).
"""

import json
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from torch import Tensor

from gri.bench.driver_models import DRIVER_MODELS
from gri.bench.lane_classifier import MOST
from gri.bench.lane_families import FIRST, LANES, SHARES, SPLIT_SEEDS, LaneTest, lane_split, lane_tests
from gri.bench.lane_rows import FRAME_UPDATES, LANE_ROWS, STRIDE, UPDATES, WINDOW, LaneRow
from gri.bench.lane_scenes import (
    LaneScenes,
    balanced_steps,
    pairs_of_merger,
    pairs_that_may_react,
    role_pairs,
    shares,
    summary_graph,
)
from gri.bench.lane_scores import accuracy, confusion_counts, false_relation, scores_of, with_interval
from gri.bench.resumable_jobs import Job, chosen_jobs, finish, job_file, pivot, score_table
from gri.bench.scores import Score
from gri.core.edges import LANE_CHANGING
from gri.progress import Progress, no_progress
from gri.storage.whole_files import write_whole

VERSION = 1  # of the scenes and rows; another one makes all jobs again
TRAINING = 500  # scenes of each driver model
NAMES = tuple(str(kind) for kind in LANE_CHANGING)


@dataclass(frozen=True)
class LanePlan:
    """What to score, and where results go."""

    out: Path
    seeds: int = 3
    scenes: int = 200
    """Of each test set."""
    rows: tuple[str, ...] = ()
    """Only rows of these names; () for all."""
    training: int = TRAINING

    def jobs(self) -> list[Job[LaneScenes, Tensor]]:
        """Rows and seeds."""
        return chosen_jobs(LANE_ROWS, self.rows, self.seeds)

    def file(self, row: LaneRow, seed: int) -> Path:
        """Where the result of a job is kept."""
        constants = (UPDATES, FRAME_UPDATES, WINDOW, STRIDE)
        return job_file(self.out, ("lanes", VERSION, row.name, row.given, seed, self.scenes, self.training, constants))


def run_lanes(plan: LanePlan, progress: Progress = no_progress) -> pd.DataFrame:
    """Do the jobs that are not done yet, write lanes.csv, lanes.md and lanes.json, and return the table of scores.

    Raises:
        InputError: a row that does not exist.
    """
    torch.set_num_threads(1)
    jobs = plan.jobs()
    results = finish(jobs, plan.file, lambda row, seed: _result(plan, row, seed), "lanes", progress)
    table = score_table(jobs, results)
    write_whole(plan.out / "lanes.csv", table.to_csv(index=False, float_format="%.4f"))
    write_whole(plan.out / "lanes.md", markdown(table, plan))
    write_whole(plan.out / "lanes.json", json.dumps(card(plan), indent=1))
    return table


@cache
def _training(count: int) -> tuple[LaneScenes, ...]:
    return tuple(lane_split("train", model, count) for model in DRIVER_MODELS)


@cache
def _tests(count: int) -> tuple[LaneTest, ...]:
    return tuple(lane_tests(count))


def _result(plan: LanePlan, row: LaneRow, seed: int) -> list[dict[str, Any]]:
    infer = row.prepare(_training(plan.training), (), seed)
    found = []
    for tested in _tests(plan.scenes):
        scores = score_set(tested, infer(tested.scenes).numpy())
        values = {name: asdict(value) for name, value in scores.items()}
        found.append({"set": tested.name, "kind": tested.kind, "scores": values})
    return found


def score_set(tested: LaneTest, p: np.ndarray) -> dict[str, Score]:
    """All scores of probabilities [S, T, E, K] on a test set.

    In controls only pairs with the merger are scored, and only by how often a relation is claimed.
    """
    scenes = tested.scenes
    truth, called = scenes.relations.numpy(), p.argmax(-1)
    if tested.kind == "control":
        return {"false_relation": _false(called, truth, pairs_of_merger(scenes.roles))}
    edges = pairs_that_may_react(scenes.roles)
    scored = balanced_steps(scenes.relations, edges, FIRST, MOST, seed=1).numpy()
    found = dict(scores_of(p, truth, scored, NAMES))
    inferred = summary_graph(torch.from_numpy(called[:, FIRST:]), scenes.dt)
    graph = summary_graph(scenes.relations[:, FIRST:], scenes.dt)
    chosen = balanced_steps(graph[:, None], edges, 0, MOST, seed=1)[:, 0]
    counts = confusion_counts(inferred.numpy(), graph.numpy(), chosen.numpy(), len(NAMES))
    found["scene_accuracy"] = with_interval(accuracy, counts)
    behind = [edge for edge in range(truth.shape[-1]) if edge not in edges]
    return found | {"false_relation_into_leader": _false(called, truth, behind)}


def _false(called: np.ndarray, truth: np.ndarray, edges: list[int]) -> Score:
    part = called[:, FIRST:][..., edges], truth[:, FIRST:][..., edges]
    return with_interval(false_relation, confusion_counts(*part, np.ones_like(part[1], bool), len(NAMES)))


def markdown(table: pd.DataFrame, plan: LanePlan) -> str:
    """The page that people read: a summary, macro-F1 per driver model, false relations per control."""
    f1, false = (table[table["score"] == name] for name in ("macro_f1", "false_relation"))
    return (
        "\n\n".join(
            [
                "# Who reacts to whom on two lanes: scores",
                f"{plan.scenes} scenes per set, {plan.seeds} seeds for rows that depend on one."
                " [How to read this, and how it is made](../../relations-lanes.md).",
                "## Summary",
                "Means over the six driver models; macro-F1 also for the worst.",
                _summary(table),
                "## Macro-F1 of single steps [%]",
                "In brackets: 95 % over scenes, widened to the least and the greatest seed.",
                pivot(f1[f1["kind"] == "drivers"]),
                "Scenes with two vehicles; the third one is there, but nobody sees it:",
                pivot(f1[f1["kind"] == "variant"]),
                "## False relations in controls [%]",
                "Share of steps and pairs with the merger for which a relation is claimed. None is there.",
                pivot(false),
            ]
        )
        + "\n"
    )


def _summary(table: pd.DataFrame) -> str:
    heads = ["row", "given", "macro-F1, worst / mean [%]", "accuracy [%]"]
    heads += [f"recall: {name.replace('_', ' ')} [%]" for name in NAMES]
    heads += ["scene accuracy [%]", "calibration error", "false relation in controls, worst / mean [%]"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for (name, given), part in table.groupby(["row", "given"], sort=False):
        drivers = part[part["kind"] == "drivers"]
        value = {str(score): group["value"] for score, group in drivers.groupby("score")}
        wrong = part.loc[part["score"] == "false_relation", "value"]
        shown = [f"{100 * value[key].mean():.0f}" for key in ("accuracy", *(f"recall_{kind}" for kind in NAMES))]
        cells = [str(name), str(given), f"{100 * value['macro_f1'].min():.0f} / {100 * value['macro_f1'].mean():.0f}"]
        cells += [*shown, f"{100 * value['scene_accuracy'].mean():.0f}", f"{value['calibration_error'].mean():.2f}"]
        cells.append(f"{100 * wrong.max():.0f} / {100 * wrong.mean():.0f}")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def card(plan: LanePlan) -> dict[str, Any]:
    """What was scored: scenes of each kind, share of drawn scenes kept, how often each type occurs."""
    return {
        "version": VERSION,
        "training_scenes_per_driver_model": plan.training,
        "first_scored_step": FIRST,
        "greatest_share_of_a_type_among_scored_steps": MOST,
        "split_seeds": SPLIT_SEEDS,
        "shares_of_kinds": SHARES,
        "family": asdict(LANES),
        "driver_models": {model.name: {"source": model.source, **model.ranges} for model in DRIVER_MODELS},
        "sets": [_described(tested) for tested in _tests(plan.scenes)],
    }


def _described(tested: LaneTest) -> dict[str, Any]:
    scenes, kinds = tested.scenes, np.array(tested.scenes.kind)
    edges = pairs_that_may_react(scenes.roles)
    scored = balanced_steps(scenes.relations, edges, FIRST, MOST, seed=1)
    pairs = {}
    for edge in edges:
        sender, receiver = role_pairs(scenes.roles)[edge]
        types, chosen = scenes.relations[:, FIRST:, edge], scenes.relations[..., edge][scored[..., edge]]
        pairs[f"{sender} to {receiver}"] = {
            "scored_steps": len(chosen),
            "types_of_all_steps": dict(zip(NAMES, (round(share, 4) for share in shares(types)), strict=True)),
            "types_of_scored_steps": dict(zip(NAMES, (round(share, 4) for share in shares(chosen)), strict=True)),
        }
    return {
        "set": tested.name,
        "kind": tested.kind,
        "scenes": {str(kind): int((kinds == kind).sum()) for kind in dict.fromkeys(scenes.kind)},
        "drawn_scenes_kept": {
            str(kind): round(float(scenes.acceptance[torch.from_numpy(kinds == kind)].mean()), 4)
            for kind in dict.fromkeys(scenes.kind)
        },
        "pairs": pairs,
    }
