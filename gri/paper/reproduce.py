"""Train whatever rows a table or figure needs, a process per row and seed, and write it beside the paper's figures."""

import multiprocessing
import subprocess
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import msgspec
import torch

from gri.data.store import scenes_of, scenes_path
from gri.errors import InputError
from gri.paper import jobs, rows
from gri.paper.jobs import Job
from gri.progress import Progress, no_progress

Target = Literal["table1", "table3", "ood", "figures"]
TABLES: dict[str, tuple[str, ...]] = {
    "table1": ("table1",),
    "table3": ("table3",),
    "ood": ("ood",),
    "figures": ("table1", "table3", "ood"),
}


@dataclass(frozen=True)
class Plan:
    """What is to be made, and where it is kept."""

    target: Target
    seeds: int = 5
    scenes: int = 1000
    """Test scenes."""
    out: Path = Path("runs/reproduce")
    cache: Path = Path("runs/reproduce/jobs")
    scenes_folder: Path = Path("runs/scenes")
    scenario: str | None = None
    """Only this scenario; None: all."""
    rows: tuple[str, ...] = ()
    """Only the rows of these names; none: all."""
    quick: bool = False
    processes: int = 2
    finished: bool = False
    """Take the rows and seeds that are done, and train nothing."""


def command(plan: Plan) -> str:
    """The command that makes this plan's files anywhere; where they were kept here does not matter."""
    parts = ["gri reproduce", plan.target, f"--seeds {plan.seeds}", f"--scenes {plan.scenes}"]
    parts += [f"--scenario {plan.scenario}"] if plan.scenario else []
    parts += [f'--row "{name}"' for name in plan.rows]
    parts += ["--quick"] if plan.quick else []
    return " ".join([*parts, *(["--finished"] if plan.finished else [])])


def jobs_of(plan: Plan) -> list[Job]:
    """Every row and seed the target needs, seed by seed, so that an interrupted run has whole tables to show."""
    known = [scenario.name for scenario in rows.SCENARIOS]
    if plan.scenario is not None and plan.scenario not in known:
        raise InputError(f"got scenario {plan.scenario}, wanted one of {', '.join(known)}")
    made = []
    for seed in range(plan.seeds):
        for scenario in rows.SCENARIOS:
            if plan.scenario in (None, scenario.name):
                made += [_job(plan, scenario, row, seed) for row in _rows(scenario, plan)]
    return made


def _rows(scenario: rows.Scenario, plan: Plan) -> list[rows.Row]:
    names = [row.name for every in rows.SCENARIOS for row in every.rows]
    unknown = [name for name in plan.rows if name not in names]
    if unknown:
        raise InputError(f"got row {unknown[0]}, wanted one of {', '.join(dict.fromkeys(names))}")
    wanted = [row for table in TABLES[plan.target] for row in rows.rows_of(scenario, table)]
    return [row for row in scenario.rows if row in wanted and (not plan.rows or row.name in plan.rows)]


def _job(plan: Plan, scenario: rows.Scenario, row: rows.Row, seed: int) -> Job:
    config = rows.config_of(scenario, row)
    assert config is not None
    config = msgspec.structs.replace(config, data=msgspec.structs.replace(config.data, test=plan.scenes))
    job = Job(scenario, row, config, seed)
    return jobs.quick(job) if plan.quick else job


def make(plan: Plan, progress: Progress = no_progress) -> list[Job]:
    """Do all jobs that are not done yet; returns all of them."""
    wanted = jobs_of(plan)
    if plan.finished:
        return _finished(wanted, plan)
    for job in wanted:
        if not job.is_done(plan.cache) and not scenes_path(job.config.data, plan.scenes_folder).is_file():
            scenes_of(job.config.data, plan.scenes_folder, progress)
    missing = [job for job in wanted if not job.is_done(plan.cache)]
    done = len(wanted) - len(missing)
    progress("rows and seeds", done, len(wanted), 0.0)
    for job in _in_processes(missing, plan):
        done += 1
        progress("rows and seeds", done, len(wanted), job.made(plan.cache)["seconds"])
    return wanted


def _finished(wanted: Sequence[Job], plan: Plan) -> list[Job]:
    done = [job for job in wanted if job.is_done(plan.cache)]
    if not done:
        raise InputError(f"got --finished, but nothing is finished in {plan.cache}; leave it out to train")
    return done


def _in_processes(missing: Sequence[Job], plan: Plan):
    """Yield jobs as they are done; every job has a fresh process. Ctrl-C ends them, and what is done stays."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(plan.processes, context, max_tasks_per_child=1)
    running: dict[Future[str], Job] = {}
    waiting = list(missing)
    try:
        while waiting or running:
            while waiting and len(running) < plan.processes:
                job = waiting.pop(0)
                running[pool.submit(jobs.run, job, plan.cache, plan.scenes_folder)] = job
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                future.result()
                yield running.pop(future)
    finally:
        for process in list((pool._processes or {}).values()):  # there is no public way to end running tasks
            if running:
                process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def oracles(plan: Plan, wanted: Sequence[Job], progress: Progress = no_progress) -> dict[str, list[dict]]:
    """The optimum's out-of-distribution curve of every scenario."""
    found: dict[str, list[dict]] = {}
    names = list(dict.fromkeys(job.scenario.name for job in wanted))
    for count, name in enumerate(names):
        job = next(job for job in wanted if job.scenario.name == name)
        found[name] = jobs.oracle_points(job, plan.cache)
        progress("oracle", count + 1, len(names), 0.0)
    return found


def provenance(plan: Plan, wanted: Sequence[Job], began: float) -> dict:
    """What made the files: command, commit, seeds, durations, versions."""
    made = [job.made(plan.cache) for job in wanted]
    return {
        "command": command(plan),
        "commit": commit(),
        "seeds": sorted({job.seed for job in wanted}),
        "test_scenes": plan.scenes,
        "jobs": len(wanted),
        "training_seconds": round(sum(m["seconds"] for m in made), 1),
        "training_cpu_seconds": round(sum(m.get("cpu_seconds") or 0 for m in made), 1),
        "testing_seconds": round(sum(m["tests"] for m in made), 1),
        "this_call_seconds": round(time.monotonic() - began, 1),
        "torch": str(torch.__version__),
        "gri-cosim": version("gri-cosim"),
    }


def commit() -> str:
    """The commit of the source tree; "unknown" outside of one, "+" where files were changed."""
    here = Path(__file__).parent
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=True)
        state = ["git", "status", "--porcelain", "--untracked-files=no", "--", ".", "../scenarios"]
        changed = subprocess.run(state, cwd=here, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return head.stdout.strip() + ("+" if changed.stdout.strip() else "")
