"""Separating the recordings of one file by site and clock.

Vehicle and frame numbers restart with every recording period, so many vehicles in the portal's file of all sites have
the same number. Within a period the clock, `Global_Time − 100·Frame_ID` [ms], is constant. It separates the periods
even if they overlap in time. The rows of each recording go to a file of their own on disk, and are read back one
recording at a time. So memory holds one recording, not the whole file.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from gri.data.ngsim.columns import LOCATION_COLUMN, REQUIRED_COLUMNS
from gri.data.ngsim.reading import read_chunks
from gri.errors import InputError
from gri.progress import Progress, no_progress
from gri.storage.scratch import ScratchFolder

MAX_RECORDINGS = 500
"""A file with more values of the clock has an error in its columns."""
ROUNDED = 1000
"""Values of Global_Time that are all multiples of so many ms are rounded [ms]."""
MAX_CLOCKS = 20_000
"""The same for a file with a rounded clock."""
ROW_TYPE = np.dtype(
    [
        ("vehicle", "i4"), ("frame", "i4"), ("x", "f4"), ("y", "f4"), ("length", "f4"), ("width", "f4"),
        ("kind", "i1"), ("speed", "f4"), ("acceleration", "f4"), ("lane", "i2"), ("headway", "f4"),
    ]
)  # fmt: skip
COLUMN_OF_FIELD = dict(
    zip(
        ROW_TYPE.names or (),
        ("vehicle_id", "frame_id", "local_x", "local_y", "v_length", "v_width", "v_class", "v_vel", "v_acc", "lane_id",
         "space_headway"),
        strict=True,
    )
)  # fmt: skip
SITE_PATTERNS = {r"us-?101": "us-101", r"i-?80": "i-80", "lankershim": "lankershim", "peachtree": "peachtree"}
SITE_OF_DAY = {12886: "i-80", 12949: "us-101", 12950: "lankershim", 13460: "peachtree"}
"""Site that was recorded on a day [days since 1970-01-01]."""


@dataclass(frozen=True)
class Recording:
    """All rows of one recording in the file's units (ft, ft/s, ft/s²), with the fields of `ROW_TYPE`."""

    site: str
    clock: int
    """Global_Time − 100·Frame_ID [ms]."""
    rows: np.ndarray
    label: str = ""
    """Name of the recording in a file of another layout (`gri.data.recordings`)."""

    @property
    def name(self) -> str:
        """`SITE@CLOCK`, or `SITE@LABEL`."""
        return f"{self.site}@{self.label or self.clock}"


@dataclass
class RecordingStore:
    """The recordings of a file, on disk; iterate over it to read them one by one."""

    folder: Path
    row_counts: dict[tuple[str, int], int] = field(default_factory=dict)
    """Number of rows of every (site, clock)."""
    unreadable: Counter[str] = field(default_factory=Counter)
    """Number of rows of each site with a cell that is not a number; such rows are left out."""
    resolution: int = 0
    """Greatest common divisor of all values of Global_Time [ms]: 100 in official files."""

    def __iter__(self) -> Iterator[Recording]:
        """The recordings, ordered by site and clock."""
        for parts in self._recordings():
            rows = np.concatenate([np.fromfile(self._path(part), ROW_TYPE) for part in parts])
            yield Recording(*parts[0], rows)

    def __len__(self) -> int:
        return len(self._recordings())

    @property
    def is_rounded(self) -> bool:
        """Whether Global_Time is rounded to seconds or more, as spreadsheets do."""
        return self.resolution >= ROUNDED

    def _recordings(self) -> list[list[tuple[str, int]]]:
        """The clocks of each recording. One recording has one, or all that rounding spreads over, if it is rounded."""
        found: list[list[tuple[str, int]]] = []
        for site, clock in sorted(self.row_counts):
            near = found and found[-1][0][0] == site and clock - found[-1][0][1] <= self.resolution
            if self.is_rounded and near:
                found[-1].append((site, clock))
            else:
                found.append([(site, clock)])
        return found

    def append(self, key: tuple[str, int], rows: np.ndarray) -> None:
        """Append rows to the recording (site, clock)."""
        self.row_counts[key] = self.row_counts.get(key, 0) + len(rows)
        with self._path(key).open("ab") as file:
            rows.tofile(file)

    def _path(self, key: tuple[str, int]) -> Path:
        return self.folder / f"{list(self.row_counts).index(key)}.rows"


def recordings(path: Path, site: str | None = None, progress: Progress = no_progress) -> Iterator[Recording]:
    """The recordings of a file, one after the other, with their rows in the order of the file (`store_recordings`)."""
    with ScratchFolder() as folder:
        yield from store_recordings(path, Path(folder), site, progress)


def store_recordings(
    path: Path, folder: Path, site: str | None = None, progress: Progress = no_progress
) -> RecordingStore:
    """Write the rows of each recording of a file to a file in `folder`.

    The site is `site` if that is given. Else the column `Location` gives it, else the file's name, else the day of the
    recording.

    Errors: `InputError` if the file cannot be read, or its clock has more than `MAX_RECORDINGS` values.
    """
    store = RecordingStore(folder)
    for table in read_chunks(path, progress):
        readable = table[list(REQUIRED_COLUMNS)].notna().all(axis=1)
        sites = _sites(table, path, site)
        for name, count in sites.loc[~readable].value_counts().items():
            store.unreadable[str(name)] += int(count)
        table, sites = table.loc[readable], sites.loc[readable]
        times = table["global_time"].round().astype("int64").unique()
        store.resolution = int(np.gcd.reduce(np.r_[store.resolution, times]))
        clock = (table["global_time"] - 100 * table["frame_id"]).round().astype("int64")
        for name in sites.unique():
            for time in clock[sites == name].unique():
                store.append((str(name), int(time)), _as_rows(table.loc[(sites == name) & (clock == time)]))
        if len(store.row_counts) > (MAX_CLOCKS if store.is_rounded else MAX_RECORDINGS):
            raise InputError(
                f"{path}: Global_Time - 100 x Frame_ID has more than {MAX_RECORDINGS} values, wanted one per "
                "recording; give a file whose two columns belong together"
            )
    if not store.row_counts:
        raise InputError(f"{path}: no row could be read as numbers; give a file with the official columns")
    return store


def _as_rows(table: pd.DataFrame) -> np.ndarray:
    rows = np.empty(len(table), ROW_TYPE)
    for name, column in COLUMN_OF_FIELD.items():
        rows[name] = table[column].to_numpy()
    return rows


def _sites(table: pd.DataFrame, path: Path, site: str | None) -> pd.Series:
    if site is not None:
        return pd.Series(site, table.index)
    if LOCATION_COLUMN in table:
        names = table[LOCATION_COLUMN].fillna("unknown")
        return names.map({name: site_named_in(str(name)) or str(name).lower() for name in names.unique()})
    if named := site_named_in(path.name):
        return pd.Series(named, table.index)
    days = (table["global_time"] // 86_400_000).map(SITE_OF_DAY)
    return days.fillna(path.name.lower().split(".")[0])


def site_named_in(name: str) -> str | None:
    """The site that a `Location` cell or a file's name refers to; None if it refers to none."""
    return next((site for mark, site in SITE_PATTERNS.items() if re.search(mark, name.lower())), None)
