"""A task on another machine: done by a worker there, in a scratch folder, and its files brought back as bytes.

So the machines need no common place for results. They do need the same installation, and own nets and checkpoints at
the same paths; a run of a batch refuses to start where its key comes out differently.
"""

import os
from dataclasses import replace
from pathlib import Path

from cosim.process.task import Task, TaskResult
from cosim.process.task_pool import Worker, alive_or_new
from gri.storage.scratch import ScratchFolder

Parcel = tuple[TaskResult, dict[str, bytes]]
"""An answer and the files of the folder of its task."""

_worker: Worker | None = None  # of this process on the other machine, which does one task after the other


def perform_away(task: Task, time_limit: float, folder: str) -> Parcel:
    """Do a task on this machine for another one. `folder` is where the command was given, if it exists here."""
    global _worker
    if Path(folder).is_dir():
        os.chdir(folder)  # names of own files are relative to where the command was given
    with ScratchFolder() as scratch:
        _worker = alive_or_new(_worker)
        answer = _worker.perform(replace(task, folder=Path(scratch, "run")), time_limit)
        files = {path.name: path.read_bytes() for path in Path(scratch, "run").glob("*")}
    return replace(answer, folder=task.folder), files if answer.kind == "done" else {}


class AwayWorker:
    """A process on another machine that does one task after the other, as `perform_away`.

    Tasks with the same preparation that follow each other share it.
    """

    def perform(self, task: Task, time_limit: float, folder: str) -> Parcel:
        """Do a task."""
        return perform_away(task, time_limit, folder)


def perform_alone(task: Task, time_limit: float, folder: str) -> Parcel:
    """Like `perform_away` in a process that does this one task: a worker that waits would keep it from ending.

    What the task would share with others it does by itself.
    """
    try:
        return perform_away(replace(task, preparation=None), time_limit, folder)
    finally:
        end_worker()


def end_worker() -> None:
    """End the worker of this process, if it has one."""
    global _worker
    if _worker is not None:
        _worker.end()
    _worker = None


def unpacked(task: Task, parcel: Parcel) -> TaskResult:
    """The answer of a task, its files written into its folder here."""
    answer, files = parcel
    try:
        task.folder.mkdir(parents=True)
        for name, content in files.items():
            (task.folder / name).write_bytes(content)
    except OSError as error:
        return TaskResult(task.name, task.folder, "error", f"cannot be written here: {error.strerror}")
    return answer
