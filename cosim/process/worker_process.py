"""A function in a process of its own, so that a native crash of SUMO ends that process and not the command."""

import signal
import traceback
from collections.abc import Callable, Mapping
from importlib import import_module
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from cosim.process.own_process import print_to
from gri.errors import InputError


class WorkerError(RuntimeError):
    """The worker failed or died; the message says how and where its log is."""


class WorkerDeath(InputError):
    """The worker died before it told anything, which a broken net or route file makes SUMO do."""


def run_in_worker(
    target: str, *arguments: Any, log: Path, tell: Callable[..., None], options: Mapping[str, Any] | None = None
) -> Any:
    """Call `target(*arguments, tell, **options)` in a spawned process and return its result.

    With `options` the process is forked where the system can, so that they may hold objects that cannot be pickled,
    such as a policy defined in a notebook.

    The target is named ("module:function"), so that this process need not import torch and SUMO. What the worker and
    SUMO print goes to `log`, what the target tells goes to `tell`. InputErrors come back as they are, everything else
    as a WorkerError, or as a WorkerDeath before anything was told. The worker ends with this call, however it ends.
    """
    context = get_context("fork") if options and "fork" in get_all_start_methods() else get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(target, arguments, dict(options or {}), sender, log), daemon=False)
    process.start()
    sender.close()
    told = False
    try:
        while True:
            kind, value = receiver.recv()
            if kind == "told":
                told = True
                tell(*value)
            elif kind == "done":
                return value
            elif kind == "input":
                raise InputError(value)
            else:
                raise WorkerError(value)
    except EOFError:
        process.join()
        raise _death(process.exitcode, log, told) from None
    finally:
        process.terminate()
        process.join()
        receiver.close()


def _death(exit_code: int | None, log: Path, told: bool) -> WorkerDeath | WorkerError:
    cause = signal.Signals(-exit_code).name if exit_code and exit_code < 0 else f"exit code {exit_code}"
    if not told:
        return WorkerDeath(f"SUMO crashed ({cause}) while it read its input; the net or the routes are broken")
    return WorkerError(f"the simulation crashed ({cause}); its last words: {_tail(log)}")


def _tail(log: Path) -> str:
    lines = log.read_text(errors="replace").splitlines() if log.is_file() else []
    return "; ".join(lines[-3:]) or "(empty)"


def _work(target: str, arguments: tuple[Any, ...], options: dict[str, Any], sender: Connection, log: Path) -> None:
    """The process: everything printed goes to the log, Ctrl-C is the parent's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    print_to(log)
    try:
        module, _, function = target.partition(":")
        called = getattr(import_module(module), function)
        value = called(*arguments, lambda *message: sender.send(("told", message)), **options)
        sender.send(("done", value))
    except InputError as error:
        sender.send(("input", str(error)))
    except Exception as error:
        sender.send(("failed", f"{type(error).__name__}: {error}\n{traceback.format_exc()}"))
