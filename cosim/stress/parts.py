"""The parts of a stress test on disk: rows and effects of one policy and perturbation, and facts with their hashes.

KEY.parquet        the rows
KEY.effects.csv    the effects of the perturbations on single groups
KEY.json           facts and the hashes of both, written last: a part without it is not finished
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from gri.errors import InputError, guarded_reading
from gri.storage.verification import check_digest, digest, read_sealed, set_aside, write_sealed
from gri.storage.whole_files import whole_file

FIX = "give the same command again, which computes it once more"


def effects_path(rows: Path) -> Path:
    """The file of the effects of a part's perturbations, beside the file of its rows."""
    return rows.with_suffix(".effects.csv")


def write_part(path: Path, rows: pd.DataFrame, effects: pd.DataFrame, facts: Mapping[str, Any]) -> None:
    """Write a part; `path` is the file of its rows. The part is finished when all of it is on the disk."""
    with whole_file(effects_path(path)) as file:
        effects.to_csv(file, index=False)
    with whole_file(path) as file:
        rows.to_parquet(file, index=False)
    results = {name.name: digest(name) for name in (path, effects_path(path))}
    write_sealed(path.with_suffix(".json"), {**facts, "results": results})


def part_facts(path: Path) -> dict[str, Any]:
    """The facts of a finished part, whose files are as they were written. Errors: `DamagedError`.

    Parts of version 0.1 have no hashes.
    """
    facts = read_sealed(path.with_suffix(".json"), FIX)
    for name, wanted in facts.get("results", {}).items():
        check_digest(path.with_name(name), wanted, FIX)
    return facts


def is_finished(path: Path, warn: Callable[[str], None]) -> bool:
    """Whether a part is finished.

    A damaged one is not: it is renamed, and `warn` is called with a sentence about it.
    """
    if not path.is_file() or not path.with_suffix(".json").is_file():
        return False
    try:
        part_facts(path)
    except InputError as error:
        warn(f"{str(error).partition(';')[0]}; it is computed again, the old file is {set_aside(path)}")
        return False
    return True


def read_part(path: Path) -> tuple[pd.DataFrame, pd.DataFrame, dict[str, Any]]:
    """The rows, effects and facts of a finished part, as they were written. Errors: `DamagedError`."""
    facts = part_facts(path)
    with guarded_reading(path, "part of a stress test", FIX):
        effects = pd.read_csv(effects_path(path), keep_default_na=False, na_values=[""])
        return pd.read_parquet(path), effects, facts
