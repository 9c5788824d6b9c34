"""Tasks on this machine: a few workers, each of which does every task in a process of its own.

A worker is a spawned process that imports the function of a task once. For each task it forks: the copy owns one SUMO,
writes one folder and ends. So a crash costs one task, memory cannot pile up, and torch is not imported for every task.
Where a system cannot fork, the worker does one task itself and is replaced.
"""

import os
import signal
import time
from collections import deque
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from cosim.process.failures import exit_cause, last_lines
from cosim.process.fork import CAN_FORK, Branch, BranchError, fork
from cosim.process.prepared_process import PreparedProcess
from cosim.process.task import LOG, TASK, Task, TaskResult, TaskResults, function_named, perform

GRACE = 30.0  # [s] that a killed process may take to end
START_UP = 120.0  # [s] that a worker may take to import everything


def run_local(queue: deque[Task], time_limit: float, *, workers: int) -> TaskResults:
    """Do the tasks of a queue, which may grow between answers; answers come as they are ready.

    At most `workers` tasks run at a time. A task that takes longer than `time_limit` [s] is ended. Leaving the
    iteration ends all workers.
    """
    crew: list[Worker] = []
    try:
        while queue or any(worker.task for worker in crew):
            for k in range(workers):
                if queue and (k == len(crew) or crew[k].task is None):
                    crew[k : k + 1] = [alive_or_new(crew[k] if k < len(crew) else None)]
                    others = {other.key for other in crew if other is not crew[k]}
                    crew[k].begin(next_task(queue, crew[k].key, others), time_limit)
            busy = [worker for worker in crew if worker.task]
            wait([worker.pipe for worker in busy], timeout=min(worker.time_left for worker in busy))
            for worker in busy:
                if answer := worker.answer():
                    yield answer
    finally:
        for worker in crew:
            worker.end()


def next_task(queue: deque[Task], key: str, others: Collection[str]) -> Task:
    """Take a task for a worker: one for which it is prepared (`key`), or else one for which no other worker is."""
    own = (k for k, task in enumerate(queue) if key and key_of(task) == key)
    free = (k for k, task in enumerate(queue) if not key_of(task) or key_of(task) not in others)
    k = next(own, None)
    k = next(free, 0) if k is None else k
    task = queue[k]
    del queue[k]
    return task


def key_of(task: Task) -> str:
    """The key of a task's preparation; "" where it has none."""
    return task.preparation.key if task.preparation is not None else ""


