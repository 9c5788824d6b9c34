"""Run a function in a copy of this process, its simulation included, while the original waits or goes on.

A copy made by `os.fork` shares the past with the original bit for bit and costs milliseconds. Systems without fork
simulate the past again from t = 0 instead (see `cosim.loop.closed_loop`); both give the same episodes.
"""

import os
import pickle
import signal
import time
import traceback
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from io import FileIO
from select import select
from typing import Generic, TypeVar

from cosim.process.failures import exit_cause

M = TypeVar("M")
T = TypeVar("T")

LIMIT = 24 * 3600.0  # [s] that a copy may take; a whole run of a large scenario takes a few hours
PARENT_CHECKED_EVERY = 5.0  # [s]
CAN_FORK = hasattr(os, "fork")


class BranchError(RuntimeError):
    """The copy raised an exception or died."""


@dataclass(frozen=True)
class Branch(Generic[T]):
    """A running copy; `result` waits for it."""

    pid: int
    pipe: int
    name: str = "the branched simulation"
    """What error messages call it."""

    def result(self, limit: float = LIMIT) -> T:
        """What the function returned in the copy.

        Errors: `BranchError` if it raised, the process died, or has not answered after `limit` [s].
        """
        with os.fdopen(self.pipe, "rb", buffering=0) as stream:
            answer = self._answer(stream, time.monotonic() + limit, limit)
        _, status = os.waitpid(self.pid, 0)
        if not answer:
            cause = exit_cause(os.waitstatus_to_exitcode(status))
            raise BranchError(f"{self.name} died without an answer ({cause})")
        failed, value = pickle.loads(answer)
        if failed:
            raise BranchError(f"{self.name} failed:\n{value}")
        return value

    def _answer(self, stream: FileIO, deadline: float, limit: float) -> bytes:
        """All that comes until the copy closes its end of the pipe."""
        answer = bytearray()
        while select([stream], [], [], max(deadline - time.monotonic(), 0))[0]:
            part = stream.read(2**20)
            if not part:
                return bytes(answer)
            answer += part
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        raise BranchError(f"waited {limit:g} s for {self.name} (process {self.pid}), then ended it")


def fork_and_send(function: Callable[[M], T]) -> tuple[Branch[T], Callable[[M], None]]:
    """Fork now, and run the function in the copy once its argument is known: the second value sends it, once.

    The copy ends without an answer if this process ends before.
    """
    original = os.getpid()
    read, write = os.pipe()

    def wait_and_run() -> T:
        os.close(write)  # else the copy would never notice that the original is gone
        with os.fdopen(read, "rb") as stream:  # other copies may keep the pipe open, so its end is not waited for
            while not select([stream], [], [], PARENT_CHECKED_EVERY)[0]:
                if os.getppid() != original:
                    os._exit(1)
            message = pickle.load(stream)
        return function(message)

    def send(message: M) -> None:
        with suppress(BrokenPipeError), os.fdopen(write, "wb") as stream:  # of a dead copy, `result` says why
            stream.write(pickle.dumps(message))

    branch = fork(wait_and_run)
    os.close(read)
    return branch, send


def fork(function: Callable[[], T], name: str = Branch.name) -> Branch[T]:
    """Run the function in a forked copy of this process; its result must be picklable. `name` is for messages."""
    read, write = os.pipe()
    pid = plain_fork()
    if pid:
        os.close(write)
        return Branch(pid, read, name)
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
