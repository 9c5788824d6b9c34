"""Runs on this machine: a few workers, each of which gives every run a process of its own.

A worker is a spawned process that has imported everything once. For each run it forks: the copy owns one SUMO, writes
one folder and ends. So a crash costs one run, memory cannot pile up, and nobody imports torch five hundred times. Where
a system cannot fork, the worker itself does one run and is replaced.
"""

import os
import signal
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from cosim.process.fork import CAN_FORK, Branch, BranchError, fork
from cosim.process.task import Answer, Answers, Task, last_words

PERFORM = "cosim.batch.run_task:perform"
START_UP = 120.0  # [s] that a worker may take to import everything


def run_local(queue: deque[Task], time_limit: float, *, workers: int, perform: str = PERFORM) -> Answers:
    """Do the tasks of a queue, which may grow between answers, on so many workers; answers come as they are ready.

    A task that takes longer than `time_limit` [s] is ended. Leaving the iteration ends all workers. `perform` names
    what is done with a task ("module:function"), so that this process need not import it.
    """
    crew: list[Worker] = []
    try:
        while queue or any(worker.task for worker in crew):
            for k in range(workers):
                if queue and (k == len(crew) or crew[k].task is None):
                    crew[k : k + 1] = [living(crew[k] if k < len(crew) else None, perform)]
                    crew[k].begin(queue.popleft(), time_limit)
            busy = [worker for worker in crew if worker.task]
            wait([worker.line for worker in busy], timeout=min(worker.patience for worker in busy))
            for worker in busy:
                if answer := worker.answer():
                    yield answer
    finally:
        for worker in crew:
            worker.end()


class Worker:
    """A worker process and what it is doing."""

    def __init__(self, perform: str) -> None:
        context = get_context("spawn")
        self.line, theirs = context.Pipe()
        self._process: BaseProcess = context.Process(target=_serve, args=(theirs, perform), daemon=False)
        self._process.start()
        theirs.close()
        self.task: Task | None = None
        self.deadline = self._began = self._limit = 0.0
        self._ready = False

    @property
    def alive(self) -> bool:
        return self._process.is_alive() and not self.line.closed

    @property
    def patience(self) -> float:
        """Seconds until the time of its task is up."""
        return max(self.deadline - time.monotonic(), 0)

    def begin(self, task: Task, time_limit: float) -> None:
        self.task, self._limit = task, time_limit
        self._start_clock(0.0 if self._ready else START_UP)
        with suppress(OSError):  # it died meanwhile; its silence will tell
            self.line.send(task)

    def _start_clock(self, grace: float) -> None:
        self._began = time.monotonic()
        self.deadline = self._began + grace + self._limit

    def answer(self) -> Answer | None:
        """The answer to the present task, if there is one by now or time is up."""
        assert self.task is not None
        answer = self._received()
        if answer is None and time.monotonic() >= self.deadline:
            self.end()
            message = f"not finished after {self._limit:g} s, the time_limit of the batch"
            answer = Answer(self.task.run, self.task.folder, "timeout", message)
        if answer is None:
            return None
        self.task = None
        if not CAN_FORK:
            self.end()
        words = "" if answer.kind == "done" else last_words(answer.folder)
        message = f"{answer.message}; last lines of its log: {words}" if words else answer.message
        return replace(answer, message=message, seconds=time.monotonic() - self._began)

    def do(self, task: Task, time_limit: float) -> Answer:
        """Begin the task and wait for its answer."""
        self.begin(task, time_limit)
        while True:
            wait([self.line], timeout=self.patience)
            if answer := self.answer():
                return answer

    def _received(self) -> Answer | None:
        assert self.task is not None
        try:
            while self.line.poll():
                if answer := self.line.recv():
                    return answer
                self._ready = True
                self._start_clock(0.0)
        except (EOFError, OSError):
            self.end()
            return Answer(
                self.task.run, self.task.folder, "died", f"its worker died ({_cause(self._process.exitcode)})"
            )
        return None

    def end(self) -> None:
        """End the process and everything it started, once."""
        if self.line.closed:
            return
        for kill in (lambda: os.killpg(self._process.pid or 0, signal.SIGKILL), self._process.kill):
            with suppress(OSError, AttributeError):  # gone already, no group yet, or a system without groups
                kill()
        self._process.join()
        self.line.close()


def living(worker: Worker | None, perform: str) -> Worker:
    """The worker itself, or a new one where it is gone."""
    if worker is not None and worker.alive:
        return worker
    if worker is not None:
        worker.end()
    return Worker(perform)


def _cause(exit_code: int | None) -> str:
    return signal.Signals(-exit_code).name if exit_code and exit_code < 0 else f"exit code {exit_code}"


def _serve(line: Connection, name: str) -> None:
    """The worker process: one task after the other until nobody asks any more."""
    if hasattr(os, "setsid"):
        os.setsid()  # Ctrl-C is the command's business, and whoever ends the worker ends the group
    module, _, function = name.partition(":")
    perform = getattr(import_module(module), function)
    with suppress(OSError):  # nobody is there to hear it; the next recv says so, too
        line.send(None)  # ready
    while True:
        try:
            task: Task = line.recv()
        except EOFError:
            return
        if not CAN_FORK:
            line.send(perform(task))
            return
        answer = _watched(fork(lambda: _alone(task, line, perform)), task, line)  # noqa: B023
        if answer is None:
            return
        with suppress(OSError):
            line.send(answer)


def _alone(task: Task, line: Connection, perform: Callable[[Task], Answer]) -> Answer:
    """The run in a copy of the worker; the line must end with the worker, so the copy lets go of it."""
    line.close()
    return perform(task)


def _watched(run: Branch[Answer], task: Task, line: Connection) -> Answer | None:
    """The answer of a running copy; None, and no copy, when nobody is there to hear it."""
    if line in wait([run.pipe, line]):
        os.kill(run.pid, signal.SIGKILL)
        return None
    try:
        return run.result()
    except BranchError as error:
        return Answer(task.run, task.folder, "died", str(error))
