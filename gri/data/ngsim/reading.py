"""Reading NGSIM files as a stream of tables, so that a file need not fit into memory.

Two formats are read: the official text (18 columns separated by spaces, no header), and separated values with a header,
such as the data portal's export of all sites. Files may be plain, gzip, or zip with one member. Numbers may have
thousands separators, or decimal commas where columns are not separated by commas.
"""

import gzip
import io
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

import pandas as pd

from gri.data.ngsim.columns import LOCATION_COLUMN, OFFICIAL_COLUMNS, REQUIRED_COLUMNS, canonical_name
from gri.data.recordings.files import JUNK
from gri.data.recordings.text_tables import SEPARATORS
from gri.errors import InputError
from gri.progress import Progress, no_progress

CHUNK = 250_000
"""Rows of one table at most."""
LONGEST_LINE = 100_000  # bytes; a row of NGSIM has some 150
RATIO, SMALL = 200, 64 * 2**20  # unpacked bytes per byte of a file, and what is allowed in any case; text has 3 to 20
_FIX = "download the file again, or give one that has the official columns"


@dataclass(frozen=True)
class TextLayout:
    """Column names as in the file, whether the first line is a header, and how the text is written."""

    names: tuple[str, ...]
    header: bool
    separator: str
    """A regular expression for spaces."""
    decimal: str = "."
    encoding: str = "utf-8"


def read_chunks(path: Path, progress: Progress = no_progress) -> Iterator[pd.DataFrame]:
    """Tables of up to `CHUNK` rows with the columns `REQUIRED_COLUMNS`, and `location` if the file has it.

    Values are numbers in the file's units; a cell that is not a number becomes NaN.

    Errors: `InputError` if the file is missing, empty, truncated or damaged, or lacks a column.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give an NGSIM trajectory file (.txt, .csv, .gz or .zip)")
    size = path.stat().st_size
    try:
        with path.open("rb") as raw, _decompressed(raw, path) as stream:
            text = io.BufferedReader(_Bounded(stream, size, path), 1 << 20)
            layout = _detect_layout(text, path)
            done = 0
            for table in _tables(text, layout):
                done += len(table)
                progress(f"reading {path.name}", min(raw.tell(), size), size, float(done))
                yield table.rename(columns=canonical_name)
            if not done:
                raise InputError(f"{path}: has no rows; {_FIX}")
    except (EOFError, zlib.error, gzip.BadGzipFile, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: damaged or truncated ({error}); {_FIX}") from error
    except pd.errors.ParserError as error:
        raise InputError(f"{path}: rows of different lengths ({str(error).strip()}); {_FIX}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file ({error.reason}); {_FIX}") from error
    except InputError:
        raise
    except Exception as error:  # of the many that pandas raises for what is no table
        said = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: not a table of trajectories ({type(error).__name__}: {said}); {_FIX}") from error


class _Bounded(io.RawIOBase):
    """A stream that refuses lines and contents that no recording has, before they fill the memory."""

    def __init__(self, stream: Any, size: int, path: Path) -> None:
        self._stream, self._path = stream, path
        self._left, self._line = max(RATIO * size, SMALL), 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        part = self._stream.read(len(buffer))
        buffer[: len(part)] = part
        self._left -= len(part)
        if self._left < 0:
            raise InputError(f"{self._path}: unpacks to more than {RATIO} times its size; {_FIX}")
        end = part.rfind(b"\n")
        longest = max((len(line) for line in part.split(b"\n")[1:-1]), default=0) if len(part) > LONGEST_LINE else 0
        longest = max(longest, self._line + (len(part) if end < 0 else part.find(b"\n")))
        self._line = self._line + len(part) if end < 0 else len(part) - end - 1
        if max(longest, self._line) > LONGEST_LINE:
            raise InputError(f"{self._path}: has a line of more than {LONGEST_LINE} bytes; {_FIX}")
        return len(part)


def _tables(text: "io.BufferedReader[Any]", layout: TextLayout) -> Iterator[pd.DataFrame]:
    wanted = {name for name in layout.names if canonical_name(name) in (*REQUIRED_COLUMNS, LOCATION_COLUMN)}
    reader = pd.read_csv(
        text if layout.encoding == "utf-8" else cast(Any, io.TextIOWrapper(text, layout.encoding, newline="")),
        sep=layout.separator,
        decimal=layout.decimal,
        header=0 if layout.header else None,
        names=list(layout.names),
        usecols=lambda name: name in wanted,
        thousands="," if layout.decimal == "." else None,
        skipinitialspace=True,
        chunksize=CHUNK,
        low_memory=False,
    )
    for table in reader:
        numbers = [name for name in table.columns if canonical_name(name) != LOCATION_COLUMN]
        yield table.assign(**{name: pd.to_numeric(table[name], errors="coerce") for name in numbers})


@contextmanager
def _decompressed(raw: BinaryIO, path: Path) -> Iterator[BinaryIO]:
    """The text inside gzip or zip, which are recognised by the first bytes, not by the file's name."""
    start = raw.read(4)
    raw.seek(0)
    if not start:
        raise InputError(f"{path}: is empty; {_FIX}")
    if start[:2] == b"\x1f\x8b":
        with gzip.GzipFile(fileobj=raw) as stream:
            yield cast(BinaryIO, stream)
    elif start == b"PK\x03\x04":
        with zipfile.ZipFile(raw) as archive:
            members = [name for name in archive.namelist() if name.lower().endswith((".txt", ".csv"))]
            members = [name for name in members if not JUNK.search(name)]
            if len(members) != 1:
                names = ", ".join(members[:5]) or "none"
                raise InputError(f"{path}: got {len(members)} text files in it ({names}), wanted one; unpack it first")
            with archive.open(members[0]) as stream:
                yield cast(BinaryIO, stream)
    else:
        yield raw


def _detect_layout(text: "io.BufferedReader[Any]", path: Path) -> TextLayout:
    start = text.peek(1 << 16)
    encoding = "utf-16" if start[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8"
    lines = start.decode("utf-16" if encoding == "utf-16" else "utf-8-sig", errors="replace").split("\n", 2)
    first, second = lines[0].strip(), lines[1] if len(lines) > 2 else ""
    separator = max(SEPARATORS, key=first.count)
    cells = [cell.strip() for cell in (first.split(separator) if separator in first else first.split())]
    header = any(character.isalpha() for character in first.replace("e+", "").replace("E+", ""))
    if not header and len(cells) != len(OFFICIAL_COLUMNS):
        raise InputError(
            f"{path}: got {len(cells)} columns and no header, wanted the {len(OFFICIAL_COLUMNS)} official ones; {_FIX}"
        )
    names = tuple(cells) if header else OFFICIAL_COLUMNS
    missing = [name for name in REQUIRED_COLUMNS if name not in [canonical_name(cell) for cell in names]]
    if missing:
        raise InputError(f"{path}: column {missing[0]} is missing; {_FIX}")
    commas = separator in ";\t|" and separator in first and "," in second and "." not in second
    return TextLayout(names, header, separator if separator in first else r"\s+", "," if commas else ".", encoding)
