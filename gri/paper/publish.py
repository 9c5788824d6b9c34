"""Write the results of a plan: tables as CSV, Parquet and Markdown, figures, and how all of it was made."""

import json
import subprocess
import time
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from gri.data.scene_file.schema import header_of
from gri.paper import figures, pages, wrong_constants
from gri.paper.job_cache import Job, scenarios_of
from gri.paper.plan import Plan, command, make
from gri.paper.score_frames import areas, curve_frame, released, score_frame
from gri.paper.synthetic_measurements import oracle_curve
from gri.progress import Progress, no_progress
from gri.storage.whole_files import whole_file, write_whole


def publish(plan: Plan, progress: Progress = no_progress) -> list[Path]:
    """Run the missing jobs of a plan and write its tables and figures. Returns the files.

    Each scenario of Table II has a folder of its own. Errors: `InputError` where the plan asks for what does not exist.
    """
    began = time.monotonic()
    if plan.target == "constants":
        return _publish_constants(plan, began, progress)
    jobs = make(plan, progress)
    if plan.target != "table2":
        return _publish(plan, jobs, began, progress)
    files = []
    for scenario in scenarios_of(jobs):
        part = replace(plan, scenario=scenario.name, out=plan.out / scenario.name.removeprefix("ngsim_"))
        files += _publish(part, [job for job in jobs if job.scenario.name == scenario.name], began, progress)
    return files


def _publish(plan: Plan, jobs: Sequence[Job], began: float, progress: Progress) -> list[Path]:
    cache, target = plan.cache, plan.target
    if target in ("table1", "table3", "equal_terms"):
        scores = score_frame(jobs, cache)
        files = write_tables(plan, {target: released(scores)}, pages.score_page(target, jobs, cache, scores))
    elif target == "table2":
        scores, curves = score_frame(jobs, cache), curve_frame(jobs, cache, {})
        page_of = pages.lane_change_page if jobs[0].scenario.cross_validation else pages.car_following_page
        frames = {"table2": released(scores), "table2_ood": curves}
        files = write_tables(plan, frames, page_of(jobs, cache, scores, curves))
        files += figures.draw(jobs, cache, plan.scenes_folder, curves, plan.out)
    else:
        curves = curve_frame(jobs, cache, oracle_curves(jobs, cache, progress))
        if target == "ood":
            files = write_tables(plan, {"ood": curves, "ood_areas": areas(curves)}, pages.curve_page(jobs, curves))
        else:
            files = figures.draw(jobs, cache, plan.scenes_folder, curves, plan.out / "figures")
    path = plan.out / f"{target}.json"
    write_whole(path, json.dumps(provenance(plan, jobs, began), indent=1) + "\n")
    return [*files, path]


def _publish_constants(plan: Plan, began: float, progress: Progress) -> list[Path]:
    frame = wrong_constants.measure(
        plan.seeds,
        plan.test_scenes,
        plan.cache,
        plan.scenes_folder,
        plan.scenario,
        plan.rows,
        plan.finished,
        progress,
    )
    files = write_tables(plan, {"constants": frame}, wrong_constants.page(frame))
    made = {"command": command(plan), "commit": commit(), "cpu_seconds": round(float(frame["cpu_seconds"].sum()), 1)}
    made |= {"this_call_seconds": round(time.monotonic() - began, 1), "torch": str(torch.__version__)}
    path = plan.out / "constants.json"
    write_whole(path, json.dumps(made | {"gri-cosim": version("gri-cosim")}, indent=1) + "\n")
    return [*files, path]


def oracle_curves(jobs: Sequence[Job], cache: Path, progress: Progress) -> dict[str, list[dict[str, Any]]]:
    """The out-of-distribution curve of the optimum, for each synthetic scenario."""
    curves: dict[str, list[dict[str, Any]]] = {}
    scenarios = scenarios_of(jobs)
    for count, scenario in enumerate(scenarios):
        first = next(job for job in jobs if job.scenario.name == scenario.name)
        curves[scenario.name] = oracle_curve(first, cache)
        progress("oracle", count + 1, len(scenarios), 0.0)
    return curves


def write_tables(plan: Plan, frames: dict[str, pd.DataFrame], page: str) -> list[Path]:
    """Each frame as CSV and Parquet, and a Markdown page."""
    files = [plan.out / f"{plan.target}.md"]
    write_whole(files[0], page)
    for name, frame in frames.items():
        files += [plan.out / f"{name}.csv", plan.out / f"{name}.parquet"]
        with whole_file(files[-2]) as part:
            frame.to_csv(part, index=False)
        with whole_file(files[-1]) as part:
            frame.to_parquet(part, index=False)
    return files


def provenance(plan: Plan, jobs: Sequence[Job], began: float) -> dict[str, Any]:
    """How the files were made: command, commit, seeds, scenes, durations and versions."""
    whole = [job for job in jobs if job.site is None]
    made: dict[str, Any] = {
        "command": command(plan),
        "commit": commit(),
        "seeds": sorted({job.seed for job in whole}),
        "jobs": len(jobs),
    }
    duration = round(time.monotonic() - began, 1)
    if plan.target == "table2":
        assert jobs[0].scene_file is not None
        names = dict.fromkeys(job.row.name for job in whole)
        cpu_seconds = sum(job.result(plan.cache)["cpu_seconds"] for job in jobs)
        made["rows"] = {name: [job.seed for job in whole if job.row.name == name] for name in names}
        made["scenes"] = header_of(jobs[0].scene_file.path).provenance
        made |= {"seconds": duration, "cpu_seconds": round(cpu_seconds, 1)}
    else:
        spent = [job.made(plan.cache) for job in jobs]
        made["test_scenes"] = plan.test_scenes
        made["training_seconds"] = round(sum(each["seconds"] for each in spent), 1)
        made["training_cpu_seconds"] = round(sum(each.get("cpu_seconds") or 0 for each in spent), 1)
        made["testing_seconds"] = round(sum(each["tests"] for each in spent), 1)
        made["this_call_seconds"] = duration
    return made | {"torch": str(torch.__version__), "gri-cosim": version("gri-cosim")}


def commit() -> str:
    """The commit of the source tree, with "+" where files were changed; "unknown" outside of a source tree."""
    here = Path(__file__).parents[1]
    try:
        options: dict[str, Any] = {"cwd": here, "capture_output": True, "text": True, "check": True, "timeout": 60}
        head = subprocess.run(["git", "rev-parse", "HEAD"], **options)
        state = ["git", "status", "--porcelain", "--untracked-files=no", "--", ".", "../scenarios"]
        changed = subprocess.run(state, **options)
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return head.stdout.strip() + ("+" if changed.stdout.strip() else "")
