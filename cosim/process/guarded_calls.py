"""Calls of code that may end or hang its process: the call is found out, and everything before it is done again.

`survive` runs a function in a copy of this process. Where a guarded call ends the copy, or takes too long, it runs the
function once more in a new copy, in which the same call raises `FatalCall` instead. So a function that handles
`FatalCall` always gets to its end, with all results from before the call.
"""

import mmap
import os
import select
import signal
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from cosim.process.failures import exit_cause
from cosim.process.fork import LIMIT, Branch, fork

T = TypeVar("T")
_LAYOUT = "<qd"  # number of calls so far, and since when [s] the last one is under way; 0 where it is over
CHECKED_EVERY = 0.1  # [s]


class FatalCall(RuntimeError):
    """This call ended or hung its process before; the message says which of both."""


@dataclass(frozen=True)
class CallGuard:
    """Counts guarded calls in memory that copies of this process share. Call `fatal` raises `FatalCall(reason)`."""

    fatal: int = 0
    reason: str = ""
    _shared: mmap.mmap = field(default_factory=lambda: mmap.mmap(-1, struct.calcsize(_LAYOUT)))

    def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """Call the function."""
        number = self.calls + 1
        if number == self.fatal:
            raise FatalCall(self.reason)
        struct.pack_into(_LAYOUT, self._shared, 0, number, time.monotonic())
        try:
            return function(*arguments)
        finally:
            struct.pack_into(_LAYOUT, self._shared, 0, number, 0.0)

    @property
    def calls(self) -> int:
        """The number of calls so far."""
        return struct.unpack_from(_LAYOUT, self._shared)[0]

    @property
    def under_way(self) -> float:
        """For how long [s] a call has been under way; 0 where there is none."""
        began = struct.unpack_from(_LAYOUT, self._shared)[1]
        return time.monotonic() - began if began else 0.0


def survive(function: Callable[[CallGuard], T], limit: float) -> T:
    """What the function returns in a copy of this process; its guarded calls may take `limit` [s] each.

    Errors: `BranchError` if the function raised, or died outside a guarded call.
    """
    guard = CallGuard()
    while True:
        branch = fork(lambda: function(guard))  # noqa: B023
        reason = _fatal_end(branch, guard, limit)
        if not reason:
            return branch.result()
        with os.fdopen(branch.pipe, "rb"):
            guard = CallGuard(guard.calls, reason)


def _fatal_end(branch: Branch[Any], guard: CallGuard, limit: float) -> str:
    """Wait until a branch begins to answer; how it ended if a guarded call ended it or was ended after the limit."""
    began = time.monotonic()
    while not select.select([branch.pipe], [], [], CHECKED_EVERY)[0]:
        if time.monotonic() - began > LIMIT:
            branch.result(0.0)  # raises
        if guard.under_way > limit:
            os.kill(branch.pid, signal.SIGKILL)
            os.waitpid(branch.pid, 0)
            return f"gave no answer within {limit:g} s"
    if not guard.under_way:
        return ""
    _, status = os.waitpid(branch.pid, 0)
    return f"ended its process ({exit_cause(os.waitstatus_to_exitcode(status))})"
