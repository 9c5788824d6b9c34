"""Run a function in a copy of this process, its simulation included, while the original waits or goes on.

A copy made by `os.fork` shares the past with the original bit for bit and costs milliseconds. Systems without fork
simulate the past again from t = 0 instead (see `cosim.loop.closed_loop`); both give the same episodes.
"""

import os
import pickle
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, TypeVar

from cosim.process.failures import exit_cause

M = TypeVar("M")
T = TypeVar("T")

CAN_FORK = hasattr(os, "fork")


class BranchError(RuntimeError):
    """The copy raised an exception or died."""


@dataclass(frozen=True)
class Branch(Generic[T]):
    """A running copy; `result` waits for it."""

    pid: int
    pipe: int

    def result(self) -> T:
        """What the function returned in the copy. Errors: `BranchError` if it raised or the process died."""
        with os.fdopen(self.pipe, "rb") as stream:
            answer = stream.read()
        _, status = os.waitpid(self.pid, 0)
        if not answer:
            cause = exit_cause(os.waitstatus_to_exitcode(status))
            raise BranchError(f"the branched simulation died without an answer ({cause})")
        failed, value = pickle.loads(answer)
        if failed:
            raise BranchError(f"the branched simulation failed:\n{value}")
        return value


def fork_and_send(function: Callable[[M], T]) -> tuple[Branch[T], Callable[[M], None]]:
    """Fork now, and run the function in the copy once its argument is known: the second value sends it, once.

    The copy ends without an answer if this process ends before.
    """
    read, write = os.pipe()

    def wait_and_run() -> T:
        os.close(write)  # else the copy would never notice that the original is gone
        with os.fdopen(read, "rb") as stream:  # other copies may keep the pipe open, so its end is not waited for
            message = pickle.load(stream)
        return function(message)

    def send(message: M) -> None:
        with suppress(BrokenPipeError), os.fdopen(write, "wb") as stream:  # of a dead copy, `result` says why
            stream.write(pickle.dumps(message))

    branch = fork(wait_and_run)
    os.close(read)
    return branch, send


def fork(function: Callable[[], T]) -> Branch[T]:
    """Run the function in a forked copy of this process; its result must be picklable."""
    read, write = os.pipe()
    pid = plain_fork()
    if pid:
        os.close(write)
        return Branch(pid, read)
    try:
        os.close(read)
        try:
            answer = pickle.dumps((False, function()))
        except BaseException:
            answer = pickle.dumps((True, traceback.format_exc()))
        with os.fdopen(write, "wb") as stream:
            stream.write(answer)
    finally:
        os._exit(0)  # neither Python's nor SUMO's clean-up may run twice


def plain_fork() -> int:
    """`os.fork` for a process with SUMO and torch in it: 0 in the copy, which must end by `os._exit`."""
    with warnings.catch_warnings():
        # Python warns of forking beside threads; the copy runs SUMO and one-threaded torch only, and never returns.
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()
