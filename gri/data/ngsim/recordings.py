"""One file, several recordings: rows sorted out by site and clock, kept on disk until all are read.

Vehicle and frame numbers restart with every recording period, so that the portal's file of all sites holds many
vehicles of the same number. Within a period `Global_Time − 100·Frame_ID` [ms] does not change, which tells periods
apart even where they overlap in time. Each recording is read back by itself: memory holds one, never the file.
"""

import re
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from gri.data.ngsim.columns import LOCATION, NEEDED
from gri.data.ngsim.reading import chunks
from gri.errors import InputError
from gri.progress import Progress, no_progress

RECORDINGS = 500  # more in one file: the clock is not what it should be
ROW = np.dtype(
    [
        ("vehicle", "i4"), ("frame", "i4"), ("x", "f4"), ("y", "f4"), ("length", "f4"), ("width", "f4"),
        ("kind", "i1"), ("speed", "f4"), ("acceleration", "f4"), ("lane", "i2"), ("headway", "f4"),
    ]
)  # fmt: skip
SOURCES = dict(
    zip(
        ROW.names or (),
        ("vehicle_id", "frame_id", "local_x", "local_y", "v_length", "v_width", "v_class", "v_vel", "v_acc", "lane_id",
         "space_headway"),
        strict=True,
    )
)  # fmt: skip
SITES = {r"us-?101": "us-101", r"i-?80": "i-80", "lankershim": "lankershim", "peachtree": "peachtree"}
DAYS = {12886: "i-80", 12949: "us-101", 12950: "lankershim", 13460: "peachtree"}
"""Day of the recording, counted from 1970-01-01."""


@dataclass(frozen=True)
class Recording:
    """All rows of one recording, as they stand in the file: feet, ft/s, ft/s²; `ROW` says the columns."""

    site: str
    clock: int
    """Global_Time − 100·Frame_ID [ms]."""
    rows: np.ndarray

    @property
    def name(self) -> str:
        return f"{self.site}@{self.clock}"


@dataclass
class Store:
    """Recordings of a file, sorted out on disk; `unreadable` counts rows with a cell that is no number."""

    folder: Path
    keys: dict[tuple[str, int], int] = field(default_factory=dict)
    """Rows of every (site, clock)."""
    unreadable: Counter[str] = field(default_factory=Counter)

    def __iter__(self) -> Iterator[Recording]:
        """Recordings in the order of site and clock."""
        for site, clock in sorted(self.keys):
            yield Recording(site, clock, np.fromfile(self._path((site, clock)), ROW))

    def put(self, key: tuple[str, int], rows: np.ndarray) -> None:
        self.keys[key] = self.keys.get(key, 0) + len(rows)
        with self._path(key).open("ab") as file:
            rows.tofile(file)

    def _path(self, key: tuple[str, int]) -> Path:
        return self.folder / f"{list(self.keys).index(key)}.rows"


def recordings(path: Path, site: str | None = None, progress: Progress = no_progress) -> Iterator[Recording]:
    """The recordings of a file, one after the other, rows in the order of the file; see `store_recordings`."""
    with tempfile.TemporaryDirectory(prefix="gri-ngsim-") as folder:
        yield from store_recordings(path, Path(folder), site, progress)


def store_recordings(path: Path, folder: Path, site: str | None = None, progress: Progress = no_progress) -> Store:
    """Sort a file's rows out by recording into files of that folder.

    The site stands in the column `Location`. Where there is none it is `site`, else what the file's name or the day
    says. Errors: `InputError` for a file that cannot be read, or whose clock makes no sense.
    """
    store = Store(folder)
    for table in chunks(path, progress):
        readable = table[list(NEEDED)].notna().all(axis=1)
        sites = _sites(table, path, site)
        for name, count in sites.loc[~readable].value_counts().items():
            store.unreadable[str(name)] += int(count)
        table, sites = table.loc[readable], sites.loc[readable]
        clock = (table["global_time"] - 100 * table["frame_id"]).round().astype("int64")
        for name in sites.unique():
            for time in clock[sites == name].unique():
                store.put((str(name), int(time)), _packed(table.loc[(sites == name) & (clock == time)]))
        if len(store.keys) > RECORDINGS:
            raise InputError(
                f"{path}: Global_Time - 100 x Frame_ID has more than {RECORDINGS} values, wanted one per recording; "
                "the two columns do not belong together"
            )
    if not store.keys:
        raise InputError(f"{path}: no row could be read as numbers; give a file with the official columns")
    return store


def _packed(table: pd.DataFrame) -> np.ndarray:
    rows = np.empty(len(table), ROW)
    for name, column in SOURCES.items():
        rows[name] = table[column].to_numpy()
    return rows


def _sites(table: pd.DataFrame, path: Path, site: str | None) -> pd.Series:
    if site is not None:
        return pd.Series(site, table.index)
    if LOCATION in table:
        names = table[LOCATION].fillna("unknown")
        return names.map({name: site_of(str(name)) or str(name).lower() for name in names.unique()})
    if named := site_of(path.name):
        return pd.Series(named, table.index)
    days = (table["global_time"] // 86_400_000).map(DAYS)
    return days.fillna(path.name.lower().split(".")[0])


def site_of(name: str) -> str | None:
    """The site that is meant by a `Location` cell or a file's name; None where it names none."""
    return next((site for mark, site in SITES.items() if re.search(mark, name.lower())), None)
