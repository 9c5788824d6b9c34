"""Reading a finished run with shares of the traffic. Needs neither torch nor SUMO."""

from pathlib import Path

import pandas as pd

from cosim.runs.finished_run import verified_file
from gri.errors import InputError, guarded_reading

ALL = "all"  # the row of all vehicles
SHARE_TABLES = ("traffic", "vehicles", "space_time", "incidents", "pair_graphs")


def read_share_tables(folder: Path) -> dict[str, pd.DataFrame]:
    """The tables of a run folder with shares. Raises `InputError` where one is missing or damaged."""
    tables = {}
    for name in SHARE_TABLES:
        if not (folder / f"{name}.parquet").is_file():
            raise InputError(f"{folder}: no {name}.parquet in it; expected a run with a share, written by `cosim run`")
        path = verified_file(folder, f"{name}.parquet")
        with guarded_reading(path, "table of a run", "run the scenario again"):
            tables[name] = pd.read_parquet(path)
    return tables
