"""Write what a plan made: tables as CSV, Parquet and Markdown, figures, and how all of it came about."""

import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from gri.evaluation.out_of_distribution import Front
from gri.paper import figures, rows, tables
from gri.paper.jobs import Job
from gri.paper.reproduce import Plan, make, oracles, provenance
from gri.progress import Progress, no_progress

NOTES = """\
Ours: mean over seeds ± standard deviation over test scenes (mean over seeds) [least seed, greatest seed]. Paper: mean
± standard deviation. "4 edges": edges into driven vehicles; F1 is over those. Labels of models whose types have no
meaning are renamed for the accuracy, "none" excepted. Absolute errors depend on scene constants and on the noise of
the expert, of which the paper prints none: compare the ratios of rows.
"""
OOD_NOTES = """\
Only the edge 1 -> 0, "follow", is left; vehicle 0 starts at the headway in the head of the column; success: at least
2 m behind vehicle 1 after T steps. GRI's training maximises the learned reward from shifted starts as well, which cover
these headways, without demonstrations there; "tested range held out" does not react to anything nearer than the
training scenes' least headway in those roll-outs. The oracle is the open-loop optimum of the true reward over the same
T steps; policies can pass it, as success is not what it maximises.
"""
FLIP_NOTES = """\
Flip test, least seed: an edge is forced from one type to another on the same start; in what share of the scenes [%]
does the final headway x_i − x_j (its sign: the order; or the lateral distance) change the way it does in the optimum
of the true reward? Scenes in which that changes it by less than 0.1 m do not count.
"""
FRONTS = {
    Front.CONSTANT_SPEED: "Vehicle 1 keeps its speed",
    Front.POLICY: "Vehicle 1 is driven by the same policy, without a vehicle to heed",
}


def publish(plan: Plan, progress: Progress = no_progress) -> list[Path]:
    """Make what is missing, then write everything; returns the files."""
    began = time.monotonic()
    wanted = make(plan, progress)
    if plan.target in ("table1", "table3"):
        written = _scores(plan, wanted)
    else:
        curves = tables.curve_rows(wanted, plan.cache, oracles(plan, wanted, progress))
        written = _curves(plan, wanted, curves) if plan.target == "ood" else _figures(plan, wanted, curves)
    path = plan.out / f"{plan.target}.json"
    path.write_text(json.dumps(provenance(plan, wanted, began), indent=1) + "\n")
    return [*written, path]


def _seeds(wanted: Sequence[Job]) -> str:
    """How many seeds the rows have: one number where all have as many."""
    counts = Counter((job.scenario.name, job.row.name) for job in wanted).values()
    return str(max(counts)) if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"


def _scenarios(wanted: Sequence[Job]) -> list[rows.Scenario]:
    return [rows.scenario_named(name) for name in dict.fromkeys(job.scenario.name for job in wanted)]


def _write(plan: Plan, frames: dict[str, pd.DataFrame], text: str) -> list[Path]:
    plan.out.mkdir(parents=True, exist_ok=True)
    written = []
    for name, frame in frames.items():
        frame.to_csv(plan.out / f"{name}.csv", index=False)
        frame.to_parquet(plan.out / f"{name}.parquet", index=False)
        written += [plan.out / f"{name}.csv", plan.out / f"{name}.parquet"]
    path = plan.out / f"{plan.target}.md"
    path.write_text(text, encoding="utf-8")
    return [path, *written]


def _scores(plan: Plan, wanted: Sequence[Job]) -> list[Path]:
    scores = tables.score_rows(wanted, plan.cache)
    scenes = ", ".join(str(count) for count in sorted(scores[scores["metric"] == "rmse_x"]["scenes"].unique()))
    parts = [f"# {plan.target}: {_seeds(wanted)} seeds, {scenes} test scenes\n", NOTES]
    for scenario in _scenarios(wanted):
        parts += [f"## {scenario.title}\n", tables.markdown_table(scores, scenario) + "\n"]
        flips = tables.markdown_flips(scores, scenario)
        if flips:
            parts += [FLIP_NOTES, flips + "\n"]
        weights = tables.markdown_weights(wanted, plan.cache, scenario)
        if weights:
            parts += ["Reward weights over the jerk's, mean over seeds [range]:\n", weights + "\n"]
    return _write(plan, {plan.target: scores}, "\n".join(parts))


def _curves(plan: Plan, wanted: Sequence[Job], curves: pd.DataFrame) -> list[Path]:
    parts = [f"# Out of distribution: success rate [%], mean over {_seeds(wanted)} seeds\n", OOD_NOTES]
    for scenario in _scenarios(wanted):
        for front, title in FRONTS.items():
            parts += [f"## {scenario.title}. {title}\n", tables.markdown_curves(curves, scenario, front) + "\n"]
            if "y" in scenario.features:
                collisions = tables.markdown_curves(curves, scenario, front, "collision")
                parts += ["Collision rate [%]: closer than 2 m at some instant.\n", collisions + "\n"]
    return _write(plan, {"ood": curves, "ood_areas": tables.areas(curves)}, "\n".join(parts))


def _figures(plan: Plan, wanted: Sequence[Job], curves: pd.DataFrame) -> list[Path]:
    folder = plan.out / "figures"
    names = figures.draw(wanted, plan.cache, plan.scenes_folder, curves, folder)
    return [folder / f"{name}.{kind}" for name in names for kind in ("png", "svg")]
