"""Scenes from recordings of any layout, and reports on them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

from gri.data.ngsim.defects import Quality, clean
from gri.data.ngsim.extract import KINDS, Extracted, RecordingsDoor, extract
from gri.data.ngsim.recordings import Recording
from gri.data.ngsim.rules import Rules
from gri.data.recordings.files import members, sha256
from gri.data.recordings.layouts import find_layout
from gri.data.recordings.parts import ReadingOptions
from gri.data.recordings.reading import Recordings, open_recordings, tidy_table
from gri.data.recordings.table import CLASSES
from gri.errors import InputError
from gri.progress import Progress, no_progress
from gri.storage.scratch import ScratchFolder

ALL_LANES = tuple(range(1, 21))
"""Lanes of scenes from other layouts than NGSIM: all that are numbered from 1; 0 is a ramp or shoulder."""
ALL_TEST = 0
"""`Rules.block` for which every vehicle is for testing."""


@dataclass(frozen=True)
class Report:
    """What a file holds."""

    layout: str
    recordings: tuple[Quality, ...]
    classes: tuple[Counter[str], ...]
    """Number of vehicles by class, for each recording."""
    lateral: tuple[bool, ...]
    """Whether each recording has lateral positions."""
    unreadable: dict[str, int]
    """Number of rows that could not be read, by site."""
    notes: tuple[str, ...]


def inspect_file(path: Path, options: ReadingOptions, progress: Progress = no_progress) -> Report:
    """The report on a file, folder or zip archive. Errors: `InputError` as in `open_recordings`."""
    reports, classes, lateral = [], [], []
    with ScratchFolder() as folder:
        found = open_recordings(path, Path(folder), options, progress)
        for recording in found:
            reports.append(clean(recording)[1])
            classes.append(classes_in(recording))
            lateral.append(bool(np.ptp(recording.rows["x"]) > 0))
        unreadable = {site: count for site, count in found.unreadable.items() if count}
        return Report(found.layout, tuple(reports), tuple(classes), tuple(lateral), unreadable, tuple(found.notes))


def classes_in(recording: Recording) -> Counter[str]:
    """Number of vehicles of each class; the class of a vehicle is that of its first row."""
    names = {code: name for name, code in CLASSES.items()}
    _, first = np.unique(recording.rows["vehicle"], return_index=True)
    return Counter(names.get(int(code), f"code {code}") for code in recording.rows["kind"][first])


def make_scenes(
    paths: Sequence[Path],
    out: Path,
    rules: Rules,
    options: ReadingOptions,
    progress: Progress = no_progress,
) -> tuple[Extracted, list[str]]:
    """Write the scenes of the files to the scene file `out`; the second value is what a person should know.

    Scenes obey the same rules for all layouts. Errors: `InputError` as in `open_recordings`, and if no scene obeys the
    rules.
    """
    notes: list[str] = []
    layouts = sorted({find_layout(path, members(path), options)[0].name for path in paths})
    if len(layouts) > 1:
        raise InputError(f"got files of several layouts ({', '.join(layouts)}), wanted one; make a scene file of each")
    if layouts != ["ngsim"]:
        rules = msgspec.structs.replace(rules, lanes=ALL_LANES)

    def open_file(path: Path, folder: Path) -> Recordings:
        found = open_recordings(path, folder, options, progress)
        notes.extend(found.notes)
        return found

    files = [{"name": path.name, "sha256": sha256(path)} for path in paths]
    made = {
        "files": files,
        "rules": msgspec.to_builtins(rules),
        "kinds": list(KINDS),
        "layout": layouts[0],
        "options": msgspec.to_builtins(options, enc_hook=str),
    }
    door = RecordingsDoor(open_file, {"recordings": made})
    return extract(paths, out, rules, site=options.site, progress=progress, door=door), notes


def write_tidy(
    paths: Sequence[Path], out: Path, options: ReadingOptions, progress: Progress = no_progress
) -> list[str]:
    """Write recordings as one tidy table (Parquet, or text if `out` ends in .csv); returns notes and counts.

    Errors: `InputError` as in `open_recordings`.
    """
    notes, tables = [], []
    for path in paths:
        with ScratchFolder() as folder:
            found = open_recordings(path, Path(folder), options, progress)
            notes += found.notes
            tables += [tidy_table(recording) for recording in found]
    table = pd.concat(tables, ignore_index=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    if out.suffix == ".csv":
        table.to_csv(out, index=False)
    else:
        table.to_parquet(out, index=False, compression="zstd")
    return [*notes, f"{len(table):,} rows of {len(tables)} recordings in {out}"]
