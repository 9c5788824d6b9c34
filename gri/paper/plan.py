"""The target of `gri reproduce`, and the jobs that it needs."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec

from gri.data.ngsim.extract import scene_file
from gri.data.store import scenes_of, scenes_path
from gri.errors import InputError
from gri.paper import rows
from gri.paper.job_cache import Job, SceneFile
from gri.paper.recorded_car_following import sites_of
from gri.paper.rows import Row, Scenario
from gri.paper.run_jobs import run_in_processes
from gri.progress import Progress, no_progress
from gri.training.adversarial.airl import AdversarialSettings
from gri.training.fine_tuning import FineTuning
from gri.training.grounded.constants_search import ConstantsSearch
from gri.training.grounded.recorded_traffic import RecordedSettings
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import Objective

Target = Literal["table1", "table2", "table3", "ood", "figures", "equal_terms", "constants"]
TABLES: dict[Target, tuple[str, ...]] = {
    "table1": ("table1",),
    "table3": ("table3",),
    "ood": ("ood",),
    "figures": ("table1", "table3", "ood"),
    "table2": ("table2",),
    "equal_terms": ("equal_terms",),
    "constants": (),
}
"""The tables whose rows a target needs."""


@dataclass(frozen=True)
class Plan:
    """A target, the jobs it is limited to, and the folders that are read and written."""

    target: Target
    seeds: int = 5
    test_scenes: int = 1000
    """Of synthetic scenarios."""
    out: Path = Path("runs/reproduce")
    cache: Path = Path("runs/reproduce/jobs")
    scenes_folder: Path = Path("runs/scenes")
    scenario: str | None = None
    """Only this scenario; None: all."""
    rows: tuple[str, ...] = ()
    """Only the rows of these names, and calibrated ones; empty: all."""
    quick: bool = False
    processes: int = 2
    finished: bool = False
    """Use finished jobs, train nothing."""
    ngsim: Path | None = None
    """For table2: a scene file, an NGSIM file, or a folder of NGSIM files."""


def command(plan: Plan) -> str:
    """The command that makes the same files on any machine. It names no folders of this one."""
    scenario = [f"--scenario {plan.scenario}"] if plan.scenario else []
    parts = ["gri reproduce", plan.target]
    if plan.target == "table2":
        parts += [*scenario, "--ngsim DIR", f"--seeds {plan.seeds}"]
    else:
        parts += [f"--seeds {plan.seeds}", f"--scenes {plan.test_scenes}", *scenario]
    parts += [f'--row "{name}"' for name in plan.rows]
    return " ".join([*parts, *["--quick"] * plan.quick, *["--finished"] * plan.finished])


def jobs_of(plan: Plan, file: SceneFile | None = None, sites: Sequence[str] = ()) -> list[Job]:
    """Every job that the target needs, seed by seed: an interrupted run has complete tables of the first seeds.

    Rows that transfer between several recorded sites come last, with one seed. Errors: `InputError` for an unknown
    scenario or row.
    """
    scenarios = _scenarios(plan)
    names = dict.fromkeys(row.name for scenario in scenarios for row in scenario.rows)
    unknown = [name for name in plan.rows if name not in names]
    if unknown:
        raise InputError(f"got row {unknown[0]}, wanted one of {', '.join(names)}")
    available = {(s.name, row) for s in scenarios for table in TABLES[plan.target] for row in rows.rows_of(s, table)}
    chosen = [(s, row) for s in scenarios for row in s.rows if not plan.rows or row.name in plan.rows or row.calibrated]
    wanted = [(scenario, row) for scenario, row in chosen if (scenario.name, row) in available]
    made = [(*each, seed, None) for seed in range(plan.seeds) for each in wanted if seed == 0 or not each[1].calibrated]
    if len(sites) > 1:
        transferred = [(scenario, row) for scenario, row in wanted if row.transfers and not scenario.cross_validation]
        made += [(*each, 0, site) for each in transferred for site in sites]
    return [_job(plan, *each, file) for each in made]


def _scenarios(plan: Plan) -> list[Scenario]:
    tables = set(TABLES[plan.target])
    known = {s.name: s for s in rows.SCENARIOS if any(tables & set(row.tables) for row in s.rows)}
    if plan.scenario is None:
        return list(known.values())
    if plan.scenario not in known:
        raise InputError(f"got scenario {plan.scenario} for {plan.target}, wanted one of {', '.join(known)}")
    return [known[plan.scenario]]


def _job(plan: Plan, scenario: Scenario, row: Row, seed: int, site: str | None, file: SceneFile | None) -> Job:
    config = None if row.calibrated else rows.config_of(scenario, row)
    if config is not None and scenario.recorded is None:
        config = msgspec.structs.replace(config, data=msgspec.structs.replace(config.data, test=plan.test_scenes))
    job = Job(scenario, row, config, seed, site, file)
    return quick(job) if plan.quick else job


def quick(job: Job) -> Job:
    """The same job with few scenes and updates: it shows that everything runs, its figures mean nothing."""
    headways = job.scenario.protocol.headways[::4]
    scenario = replace(job.scenario, protocol=replace(job.scenario.protocol, headways=headways, starts=20))
    if scenario.cross_validation is not None:
        scenario = replace(scenario, cross_validation=replace(scenario.cross_validation, tuning=FineTuning(updates=2)))
    if job.config is None:
        return replace(job, scenario=scenario)
    data = msgspec.structs.replace(job.config.data, train=200, validation=20, test=50, expert_updates=20)
    if data.shifted:
        shifted = msgspec.structs.replace(data.shifted, scenes=20, beyond=0)
        data = msgspec.structs.replace(data, shifted=shifted)
    changed = {"name": f"{job.config.name}-quick", "data": data, "objective": _quick_objective(job.config.objective)}
    return replace(job, scenario=scenario, config=msgspec.structs.replace(job.config, **changed))


def _quick_objective(objective: Objective) -> Objective:
    replaced = msgspec.structs.replace
    if isinstance(objective, RecordedSettings):
        grounded = replaced(objective.grounded, updates=10, encoder_lead=10)
        return replaced(objective, grounded=grounded, reward_updates=10)
    objective = replaced(objective, updates=10)
    if isinstance(objective, GroundedSettings):
        optima = objective.optima and replaced(objective.optima, scenes=50)
        search = ConstantsSearch(draws=2, screening_scenes=4, scenes=8, rounds=((1, 2),), batch=4)
        return replaced(objective, planner_updates=10, optima=optima, constants=search)
    if isinstance(objective, AdversarialSettings) and objective.start:
        optima = replaced(objective.start.plan.optima, scenes=50)
        plan = replaced(objective.start.plan, updates=10, optima=optima, imitation_updates=10)
        return replaced(objective, start=replaced(objective.start, plan=plan, encoder_updates=10))
    return objective


def make(plan: Plan, progress: Progress = no_progress) -> list[Job]:
    """Run all jobs of a plan that are not done yet. Returns all jobs, or with `finished` those that are done.

    Errors: `InputError` where nothing is finished of a plan that trains nothing.
    """
    wanted = _jobs(plan, progress)
    missing = [job for job in wanted if not job.is_done(plan.cache)]
    if plan.finished:
        done = [job for job in wanted if job not in missing]
        trained_on_all = {job.scenario.name for job in done if job.site is None}
        if not trained_on_all:
            raise InputError(f"got --finished, but nothing is finished in {plan.cache}; leave it out to train")
        return [job for job in done if job.scenario.name in trained_on_all]
    for job in missing:
        if job.scenario.recorded is None and not scenes_path(job.training.data, plan.scenes_folder).is_file():
            scenes_of(job.training.data, plan.scenes_folder, progress)
    count = len(wanted) - len(missing)
    progress("rows and seeds", count, len(wanted), 0.0)
    for job in run_in_processes(missing, plan.processes, plan.cache, plan.scenes_folder):
        count += 1
        progress("rows and seeds", count, len(wanted), job.made(plan.cache)["seconds"] or 0.0)
    return wanted


def _jobs(plan: Plan, progress: Progress) -> list[Job]:
    """The jobs of a plan. Recorded scenes are cut from the NGSIM files if they have not been before."""
    if plan.target != "table2":
        return jobs_of(plan)
    if plan.ngsim is None:
        raise InputError("table2 needs recorded data: give --ngsim FOLDER with NGSIM files, or a scene file")
    scenarios, path = _scenarios(plan), scene_file(plan.ngsim, plan.cache, progress)
    with path.open("rb") as opened:
        file = SceneFile(path, hashlib.file_digest(opened, "sha256").hexdigest()[:16])
    sites = [site for s in scenarios if s.recorded and not s.cross_validation for site in sites_of(path, s.recorded)]
    return jobs_of(plan, file, sites)
