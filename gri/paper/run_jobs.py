"""Train and test jobs, each in a process of its own."""

import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from gri import checkpoint
from gri.data.store import Splits, scenes_of
from gri.errors import InputError
from gri.paper import recorded_car_following, recorded_lane_changes, synthetic_measurements
from gri.paper.job_cache import Job, write_json
from gri.processes import end_with_parent
from gri.storage.verification import set_aside
from gri.terminal import notice
from gri.training.train import train

JOB_LIMIT = 7 * 24 * 3600.0
"""[s] without an end of any training, after which all are ended; the longest take hours."""


def run(job: Job, cache: Path, scenes_folder: Path) -> str:
    """Train and test a job unless it is done. A model that was trained before an interruption is only tested."""
    torch.set_num_threads(1)
    if job.is_done(cache):
        return job.name
    began, folder = time.process_time(), job.folder(cache)
    model_file = folder / "model.safetensors"
    splits, measure = _prepare(job, model_file, cache, scenes_folder)
    made: dict[str, Any] = {"seconds": None, "cpu_seconds": None}
    if job.config is not None:
        if not _is_readable(model_file):
            trained = train(job.config, splits, job.seed)
            checkpoint.save(model_file, trained.model, trained.reward, trained.provenance)
        made = {name: checkpoint.provenance(model_file).get(name) for name in made}
    tests_began = time.monotonic()
    result = measure()
    made["tests"] = round(time.monotonic() - tests_began, 1)
    if job.scenario.recorded is not None:
        result["cpu_seconds"] = round(time.process_time() - began, 1)
    write_json(folder / "made.json", made | {"torch": str(torch.__version__), "gri-cosim": version("gri-cosim")})
    write_json(folder / "result.json", result)
    return job.name


def _is_readable(model_file: Path) -> bool:
    """Whether a model was trained before. A damaged file is renamed."""
    if not model_file.is_file():
        return False
    try:
        checkpoint.load(model_file)
    except InputError as error:
        notice(f"{str(error).partition(';')[0]}; it is trained again, the old file is {set_aside(model_file)}")
        return False
    return True


def _prepare(
    job: Job, model_file: Path, cache: Path, scenes_folder: Path
) -> tuple[Splits, Callable[[], dict[str, Any]]]:
    """The scenes of a job, and the function that tests the trained model."""
    recorded, file = job.scenario.recorded, job.scene_file
    if recorded is None or file is None:
        splits = scenes_of(job.training.data, scenes_folder)

        def measure_synthetic() -> dict[str, Any]:
            model, reward = checkpoint.load(model_file), checkpoint.load_reward(model_file)
            return synthetic_measurements.measure_model(job, model, reward, splits, cache)

        return splits, measure_synthetic
    if job.scenario.cross_validation is not None:
        found = recorded_lane_changes.lane_changes_of(file.path, recorded)
        blur = job.scenario.cross_validation.blur
        found = replace(found, drawn=recorded_lane_changes.blurred(found.drawn, recorded, blur, job.seed))
        return found.splits, lambda: recorded_lane_changes.cross_validate(job, found, model_file)
    splits, tested = recorded_car_following.splits_of(file.path, recorded, job.site)
    if job.config is None:
        return splits, lambda: recorded_car_following.calibrate_and_test(recorded, splits, tested)
    types = job.row.defined_types
    load = checkpoint.load
    return splits, lambda: recorded_car_following.measure_model(load(model_file), types, splits, tested)


def run_in_processes(jobs: Sequence[Job], processes: int, cache: Path, scenes_folder: Path) -> Iterator[Job]:
    """Yield each job when it is done. Every job has a new process. Ctrl-C ends the processes; finished jobs stay."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, end_with_parent, max_tasks_per_child=1)
    running: dict[Future[str], Job] = {}
    waiting = list(jobs)
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                job = waiting.pop(0)
                running[pool.submit(run, job, cache, scenes_folder)] = job
            done = wait(running, timeout=JOB_LIMIT, return_when=FIRST_COMPLETED).done
            if not done:
                names = ", ".join(job.name for job in running.values())
                raise RuntimeError(f"no training has ended for {JOB_LIMIT / 3600:g} h; waited for {names}")
            for future in done:
                future.result()
                yield running.pop(future)
    finally:
        for process in list((pool._processes or {}).values()):  # there is no public way to end running tasks
            if running:
                process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)
