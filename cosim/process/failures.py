"""Why a process failed: what its exit code says, and the last lines of its log."""

import signal
from pathlib import Path

try:
    import resource
except ImportError:  # Windows
    resource = None


def exit_cause(exit_code: int | None) -> str:
    """The name of the signal that ended a process, such as "SIGSEGV", else its exit code in words.

    Native code that gets no memory often ends so; where memory is limited, that is said.
    """
    cause = signal.Signals(-exit_code).name if exit_code and exit_code < 0 else f"exit code {exit_code}"
    if resource is None:
        return cause
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return cause
    return f"{cause}, perhaps for want of memory: ulimit -v is {limit // 1024} KB"


def last_lines(log: Path) -> str:
    """The last three lines of a log in one line; empty where there is no log."""
    lines = log.read_text(errors="replace").splitlines() if log.is_file() else []
    return "; ".join(line.strip() for line in lines[-3:] if line.strip())
