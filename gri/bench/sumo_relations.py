"""`gri bench relations --sumo FILE …`: every row on SUMO's drivers, whose relations are known by intervention.

All rows may learn from the training scenes of the same files: states only, or relations where the row is taught. A
finished job is a file, so that an interrupted command continues. Two runs of one version write the same bytes.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from jaxtyping import Bool, Float

from gri.bench.answers import ask
from gri.bench.resumable_jobs import chosen_jobs, finish, job_file, left_out, pivot, score_table
from gri.bench.rows import ROWS, UPDATES, Row
from gri.bench.scores import SCORES, score
from gri.bench.sumo_scenes import (
    AHEAD,
    SumoFile,
    SumoScenes,
    best_constant,
    joined,
    lengthened,
    matched_auc_score,
    read_sumo_file,
)
from gri.progress import Progress, no_progress
from gri.storage.whole_files import write_whole

VERSION = 1  # of the scores; another one makes all jobs again


@dataclass(frozen=True)
class SumoPlan:
    """What to score, and where results go."""

    out: Path
    files: tuple[Path, ...]
    seeds: int = 5
    rows: tuple[str, ...] = ()
    """Only rows of these names; () for all."""

    @cached_property
    def read(self) -> tuple[SumoFile, ...]:
        return tuple(map(read_sumo_file, self.files))

    @cached_property
    def digest(self) -> str:
        """Of the content of all files."""
        return sha256(b"".join(sha256(path.read_bytes()).digest() for path in self.files)).hexdigest()

    def part(self, name: str) -> list[SumoScenes]:
        """The scenes of a split, by file."""
        return [of.parts[name] for of in self.read]

    @cached_property
    def test(self) -> SumoScenes:
        """All test scenes."""
        return joined(self.part("test"))

    @cached_property
    def sets(self) -> dict[str, Bool[np.ndarray, " S"]]:
        """Which test scenes belong to a set: by car-following model, all, and those whose relations never change."""
        drivers = np.concatenate([[of.drivers] * len(of.parts["test"].known) for of in self.read])
        models = {model: drivers == model for model in dict.fromkeys(of.drivers for of in self.read)}
        return models | {"all": np.ones(len(drivers), bool), "unambiguous": self.test.unambiguous}

    def file(self, row: Row, seed: int) -> Path:
        """Where the result of a job is kept; the name changes with whatever changes the result."""
        return job_file(self.out, ("sumo", VERSION, row.name, row.given, seed, self.digest, UPDATES))


def run_sumo(plan: SumoPlan, progress: Progress = no_progress) -> pd.DataFrame:
    """Do the jobs that are not done yet, write `sumo.csv`, `sumo.md` and `sumo.json`, and return the table of scores.

    Columns: row, given, set, kind, score, value, low, high, seeds, as in `gri.bench.relations.run`. Scores that begin
    with "step_" compare the one answer with the relations of every step.
    """
    torch.set_num_threads(1)
    jobs = chosen_jobs(ROWS, plan.rows, plan.seeds)
    results = finish(jobs, plan.file, lambda row, seed: _result(plan, row, seed), "SUMO", progress)
    table = score_table(jobs, results)
    write_whole(plan.out / "sumo.csv", table.to_csv(index=False, float_format="%.4f"))
    write_whole(plan.out / "sumo.md", markdown(table, plan))
    write_whole(plan.out / "sumo.json", json.dumps(card(plan), indent=1))
    return table


def _result(plan: SumoPlan, row: Row, seed: int) -> list[dict[str, Any]]:
    train, validation = ([of.known for of in plan.part(name)] for name in ("train", "validation"))
    infer = row.prepare(train, validation, seed)
    chosen = {name: np.flatnonzero(of)[: row.most] for name, of in plan.sets.items()}
    asked = np.unique(np.concatenate(list(chosen.values())))
    p = np.full(plan.test.truth.shape, np.nan)
    p[asked] = ask(infer, plan.test[asked].known).follow.numpy()[:, AHEAD]
    return [
        {"set": name, "kind": "sumo", "scores": scores_of(p[scenes], plan.test[scenes])}
        for name, scenes in chosen.items()
    ]


def scores_of(p: Float[np.ndarray, "S F"], scenes: SumoScenes) -> dict[str, dict[str, float]]:
    """All scores of P(follow) of the pairs whose sender is ahead."""
    truth = scenes.truth
    by_step = lengthened(p, scenes.steps)
    found = {name: score(name, p, truth) for name in SCORES}
    found |= {f"step_{name}": score(name, *by_step) for name in ("balanced_accuracy", "macro_f1")}
    # Missing edges of the other kind count as true, so that they do not count.
    found["false_follow_same_lane"] = score("false_follow", p, truth | ~scenes.same_lane)
    found["false_follow_lane_beside"] = score("false_follow", p, truth | scenes.same_lane)
    found["matched_auc"] = matched_auc_score(p, scenes)
    return {name: asdict(value) for name, value in found.items()}


def markdown(table: pd.DataFrame, plan: SumoPlan) -> str:
    """The page that people read."""
    every = table[table["set"] == "all"]
    columns = {
        "macro_f1": "macro-F1",
        "auc": "AUC",
        "matched_auc": "AUC at equal geometry",
        "calibration_error": "calibration error",
        "step_balanced_accuracy": "per step: balanced accuracy",
        "step_macro_f1": "per step: macro-F1",
        "false_follow_same_lane": "false follow: vehicle in between",
        "false_follow_lane_beside": "false follow: lane beside",
    }
    missing = [row.name for row in left_out(ROWS) if not plan.rows]
    sizes = [int(of.sum()) for of in plan.sets.values()]
    fewer = "".join(f" ({row.name}: {row.most} of a set)" for row in ROWS if row.most and row.most < max(sizes))
    more = every[every["score"].isin(list(columns))].assign(set=lambda part: part["score"].map(columns))
    return (
        "\n\n".join(
            [
                "# Who reacts to whom in SUMO: scores",
                f"{len(plan.test.known)} test scenes{fewer} of {len(plan.files)} files, {plan.seeds} seeds for rows"
                " that depend on one. [How to read this, and how it is made](../../relations-sumo.md).",
                f"The best constant graph is right in {100 * best_constant(plan.test.truth):.0f} % of the scored"
                " pairs. In brackets: 95 % over scenes, widened to the least and the greatest seed.",
                *([f"Left out: {', '.join(missing)}; install the extra `bench`."] if missing else []),
                "## Balanced accuracy [%]",
                pivot(table[table["score"] == "balanced_accuracy"], ""),
                "## Other scores of all test scenes [%]",
                pivot(more, ""),
            ]
        )
        + "\n"
    )


def card(plan: SumoPlan) -> dict[str, Any]:
    """What was scored: the origin of each file, and the scenes and true edges of each set and split."""
    files = []
    for of, path in zip(plan.read, plan.files, strict=True):
        origin = {name: of.provenance[name] for name in ("source", "count", "per_seed", "seeds", "rules")}
        files.append(
            {"file": path.name, "sha256": sha256(path.read_bytes()).hexdigest(), "drivers": of.drivers} | origin
        )
    named: Sequence[tuple[str, SumoScenes]] = [
        *((name, joined(plan.part(name))) for name in ("train", "validation")),
        *((name, plan.test[of]) for name, of in plan.sets.items()),
    ]
    sets = [
        {
            "set": name,
            "scenes": len(scenes.known),
            "true_edges_of_scored_pairs": round(float(scenes.truth.mean()), 4),
            "best_constant_graph": round(best_constant(scenes.truth), 4),
            "unambiguous_scenes": int(scenes.unambiguous.sum()),
            "missing_edges_in_one_lane": round(float(scenes.same_lane[~scenes.truth].mean()), 4),
        }
        for name, scenes in named
    ]
    return {"version": VERSION, "files": files, "sets": sets}
