"""Tasks on a Ray cluster, or on a Ray started here: the same tasks and answers as on this machine.

Ray chooses the machines. On each core a process waits for tasks (an actor); a worker like those of
`cosim.process.task_pool` does them there, each in a process of its own (`cosim.process.remote_task`). Which process
gets which task is decided here, as on one machine: tasks with the same preparation go to the process that has it. The
machines need no common file system.
"""

import os
from collections import deque
from importlib import import_module
from typing import Any

from cosim.process.remote_task import AwayWorker, unpacked
from cosim.process.task import Task, TaskResult, TaskResults
from cosim.process.task_pool import START_UP, key_of, next_task
from gri.errors import InputError

LOST = "Ray lost the task"
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
    actor = ray.remote(num_cpus=1, max_restarts=0)(AwayWorker)
    crew: list[_Seat] = []
    try:
        while queue or any(seat.task for seat in crew):
            most = workers or max(int(ray.cluster_resources().get("CPU", 1)), 1)
            crew += [_Seat(actor.remote()) for _ in range(min(most - len(crew), len(queue)))]
            for seat in crew:
                if queue and seat.task is None:
                    seat.begin(
                        next_task(queue, seat.key, {other.key for other in crew if other is not seat}), time_limit
                    )
            busy = {seat.answer: seat for seat in crew if seat.task}
            limit = time_limit + START_UP + QUEUED
            ready, _ = ray.wait(list(busy), num_returns=1, timeout=limit)
            if not ready:
                names = ", ".join(seat.task.name for seat in busy.values() if seat.task)
                raise RuntimeError(
                    f"waited {limit:g} s for Ray to end one of {len(busy)} tasks ({names[:200]}); see `ray status`"
                )
            for seat in (busy[reference] for reference in ready):
                answer = _unpacked(ray, seat)
                if answer.message.startswith(LOST):  # the process on the other machine is gone
                    crew.remove(seat)
                yield answer
    finally:
        ray.shutdown()


class _Seat:
    """A process of Ray, its present task, and the `key` of what it is prepared for."""

    def __init__(self, actor: Any) -> None:
        self._actor = actor
        self.task: Task | None = None
        self.key, self.answer = "", None

    def begin(self, task: Task, time_limit: float) -> None:
        self.task, self.key = task, key_of(task)
        self.answer = self._actor.perform.remote(task, time_limit, os.getcwd())


def _ray() -> Any:
    try:
        return import_module("ray")
    except ImportError:
        raise InputError("--executor ray: Ray is not installed; install gri-cosim[cluster]") from None


def _unpacked(ray: Any, seat: _Seat) -> TaskResult:
    """The answer of an ended task, its files written into the folder of the task."""
    task, seat.task = seat.task, None
    assert task is not None
    try:
        parcel = ray.get(seat.answer)
    except ray.exceptions.RayError as error:
        return TaskResult(task.name, task.folder, "died", f"{LOST}: {str(error).strip().splitlines()[0]}")
    return unpacked(task, parcel)
