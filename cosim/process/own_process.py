"""What a process does or measures about itself; light to import."""

import os
import sys
from pathlib import Path


def print_to(path: Path) -> None:
    """Append everything that this process prints from now on, SUMO included, to a file."""
    with path.open("ab") as stream:
        os.dup2(stream.fileno(), 1)
        os.dup2(stream.fileno(), 2)


def cpu_seconds() -> float:
    """CPU time [s] of this process and of its ended children."""
    return sum(os.times()[:4])


def peak_mb() -> float:
    """Peak resident memory of this process [MB]; 0 where the system does not measure it."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
