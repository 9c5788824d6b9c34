"""A process in which what several tasks share has been prepared; each of them is done in a copy of it."""

import gc
import os
import signal
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from cosim.process.failures import exit_cause
from cosim.process.fork import BranchError, fork
from cosim.process.task import TASK, Preparation, Task, TaskResult, function_named, perform


class PreparedProcess:
    """A copy of this process that enters a preparation, and then does tasks in copies of its own, one by one.

    `pipe` becomes readable when a task has ended. The copies close the connections in `unused`.
    """

    def __init__(self, preparation: Preparation, unused: Sequence[Connection]) -> None:
        self.key = preparation.key
        self.pipe, theirs = Pipe()

        def serve() -> None:
            for connection in (self.pipe, *unused):
                connection.close()
            _serve(preparation, theirs)

        self._branch = fork(serve)
        theirs.close()

    def begin(self, task: Task) -> None:
        """Begin a task."""
        with suppress(OSError):  # the process died meanwhile; `answer` notices it
            self.pipe.send(task)

    def answer(self) -> TaskResult | None:
        """How the task ended; None where the preparation cannot be entered. Raises `EOFError` or
        `OSError` if the process died.
        """
        return self.pipe.recv()

    def end(self) -> str:
        """End the process; how it ended, if it had ended before."""
        self.pipe.close()
        os.close(self._branch.pipe)
        pid, status = os.waitpid(self._branch.pid, os.WNOHANG)
        if not pid:
            os.kill(self._branch.pid, signal.SIGKILL)
            _, status = os.waitpid(self._branch.pid, 0)
        return exit_cause(os.waitstatus_to_exitcode(status))


def _serve(preparation: Preparation, pipe: Connection) -> None:
    """The process: one task after the other until the other end of the pipe is closed."""
    try:
        with function_named(preparation.function)(*preparation.arguments) as value:
            gc.freeze()  # what there is now need not be looked through again, and copied for that, in every copy
            while True:
                task: Task = pipe.recv()
                pipe.send(_answer(task, value, pipe))
    except EOFError:
        return
    except Exception:  # a task that is done without the preparation says what is wrong
        with suppress(OSError):
            pipe.send(None)


def _answer(task: Task, value: Any, pipe: Connection) -> TaskResult:
    def in_copy() -> TaskResult:
        pipe.close()
        return perform(task, prepared=value)

    try:
        return fork(in_copy, TASK).result()
    except BranchError as error:
        return TaskResult(task.name, task.folder, "died", str(error))
