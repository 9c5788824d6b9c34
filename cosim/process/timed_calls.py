"""Calls of a user's code that are interrupted when they take too long, in this process."""

import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from cosim.process.guarded_calls import CallGuard, FatalCall

T = TypeVar("T")


@dataclass(frozen=True)
class TimedCalls(CallGuard):
    """Interrupts a call after `limit` [s] of real time by raising `FatalCall` in it.

    Only Python code can be interrupted, in the main thread, and where the system has alarms.
    """

    limit: float = 30.0

    def call(self, function: Callable[..., T], *arguments: Any) -> T:
        if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
            return function(*arguments)
        before = signal.signal(signal.SIGALRM, self._too_long)
        signal.setitimer(signal.ITIMER_REAL, self.limit)
        try:
            return function(*arguments)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)

    def _too_long(self, *_: object) -> None:
        raise FatalCall(f"gave no answer within {self.limit:g} s")
