"""The error for bad input, which the person who gave the input can correct."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class InputError(ValueError):
    """Bad input: a file, a field or an argument.

    Commands print it as one line and exit with code 2. The message says what was given, what was expected, where, and
    how to fix it.
    """


@contextmanager
def guarded_reading(path: Path | str, what: str, fix: str) -> Iterator[None]:
    """The boundary around a reader of a foreign format: whatever it raises becomes one `InputError`.

    Libraries raise many types of errors for a file that was cut short, mistyped or made to do harm. `what` is the kind
    of file that was expected, `fix` is what to do.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        said = " ".join(str(error).split())[:120] or "no reason given"
        raise InputError(f"{path}: not a readable {what} ({type(error).__name__}: {said}); {fix}") from error


SYSTEM_ERRORS = (OSError, MemoryError, ImportError)
"""What the system refuses: files, memory, and libraries that do not fit into it."""


def refused_by_system(error: BaseException) -> str:
    """What the system refused to a command, in one line, and what helps."""
    said = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        return f"not enough memory ({said or 'none given'}); raise the limit (ulimit -v), or ask for less work"
    if isinstance(error, ImportError):
        return f"a library cannot be loaded ({said}); raise the limit of memory (ulimit -v), or install again"
    return f"the system refused a file ({said}); make room, or correct the folder: --out, or TMPDIR for temporary files"
