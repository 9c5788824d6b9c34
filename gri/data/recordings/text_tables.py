"""Tables of text with any separator, decimal mark and encoding, read with errors that name the line and the column."""

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from io import TextIOWrapper
from typing import Any, cast

import numpy as np
import pandas as pd

from gri.data.recordings.files import FIX, Member
from gri.errors import InputError

SAMPLE = 1 << 16  # bytes in which separator, decimal mark and encoding are looked for
LONGEST_LINE = 100_000  # bytes
MOST_ROWS = 60_000_000
SEPARATORS = (";", "\t", "|", ",")
_BOMS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


@dataclass(frozen=True)
class Dialect:
    """How a text table is written: its encoding, separator (a regular expression for spaces) and decimal mark."""

    encoding: str
    separator: str
    decimal: str
    columns: tuple[str, ...]
    """The cells of the first line."""


def dialect(member: Member) -> Dialect:
    """The dialect of a text file. Errors: `InputError` if it is empty, not text, or has a line that no table has."""
    with member.open() as stream:
        sample = stream.read(SAMPLE)
    if not sample:
        raise InputError(f"{member}: is empty; {FIX}")
    encoding = next((name for mark, name in _BOMS if sample.startswith(mark)), "")
    if not encoding:
        encoding = "utf-8" if _is_utf8(sample) else "cp1252"
    text = sample.decode(encoding, errors="replace")
    if "\0" in text:
        raise InputError(f"{member}: got bytes that are no text, wanted a table of text; {FIX}")
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines or (len(lines) == 1 and len(sample) == SAMPLE):
        raise InputError(f"{member}: has a line of more than {SAMPLE} bytes or no line at all; {FIX}")
    separator = max(SEPARATORS, key=lambda mark: lines[0].count(mark))
    if separator not in lines[0]:
        separator = r"\s+"
    cells = re.split(separator, lines[0].strip()) if separator == r"\s+" else lines[0].split(separator)
    columns = tuple(cell.strip().strip("\"'").strip() for cell in cells)
    return Dialect(encoding, separator, _decimal(member, separator, lines), columns)


def _is_utf8(sample: bytes) -> bool:
    try:
        sample[: SAMPLE - 4].decode("utf-8") if len(sample) == SAMPLE else sample.decode("utf-8")
    except UnicodeDecodeError as error:
        return len(sample) == SAMPLE and error.start > SAMPLE - 10
    return True


def _decimal(member: Member, separator: str, lines: list[str]) -> str:
    """The decimal mark. Errors: `InputError` for decimal commas between commas, which nobody can tell apart."""
    if separator != ",":
        pattern = separator if separator == r"\s+" else re.escape(separator)
        cells = [cell.strip().strip('"') for line in lines[1:50] for cell in re.split(pattern, line)]
        commas = sum(bool(re.fullmatch(r"[-+]?\d+,\d+([eE][-+]?\d+)?", cell)) for cell in cells)
        points = sum(bool(re.fullmatch(r"[-+]?\d*\.\d+([eE][-+]?\d+)?", cell)) for cell in cells)
        return "," if commas > points else "."
    names, values = lines[0].count(","), [line.count(",") for line in lines[1:50] if '"' not in line]
    if values and min(values) > names:
        raise InputError(
            f"{member}:2: got {values[0] + 1} values for {names + 1} columns, probably decimal commas between commas;"
            " save the table with semicolons between its columns"
        )
    return "."


def read_text(
    member: Member,
    numbers: Collection[str],
    canonical: Callable[[str], str] = str,
    wanted: Collection[str] | None = None,
) -> pd.DataFrame:
    """The table of a text file with a header; columns are named by `canonical`.

    `numbers` are the columns, by these names, that become float64, empty cells NaN; `wanted` are those to read (None:
    all). All other columns are text, in which "" is missing. The index counts rows from 0.

    Errors: `InputError` that names file, line and column if a cell is no number, or if the rows are no table.
    """
    found = dialect(member)
    try:
        table = _parsed(member, found, canonical, wanted)
    except InputError as error:
        if not isinstance(error.__cause__, UnicodeDecodeError):
            raise
        table = _parsed(member, replace(found, encoding="cp1252"), canonical, wanted)
    if not len(table):
        raise InputError(f"{member}: has no rows; {FIX}")
    shown = {canonical(name): name for name in found.columns}
    return table.assign(
        **{
            name: as_numbers(table[name].rename(shown.get(name, name)), member, found.decimal)
            for name in table.columns
            if name in numbers
        }
    )


def _parsed(
    member: Member, found: Dialect, canonical: Callable[[str], str], wanted: Collection[str] | None
) -> pd.DataFrame:
    names = [canonical(name) for name in found.columns]
    doubled = [name for k, name in enumerate(names) if name in names[:k] and (wanted is None or name in wanted)]
    if doubled:
        raise InputError(f"{member}:1: column {doubled[0]} is there twice; rename one of them")
    with member.open("table of text") as stream:
        try:
            table = pd.read_csv(
                cast(Any, TextIOWrapper(cast(Any, stream), encoding=found.encoding, newline="")),
                sep=found.separator,
                decimal=found.decimal,
                skipinitialspace=True,
                usecols=None if wanted is None else lambda name: canonical(str(name).strip()) in wanted,
                nrows=MOST_ROWS + 1,
                low_memory=False,
                index_col=False,
                keep_default_na=True,
            )
        except pd.errors.ParserError as error:
            said = " ".join(str(error).split())
            line = re.search(r"line (\d+)", said)
            where = f"{member}:{line.group(1)}" if line else str(member)
            raise InputError(f"{where}: rows of different lengths ({said[-80:]}); {FIX}") from None
    if len(table) > MOST_ROWS:
        raise InputError(f"{member}: has more than {MOST_ROWS:,} rows; give a part of it")
    return table.set_axis([canonical(str(name).strip()) for name in table.columns], axis=1)


def as_numbers(values: pd.Series, member: Member | str, decimal: str = ".") -> pd.Series:
    """A column as float64. Errors: `InputError` that names the line if a cell is no number."""
    if pd.api.types.is_numeric_dtype(values):
        return values.astype(float)
    text = values.astype("string").str.strip().str.strip("\"'")
    plain = text.str.replace(",", ".", regex=False) if decimal == "," else text.str.replace(",", "", regex=False)
    numbers = pd.to_numeric(plain, errors="coerce")
    blank = text.isna() | text.str.lower().isin(["", "na", "nan", "null", "none"])
    if (wrong := np.flatnonzero((numbers.isna() & ~blank).to_numpy())).size:
        line, cell = int(wrong[0]) + 2, str(text.iloc[int(wrong[0])])[:40]
        raise InputError(
            f"{member}:{line}: column {values.name}: got {cell!r}, wanted a number; correct the cell, or leave it empty"
        )
    return numbers.astype(float)
