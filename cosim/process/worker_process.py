"""One function in a process of its own, so that a native crash of SUMO ends that process and not the command."""

import signal
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import ModuleType
from typing import Any

from cosim.process.failures import exit_cause, last_lines
from cosim.process.own_process import print_to
from cosim.process.task import function_named
from gri.errors import SYSTEM_ERRORS, InputError, refused_by_system
from gri.processes import end_group, end_with_parent

SILENCE = 2 * 3600.0
"""[s] Between two reports of progress: a round of a large stress test takes minutes, on a busy machine an hour."""
GRACE = 30.0
"""[s] That a process may take to end."""


class WorkerError(RuntimeError):
    """The worker raised an exception or died; the message says why."""


class WorkerDeath(InputError):
    """The worker died before its first progress, as SUMO does on a broken net or route file."""


def run_in_worker(
    target: str,
    *arguments: Any,
    log: Path,
    tell: Callable[..., None],
    options: Mapping[str, Any] | None = None,
    silence: float = SILENCE,
) -> Any:
    """Call `target(*arguments, tell, **options)` in a spawned process and return its result.

    The worker ends with this call, however the call ends.

    Args:
        target: "module:function", so that this process need not import torch and SUMO.
        arguments: what to call it with; must be picklable.
        log: the file that takes what the worker and SUMO print.
        tell: called here with what the target reports as its progress.
        options: keyword arguments of the target. With them the process is forked where the system can fork, so they
            may hold objects that cannot be pickled, such as a policy defined in a notebook.
        silence: time [s] without any progress after which the worker is ended.

    Raises:
        InputError: as the target raised it.
        WorkerDeath: the worker died before it reported any progress.
        WorkerError: the worker failed in any other way, or reported nothing for too long.
    """
    context = get_context("fork") if options and "fork" in get_all_start_methods() else get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(target, arguments, dict(options or {}), sender, log), daemon=False)
    with nullcontext() if options else _main_module_hidden():
        process.start()
    sender.close()
    begun, last = False, "its start"
    try:
        while True:
            if not receiver.poll(silence):
                raise WorkerError(
                    f"waited {silence:g} s for progress of {target.rpartition(':')[2]} after {last}, then ended it;"
                    f" last lines of its log: {last_lines(log) or '(empty)'}"
                )
            kind, value = receiver.recv()
            if kind == "progress":
                begun, last = True, " ".join(map(str, value))
                tell(*value)
            elif kind == "done":
                return value
            elif kind == "input":
                raise InputError(value)
            else:
                raise WorkerError(value)
    except EOFError:
        process.join(GRACE)
        raise _death(process.exitcode, log, begun) from None
    finally:
        _end(process)
        receiver.close()


def _end(process: BaseProcess) -> None:
    """End a process and its copies: politely, then by force."""
    end_group(process)
    process.join(GRACE)
    if process.is_alive():
        end_group(process, signal.SIGKILL)
        process.join(GRACE)


@contextmanager
def _main_module_hidden() -> Iterator[None]:
    """Keep a spawned process from importing the caller's script again.

    By default it would, and a script without `if __name__ == "__main__":` would then start itself over. The worker
    needs nothing of the script: its target is a module of this project.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _death(exit_code: int | None, log: Path, begun: bool) -> WorkerDeath | WorkerError:
    cause = exit_cause(exit_code)
    if not begun:
        return WorkerDeath(
            f"the simulation ended ({cause}) before its first step: SUMO cannot read the net or the routes, or a policy"
            " of your own (kind: python) ends its process when it is imported or made; correct them"
        )
    return WorkerError(f"the simulation crashed ({cause}); last lines of its log: {last_lines(log) or '(empty)'}")


def _work(target: str, arguments: tuple[Any, ...], options: dict[str, Any], sender: Connection, log: Path) -> None:
    """The process: everything printed goes to the log; the parent handles Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # a forked worker has the handlers of the command
    end_with_parent(group=True)
    print_to(log)
    try:
        function = function_named(target)
        value = function(*arguments, lambda *message: sender.send(("progress", message)), **options)
        sender.send(("done", value))
    except InputError as error:
        sender.send(("input", str(error)))
    except SYSTEM_ERRORS as error:
        traceback.print_exc()
        sender.send(("failed", refused_by_system(error)))
    except Exception as error:
        sender.send(("failed", f"{type(error).__name__}: {error}\n{traceback.format_exc()}"))
