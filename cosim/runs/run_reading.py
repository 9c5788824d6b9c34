"""Reading a finished run: its tables and its JSON files. Needs neither torch nor SUMO."""

from pathlib import Path
from typing import Any

import msgspec
import pandas as pd

from gri.errors import InputError, guarded_reading

TABLES = ("steps", "groups", "counterparts", "events", "graphs")
SHARE_TABLES = ("traffic", "vehicles", "space_time", "incidents", "pair_graphs")
ALL = "all"  # the row of all vehicles in the tables of shares
NEEDED = {
    "steps": ("episode", "driver", "time", "role", "vehicle", "present", "driven", "s", "d", "v", "a"),
    "groups": ("episode", "driver", "ending", "takeover_time"),
    "counterparts": ("episode", "driver", "ending", "takeover_time"),
    "events": ("episode", "driver", "time", "kind", "vehicles", "detail"),
    "graphs": ("episode", "driver", "time", "sender", "receiver", "type", "probability"),
}
"""Columns without which nothing can be shown."""


def read_json(path: Path, kind: Any) -> Any:
    """The content of a JSON file of a run or a batch as a value of `kind`. Raises `InputError` for anything else."""
    with guarded_reading(path, "file of a run", "run it again"):
        return msgspec.json.decode(path.read_bytes(), type=kind)


def read_tables(folder: Path) -> dict[str, pd.DataFrame]:
    """The tables of a run folder; an InputError says what is missing."""
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
    tables = {}
    for name in TABLES:
        path = folder / f"{name}.parquet"
        with guarded_reading(path, "table of a run", "run the scenario again"):
            tables[name] = pd.read_parquet(path)
        if missing := [column for column in NEEDED.get(name, ()) if column not in tables[name]]:
            raise InputError(f"{path}: column {missing[0]} is missing; expected a table written by `cosim run`")
    return tables
