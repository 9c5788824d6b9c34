"""Jobs of a benchmark: a row and a seed each. A finished job is a file, so that an interrupted command continues."""

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
import pandas as pd
from torch import Tensor

from gri.errors import InputError
from gri.progress import Progress

S = TypeVar("S")


@dataclass(frozen=True)
class Row(Generic[S]):
    """A way to infer relations from scenes of type S."""

    name: str
    given: str
    """"nothing", "no labels" or "labels"."""
    prepare: Callable[[Sequence[S], Sequence[S], int], Callable[[S], Tensor]]
    """(training scenes, validation scenes, seed) → how to infer probabilities."""
    varies: bool = False
    """Whether the seed changes the answer."""


Job = tuple[Row[S], int]


def chosen_jobs(rows: Sequence[Row[S]], names: Sequence[str], seeds: int) -> list[Job[S]]:
    """Rows of these names (all without a name) and their seeds; rows that do not depend on the seed are done once."""
    known = [row.name for row in rows]
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"--row: got {unknown[0]!r}, wanted one of: {'; '.join(known)}")
    wanted = [row for row in rows if not names or row.name in names]
    return [(row, seed) for row in wanted for seed in range(seeds if row.varies else 1)]


def job_file(folder: Path, facts: tuple[Any, ...]) -> Path:
    """Where the result of a job is kept; the name changes with whatever changes the result."""
    return folder / "jobs" / f"{sha256(repr(facts).encode()).hexdigest()[:16]}.json"


def finish(
    jobs: Sequence[Job[S]],
    file: Callable[[Row[S], int], Path],
    result: Callable[[Row[S], int], list[dict[str, Any]]],
    stage: str,
    progress: Progress,
) -> pd.DataFrame:
    """Do the jobs that are not done yet, and return the table of all.

    A result is a list of `{"set": …, "kind": …, "scores": {name: {"value", "low", "high"}}}`.

    Columns: row, given, set, kind, score, value, low, high, seeds. `value` is the mean over seeds, the interval is the
    mean interval over scenes widened to the least and the greatest seed.
    """
    for done, (row, seed) in enumerate(jobs):
        progress(stage, done, len(jobs), 0.0)
        path = file(row, seed)
        if not path.is_file():
            write_whole(path, json.dumps(result(row, seed), indent=1))
    progress(stage, len(jobs), len(jobs), 0.0)
    rows = []
    for row, seed in jobs:
        for part in json.loads(file(row, seed).read_text()):
            for name, value in part["scores"].items():
                rows.append((row.name, row.given, part["set"], part["kind"], name, seed, *value.values()))
    keys = ["row", "given", "set", "kind", "score"]
    long = pd.DataFrame(rows, columns=[*keys, "seed", "value", "low", "high"])
    grouped = long.groupby(keys, sort=False)
    return grouped.agg(
        value=("value", "mean"), low=("low", "min"), high=("high", "max"), seeds=("seed", "size")
    ).reset_index()


def percent(value: float, low: float, high: float) -> str:
    """A share with its interval, in percent."""
    return "–" if np.isnan(value) else f"{100 * value:.0f} ({100 * low:.0f}–{100 * high:.0f})"


def pivot(part: pd.DataFrame, suffix: str = "") -> str:
    """A Markdown table: a line per row, a column per test set whose name ends with the suffix."""
    sets = [name for name in dict.fromkeys(part["set"]) if name.endswith(suffix)]
    cells = {
        (line["row"], line["set"]): percent(line["value"], line["low"], line["high"])
        for line in part.to_dict("records")
    }
    heads = [name.removesuffix(suffix) for name in sets]
    lines = [f"| row | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    rows = dict.fromkeys(part["row"])
    return "\n".join([*lines, *(f"| {row} | {' | '.join(cells[row, name] for name in sets)} |" for row in rows)])


def write_whole(path: Path, text: str) -> None:
    """The file appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        partial.write_text(text)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
