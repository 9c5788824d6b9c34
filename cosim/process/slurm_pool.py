"""Tasks as jobs of Slurm, by submitit: the same tasks and answers as on this machine.

Every task is a job with one core. submitit keeps the jobs' scripts, pickled calls and logs in `runs/slurm`, which all
machines must see. Slurm's own variables choose the rest: SBATCH_PARTITION, SBATCH_ACCOUNT, SBATCH_MEM_PER_CPU, ….
"""

import math
import os
import time
from collections import deque
from importlib import import_module
from pathlib import Path
from typing import Any

from cosim.process.remote_task import perform_alone, unpacked
from cosim.process.task import Task, TaskResult, TaskResults
from cosim.process.task_pool import START_UP
from gri.errors import InputError

JOBS = Path("runs", "slurm")
MOST_JOBS = 100  # waiting or running at once, unless `workers` says otherwise
LOOK = 0.5  # [s] between two looks at the jobs; submitit asks Slurm less often


def run_slurm(
    queue: deque[Task], time_limit: float, *, workers: int | None = None, cluster: str = "slurm"
) -> TaskResults:
    """Do the tasks of a queue, which may grow between answers; like `run_local`, with up to `workers` jobs at once.

    `cluster` is "slurm", or "local" for processes on this machine. Errors: `InputError` where submitit is not
    installed, or Slurm is not there.
    """
    executor = _executor(cluster, time_limit)
    waiting: dict[Any, Task] = {}
    try:
        while queue or waiting:
            while queue and len(waiting) < (workers or MOST_JOBS):
                task = queue.popleft()
                waiting[executor.submit(perform_alone, task, time_limit, os.getcwd())] = task
            ended = [job for job in waiting if job.done()]
            for job in ended:
                yield _unpacked(job, waiting.pop(job))
            if not ended:
                time.sleep(LOOK)
    finally:
        for job in waiting:
            job.cancel()


def _executor(cluster: str, time_limit: float) -> Any:
    try:
        submitit = import_module("submitit")
    except ImportError:
        raise InputError("--executor slurm: submitit is not installed; install gri-cosim[slurm]") from None
    try:
        executor = submitit.AutoExecutor(folder=JOBS.resolve(), cluster=cluster)
    except RuntimeError as error:
        said = " ".join(str(error).split())[:120]
        raise InputError(f"--executor slurm: no Slurm here ({said}); give the command on a login node") from None
    minutes = math.ceil((time_limit + START_UP) / 60) + 1
    executor.update_parameters(name="cosim", timeout_min=minutes, cpus_per_task=1, tasks_per_node=1, nodes=1)
    return executor


def _unpacked(job: Any, task: Task) -> TaskResult:
    """The answer of an ended job, its files written into the folder of the task."""
    try:
        parcel = job.result()
    except Exception as error:  # whatever the job died of, and whatever submitit makes of it
        said = " ".join(str(error).split())[:300] or "no reason given"
        return TaskResult(task.name, task.folder, "died", f"job {job.job_id} gave no answer: {said}")
    return unpacked(task, parcel)
