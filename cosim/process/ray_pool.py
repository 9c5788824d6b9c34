"""Tasks on a Ray cluster, or on a Ray started here: the same tasks and answers as on this machine.

Ray does the scheduling. On the machine that it chooses, a worker like those of `cosim.process.task_pool` does the task
in a process of its own (`cosim.process.remote_task`). The machines need no common file system.
"""

import os
from collections import deque
from importlib import import_module
from typing import Any

from cosim.process.remote_task import perform_away, unpacked
from cosim.process.task import Task, TaskResult, TaskResults
from cosim.process.task_pool import START_UP
from gri.errors import InputError

QUEUED = 24 * 3600.0  # [s] that a task may wait for a core of the cluster


def run_ray(
    queue: deque[Task], time_limit: float, *, workers: int | None = None, address: str | None = None
) -> TaskResults:
    """Do the tasks of a queue, which may grow between answers; like `run_local`, on as many cores as Ray has.

    `workers` limits the tasks under way at once, and the cores of a Ray that is started here. Without an address, Ray
    is started here. Errors: `InputError` where Ray is not installed.
    """
    ray = _ray()
    ray.init(address=address, num_cpus=None if address else workers, include_dashboard=False, log_to_driver=False)
    remote = ray.remote(num_cpus=1, max_retries=0)(perform_away)
    waiting: dict[Any, Task] = {}
    try:
        while queue or waiting:
            most = workers or 2 * int(ray.cluster_resources().get("CPU", 1))
            while queue and len(waiting) < most:
                task = queue.popleft()
                waiting[remote.remote(task, time_limit, os.getcwd())] = task
            limit = time_limit + START_UP + QUEUED
            ready, _ = ray.wait(list(waiting), num_returns=1, timeout=limit)
            if not ready:
                names = ", ".join(task.name for task in waiting.values())
                raise RuntimeError(
                    f"waited {limit:g} s for Ray to end one of {len(waiting)} tasks ({names[:200]}); see `ray status`"
                )
            for reference in ready:
                yield _unpacked(ray, reference, waiting.pop(reference))
    finally:
        ray.shutdown()


def _ray() -> Any:
    try:
        return import_module("ray")
    except ImportError:
        raise InputError("--executor ray: Ray is not installed; install gri-cosim[cluster]") from None


def _unpacked(ray: Any, reference: Any, task: Task) -> TaskResult:
    """The answer of an ended task, its files written into the folder of the task."""
    try:
        parcel = ray.get(reference)
    except ray.exceptions.RayError as error:
        return TaskResult(task.name, task.folder, "died", f"Ray lost the task: {str(error).strip().splitlines()[0]}")
    return unpacked(task, parcel)
