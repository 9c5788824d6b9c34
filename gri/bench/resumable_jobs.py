"""Jobs of a benchmark, such as a row and a seed. A finished job is a file, so that an interrupted command continues."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, TypeVar, TypeVarTuple

import numpy as np
import pandas as pd

from gri.errors import InputError, guarded_reading
from gri.progress import Progress
from gri.storage.verification import check_own_digest, set_aside, write_digest
from gri.storage.whole_files import write_whole
from gri.terminal import notice

S = TypeVar("S")
A = TypeVar("A")
Key = TypeVarTuple("Key")
KEYS = ["row", "given", "set", "kind", "score"]


@dataclass(frozen=True)
class Row(Generic[S, A]):
    """A way to infer relations from scenes of type S; its answer has type A."""

    name: str
    given: str
    """"nothing", "no labels" or "labels"; then its prior and its budget, where rows differ in them."""
    prepare: Callable[[Sequence[S], Sequence[S], int], Callable[[S], A]]
    """(training scenes, validation scenes, seed) → how to infer."""
    varies: bool = False
    """Whether the seed changes the answer."""
    needs: str | None = None
    """A module that is not among the requirements; without it the row is left out."""
    most: int | None = None
    """Scenes of each set that the row is scored on; None: all. For rows that are slow."""


Job = tuple[Row[S, A], int]


def left_out(rows: Sequence[Row[S, A]]) -> list[Row[S, A]]:
    """Rows that need a module which is not installed."""
    return [row for row in rows if row.needs and find_spec(row.needs) is None]


def chosen_jobs(rows: Sequence[Row[S, A]], names: Sequence[str], seeds: int) -> list[Job[S, A]]:
    """Rows of these names and their seeds; rows that do not depend on the seed are done once.

    Without a name: all rows but those that need a module which is not installed.

    Raises:
        InputError: a row that does not exist, or one that was named and needs a module which is not installed.
    """
    check_names(names, [row.name for row in rows])
    missing = left_out(rows)
    for row in missing:
        if row.name in names:
            raise InputError(f"--row {row.name!r}: {row.needs} is not installed; pip install 'gri-cosim[bench]'")
    wanted = [row for row in rows if (row.name in names if names else row not in missing)]
    return [(row, seed) for row in wanted for seed in range(seeds if row.varies else 1)]


def check_names(names: Sequence[str], known: Sequence[str]) -> None:
    """Raises `InputError` if a row does not exist."""
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"--row: got {unknown[0]!r}, wanted one of: {'; '.join(known)}")


def job_file(folder: Path, facts: tuple[Any, ...]) -> Path:
    """Where the result of a job is kept; the name changes with whatever changes the result."""
    return folder / "jobs" / f"{sha256(repr(facts).encode()).hexdigest()[:16]}.json"


def finish(
    jobs: Sequence[tuple[*Key]],
    file: Callable[[*Key], Path],
    result: Callable[[*Key], Any],
    stage: str,
    progress: Progress,
) -> list[Any]:
    """Do the jobs that are not done yet, and return the results of all, as they are read from their files."""
    found = []
    for done, job in enumerate(jobs):
        progress(stage, done, len(jobs), 0.0)
        path = file(*job)
        found.append(kept(path, partial(result, *job)))
    progress(stage, len(jobs), len(jobs), 0.0)
    return found


def kept(path: Path, compute: Callable[[], Any]) -> Any:
    """A value that JSON can hold (NaN included): read from its file, or computed and written there.

    A file that is not what was written is renamed, and computed again.
    """
    try:
        check_own_digest(path, "")
    except InputError as error:
        notice(f"{str(error).partition(';')[0]}; it is made again, the old file is {set_aside(path)}")
    if not path.is_file():
        write_whole(path, json.dumps(compute(), indent=1))
        write_digest(path)
    with guarded_reading(path, "result of a job", "remove it, then it is made again"):
        return json.loads(path.read_text())


def score_table(jobs: Sequence[Job[S, A]], results: Sequence[list[dict[str, Any]]]) -> pd.DataFrame:
    """The table of all scores.

    A result is a list of `{"set": …, "kind": …, "scores": {name: {"value", "low", "high"}}}`.

    Columns: row, given, set, kind, score, value, low, high, seeds. `value` is the mean over seeds, the interval is the
    mean interval over scenes widened to the least and the greatest seed.
    """
    rows = [
        (row.name, row.given, part["set"], part["kind"], name, seed, *value.values())
        for (row, seed), result in zip(jobs, results, strict=True)
        for part in result
        for name, value in part["scores"].items()
    ]
    long = pd.DataFrame(rows, columns=[*KEYS, "seed", "value", "low", "high"])
    grouped = long.groupby(KEYS, sort=False)
    return grouped.agg(
        value=("value", "mean"), low=("low", "min"), high=("high", "max"), seeds=("seed", "size")
    ).reset_index()


def percent(value: float, low: float, high: float) -> str:
    """A share with its interval, in percent."""
    return "–" if np.isnan(value) else f"{100 * value:.0f} ({100 * low:.0f}–{100 * high:.0f})"


def number(value: float, low: float, high: float) -> str:
    """A number with its interval."""
    return "–" if np.isnan(value) else f"{value:.2f} ({low:.2f}–{high:.2f})"


def pivot(part: pd.DataFrame, suffix: str = "", cell: Callable[[float, float, float], str] = percent) -> str:
    """A Markdown table: a line per row, a column per test set whose name ends with the suffix."""
    sets = [name for name in dict.fromkeys(part["set"]) if name.endswith(suffix)]
    cells = {
        (line["row"], line["set"]): cell(line["value"], line["low"], line["high"]) for line in part.to_dict("records")
    }
    heads = [name.removesuffix(suffix) for name in sets]
    lines = [f"| row | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    rows = dict.fromkeys(part["row"])
    return "\n".join([*lines, *(f"| {row} | {' | '.join(cells[row, name] for name in sets)} |" for row in rows)])
