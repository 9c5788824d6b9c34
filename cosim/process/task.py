"""What is asked of a worker and what it answers; light to import."""

from collections.abc import Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from cosim.spec.scenario import Scenario

LOG = "sumo.log"  # of SUMO and of whatever else a run prints


@dataclass(frozen=True)
class Task:
    """One attempt at a run: the scenario, its labels and key, and the folder to make and write."""

    run: str
    scenario: Scenario
    labels: Mapping[str, Any]
    key: str
    folder: Path


@dataclass(frozen=True)
class Answer:
    """How an attempt ended. `kind` says why it failed; a bad input fails again however often it is tried."""

    run: str
    folder: Path
    kind: Literal["done", "input", "error", "died", "timeout"]
    message: str = ""
    seconds: float = 0.0
    peak_mb: float = 0.0  # resident memory of the process of the run


Answers = Generator[Answer, None, None]  # closing it ends whatever is under way


def last_words(folder: Path) -> str:
    """The last lines of a run's log."""
    path = folder / LOG
    lines = path.read_text(errors="replace").splitlines() if path.is_file() else []
    return "; ".join(line.strip() for line in lines[-3:] if line.strip())
