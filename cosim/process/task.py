"""A piece of work for a worker process, its answer, and how a process does it; light to import."""

import traceback
from collections.abc import Callable, Generator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from cosim.process.own_process import cpu_seconds, peak_mb, print_to
from gri.errors import InputError

LOG = "sumo.log"  # in the folder of a task: what SUMO and everything else print
TASK = "its process"  # what error messages call the process of a task


@dataclass(frozen=True)
class Preparation:
    """What all tasks with the same `key` begin with: the context manager `function(*arguments)`, entered once.

    The function is named as "module:function". Each of these tasks is done in a copy of the process that entered it,
    and its function gets the value of the context manager as the keyword `prepared`. Where it cannot be entered, each
    task is done without it.
    """

    key: str
    function: str
    arguments: tuple[Any, ...]


@dataclass(frozen=True)
class Task:
    """One attempt at a piece of work: call `function(folder, *arguments)`.

    The function is named as "module:function", so that the process that asks need not import it. The folder does not
    exist yet; the worker makes it. Arguments and result must be picklable. Tasks may share a `preparation`.
    """

    name: str  # of the work, the same for every attempt
    function: str
    arguments: tuple[Any, ...]
    folder: Path
    preparation: Preparation | None = None


@dataclass(frozen=True)
class TaskResult:
    """How an attempt ended.

    `kind` is "done", or why it failed: "input" (bad input, which fails again however often it is tried), "error" (an
    exception), "died" (the process ended without an answer) or "timeout". `value` is what the function returned.
    """

    name: str
    folder: Path
    kind: Literal["done", "input", "error", "died", "timeout"]
    message: str = ""
    value: Any = None
    seconds: float = 0.0  # from the beginning to the answer
    cpu_seconds: float = 0.0  # of the process of the task and of its children
    peak_mb: float = 0.0  # resident memory of the process of the task


TaskResults = Generator[TaskResult, None, None]  # closing it ends all tasks under way


def function_named(name: str) -> Callable[..., Any]:
    """The function of a name "module:function"; imports the module."""
    module, _, function = name.partition(":")
    return getattr(import_module(module), function)


def perform(task: Task, **prepared: Any) -> TaskResult:
    """Do a task in this process, which prints into the folder of the task from now on; failures become answers.

    `prepared` is the value of its preparation, if that was entered.
    """
    try:
        task.folder.mkdir(parents=True)
        print_to(task.folder / LOG)
        value = function_named(task.function)(task.folder, *task.arguments, **prepared)
    except InputError as error:
        return TaskResult(task.name, task.folder, "input", str(error))
    except OSError as error:  # such as a full disk, which would not hold a traceback either
        return TaskResult(task.name, task.folder, "error", f"{error.strerror or error} ({type(error).__name__})")
    except Exception as error:
        traceback.print_exc()
        return TaskResult(task.name, task.folder, "error", f"{type(error).__name__}: {error}")
    return TaskResult(task.name, task.folder, "done", value=value, cpu_seconds=cpu_seconds(), peak_mb=peak_mb())