class Worker:
    """A worker process, the task that it does at present, and the `key` of what it is prepared for."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self._process: BaseProcess = context.Process(target=_serve, args=(theirs,), daemon=False)
        self._process.start()
        theirs.close()
        self.task: Task | None = None
        self.key = ""
        self._deadline = self._began = self._limit = 0.0
        self._imported: set[str] = set()

    @property
    def alive(self) -> bool:
        return self._process.is_alive() and not self.pipe.closed

    @property
    def time_left(self) -> float:
        """Time until the present task is ended [s]."""
        return max(self._deadline - time.monotonic(), 0)

    def begin(self, task: Task, time_limit: float) -> None:
        self.task, self._limit, self.key = task, time_limit, key_of(task)
        self._start_clock(0.0 if task.function in self._imported else START_UP)
        with suppress(OSError):  # the worker died meanwhile; `answer` notices that its pipe is closed
            self.pipe.send(task)

    def _start_clock(self, grace: float) -> None:
        self._began = time.monotonic()
        self._deadline = self._began + grace + self._limit

    def answer(self) -> TaskResult | None:
        """The answer to the present task; None while it is under way and its time is not up."""
        assert self.task is not None
        answer = self._received()
        if answer is None and time.monotonic() >= self._deadline:
            self.end()
            message = f"not finished after {self._limit:g} s, the time limit"
            answer = TaskResult(self.task.name, self.task.folder, "timeout", message)
        if answer is None:
            return None
        self.task = None
        # A worker whose prepared process died is about to end; another task must not be given to it.
        if not CAN_FORK or (answer.kind == "died" and self.key):
            self.end()
        lines = "" if answer.kind == "done" else last_lines(answer.folder / LOG)
        message = f"{answer.message}; last lines of its log: {lines}" if lines else answer.message
        return replace(answer, message=message, seconds=time.monotonic() - self._began)

    def perform(self, task: Task, time_limit: float) -> TaskResult:
        """Begin the task and wait for its answer."""
        self.begin(task, time_limit)
        while True:
            wait([self.pipe], timeout=self.time_left)
            if answer := self.answer():
                return answer

    def _received(self) -> TaskResult | None:
        """The answer if it has come. The worker says first (by None) that the function is imported."""
        assert self.task is not None
        try:
            while self.pipe.poll():
                if answer := self.pipe.recv():
                    return answer
                self._imported.add(self.task.function)
                self._start_clock(0.0)
        except (EOFError, OSError):
            self.end()
            cause = exit_cause(self._process.exitcode)
            return TaskResult(self.task.name, self.task.folder, "died", f"its worker died ({cause})")
        return None

    def end(self) -> None:
        """End the process and everything it started, once."""
        if self.pipe.closed:
            return
        for kill in (lambda: os.killpg(self._process.pid or 0, signal.SIGKILL), self._process.kill):
            with suppress(OSError, AttributeError):  # ended already, no group yet, or a system without groups
                kill()
        self._process.join(GRACE)  # killed: only a process that waits for a disk takes longer
        self.pipe.close()


def alive_or_new(worker: Worker | None) -> Worker:
    """The worker itself while its process is alive, else a new one."""
    if worker is not None and worker.alive:
        return worker
    if worker is not None:
        worker.end()
    return Worker()


def _serve(pipe: Connection) -> None:
    """The worker process: one task after the other until the other end of the pipe is closed."""
    if hasattr(os, "setsid"):
        os.setsid()  # the command handles Ctrl-C, and ending a worker ends its whole group
    prepared: PreparedProcess | None = None
    while True:
        try:
            task: Task = pipe.recv()
        except EOFError:
            return
        function_named(task.function)  # imported here, so that no copy has to import it again
        with suppress(OSError):  # the other end is closed; the next recv notices it, too
            pipe.send(None)
        if not CAN_FORK:
            pipe.send(perform(task))
            return
        if prepared is not None and prepared.key != key_of(task):
            prepared.end()
            prepared = None
        answer = None
        if task.preparation is not None:
            prepared = prepared or PreparedProcess(task.preparation, [pipe])
            answer = _answer_of_copy(prepared, task, pipe)
            if answer is None:  # it cannot be prepared
                prepared.end()
                prepared = None
        answer = answer or _answer_of(fork(lambda: _perform_in_copy(task, pipe), TASK), task, pipe)  # noqa: B023
        if answer is None:
            return
        with suppress(OSError):
            pipe.send(answer)


def _answer_of_copy(prepared: PreparedProcess, task: Task, pipe: Connection) -> TaskResult | None:
    """The answer of a task that is done in a copy of a prepared process; None where that cannot be prepared.

    Where that process died, or the other end of the pipe is closed, this worker ends with all that it started.
    """
    prepared.begin(task)
    try:
        if pipe not in wait([prepared.pipe, pipe]):
            return prepared.answer()
    except (EOFError, OSError):
        message = f"the process of its warm-up died ({prepared.end()})"
        with suppress(OSError):
            pipe.send(TaskResult(task.name, task.folder, "died", message))
    os.killpg(0, signal.SIGKILL)
    return None


def _perform_in_copy(task: Task, pipe: Connection) -> TaskResult:
    """Do the task in a copy of the worker. The pipe must close when the worker ends, so the copy closes its end."""
    pipe.close()
    return perform(task)


def _answer_of(branch: Branch[TaskResult], task: Task, pipe: Connection) -> TaskResult | None:
    """The answer of a running copy; None, with the copy killed, where the other end of the pipe is closed."""
    if pipe in wait([branch.pipe, pipe]):
        os.kill(branch.pid, signal.SIGKILL)
        return None
    try:
        return branch.result()
    except BranchError as error:
        return TaskResult(task.name, task.folder, "died", str(error))
