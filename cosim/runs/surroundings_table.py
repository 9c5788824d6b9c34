"""The table `surroundings`: every vehicle around each group of a run. Columns: docs/reference/run-tables.md.

It is much larger than all other tables together, so it is written by columns, without a data frame, and read by
episode.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from cosim.runs.finished_run import has_file, verified_file
from cosim.world.episode import Episode
from cosim.world.snapshot import COLUMNS
from cosim.world.surroundings import Surroundings
from gri.errors import guarded_reading

FILE = "surroundings.parquet"
EXACT = ("x", "y", "heading")  # as float64, so that contacts can be verified; all other columns of states are float32
_PAGE = 16 * 2**20  # [bytes], so that zstd finds what the groups of a round have in common
_OPTIONS: dict[str, Any] = {
    "compression": "zstd",
    "use_dictionary": ["episode", "driver", "counterpart", "time", "vehicle", "length", "width"],
    "data_page_size": _PAGE,
    "dictionary_pagesize_limit": _PAGE,
    "row_group_size": 2**22,
    "write_statistics": ["episode", "counterpart"],
}


def write_surroundings(folder: Path, driven: Sequence[Episode], counterparts: Sequence[Episode]) -> None:
    """Write the surroundings of the episodes of a run and of their counterparts, which have the same numbers."""
    tables = [
        _table(number, episode, episode.surroundings, counterpart)
        for counterpart, episodes in ((False, driven), (True, counterparts))
        for number, episode in enumerate(episodes)
        if episode.surroundings is not None
    ]
    pq.write_table(
        pa.concat_tables(tables).unify_dictionaries().combine_chunks(),
        folder / FILE,
        **_OPTIONS,
    )


def _table(number: int, episode: Episode, around: Surroundings, counterpart: bool) -> pa.Table:
    rows = len(around)
    states = {name: around.feature(name) for name in COLUMNS}
    return pa.table(
        {
            "episode": np.full(rows, number, dtype=np.int32),
            "driver": pa.repeat(episode.driver, rows).dictionary_encode(),
            "counterpart": pa.repeat(counterpart, rows),
            "time": around.time,
            "vehicle": pa.DictionaryArray.from_arrays(around.vehicle, pa.array(around.ids, pa.string())),
            **{name: x if name in EXACT else x.astype(np.float32) for name, x in states.items()},
            "length": around.length,
            "width": around.width,
        }
    )


def read_surroundings(folder: Path, episode: int | None = None, counterpart: bool | None = None) -> pd.DataFrame | None:
    """The surroundings of one episode, or of all of a run; None where the run was done without them."""
    wanted = {"episode": episode, "counterpart": counterpart}
    filters = [(name, "==", value) for name, value in wanted.items() if value is not None]
    if not has_file(folder, FILE):
        return None
    path = verified_file(folder, FILE)
    with guarded_reading(path, "table of a run", "run the scenario again"):
        return pd.read_parquet(path, filters=filters or None)
