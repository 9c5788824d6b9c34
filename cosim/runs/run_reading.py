"""Reading a finished run: its tables and its JSON files. Needs neither torch nor SUMO."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from cosim.runs.finished_run import read_manifest, verified_file
from gri.errors import InputError, guarded_reading

TABLES = ("steps", "groups", "counterparts", "events", "graphs")
NEEDED = {
    "steps": ("episode", "driver", "time", "role", "vehicle", "present", "driven", "counterpart", "s", "d", "v", "a"),
    "groups": ("episode", "driver", "ending", "takeover_time"),
    "counterparts": ("episode", "driver", "ending", "takeover_time"),
    "events": ("episode", "driver", "time", "kind", "vehicles", "detail"),
    "graphs": ("episode", "driver", "time", "sender", "receiver", "type", "probability"),
}
"""Columns without which nothing can be shown."""
TEXTS = ("driver", "ending", "kind", "detail", "type", "rule")
TRUTHS = ("present", "driven", "counterpart", "during_drive")


def check_columns(path: Path, table: pd.DataFrame, needed: Sequence[str]) -> None:
    """Raise `InputError` if one of these columns is missing, or has values of a kind that it never has."""
    for column in needed:
        if column not in table:
            raise InputError(f"{path}: column {column} is missing; expected a table written by `cosim run`")
        if not len(table):
            continue
        text, truth = column in TEXTS or column.startswith("vehicle"), column in TRUTHS
        kinds = "OTSU" if text else "b" if truth else "iuf"
        if table[column].dtype.kind not in kinds or (not text and table[column].isna().all()):
            wanted = "text" if text else "truth values" if truth else "numbers"
            raise InputError(
                f"{path}: column {column} has {table[column].dtype}, expected {wanted}; run the scenario again"
            )


def read_surroundings(folder: Path) -> dict[str, pd.DataFrame]:
    """The table of who was near, by its name; nothing where the run has none (`surroundings: false`)."""
    if not (folder / "surroundings.parquet").is_file():
        return {}
    path = verified_file(folder, "surroundings.parquet")
    with guarded_reading(path, "table of a run", "run the scenario again"):
        return {"surroundings": pd.read_parquet(path)}


def read_tables(folder: Path) -> dict[str, pd.DataFrame]:
    """The tables of a run folder, as they were written; an `InputError` says what is missing or damaged."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a run folder written by `cosim run`")
    if (folder / "groups.parquet").is_file() and not (folder / "counterparts.parquet").is_file():
        raise InputError(
            f"{folder}: no counterparts.parquet in it; got a run folder that an older version wrote, which mixed the"
            " counterparts into the groups; run the scenario again"
        )
    for name in TABLES:
        if not (folder / f"{name}.parquet").is_file():
            raise InputError(f"{folder}: no {name}.parquet in it; expected a run folder written by `cosim run`")
    read_manifest(folder)
    tables = {}
    for name in TABLES:
        path = verified_file(folder, f"{name}.parquet")
        with guarded_reading(path, "table of a run", "run the scenario again"):
            tables[name] = pd.read_parquet(path)
        check_columns(path, tables[name], NEEDED[name])
    return tables
