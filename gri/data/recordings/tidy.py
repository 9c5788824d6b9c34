"""The tidy table itself, as text or Parquet, under its own names or those that `--map` gives."""

from collections.abc import Iterator, Sequence

import pandas as pd

from gri.data.recordings.files import Member
from gri.data.recordings.names import drop_factor, mapped, split_factor
from gri.data.recordings.parts import Part, ReadingOptions
from gri.data.recordings.table import BY_NAME, NUMBERS
from gri.data.recordings.text_tables import as_numbers, read_text
from gri.errors import InputError


def read(inside: Sequence[Member], options: ReadingOptions, notes: list[str]) -> Iterator[Part]:
    """One part per file."""
    for member in inside:
        table = _table(member, options)
        if options.columns:
            table = mapped(table, options.columns, str(member))
        in_plane = "s_m" not in table and {"x_m", "y_m"} <= set(table.columns)
        for name in NUMBERS:
            if name in table:
                table[name] = as_numbers(table[name], member)
        if len(inside) > 1 and "recording" not in table:
            table["recording"] = member.stem
        if ignored := [str(name) for name in table.columns if name not in BY_NAME]:
            notes.append(f"{member}: columns that are not used: {', '.join(ignored[:12])}")
        if in_plane and (missing := [name for name in ("time_s", "vehicle_id") if name not in table]):
            raise InputError(f"{member}: column {missing[0]} is missing; name it with --map {missing[0]}=COLUMN")
        yield Part(table, str(member), "front", in_plane)


def _table(member: Member, options: ReadingOptions) -> pd.DataFrame:
    with member.open() as stream:
        if stream.read(4) == b"PAR1":
            with member.open_whole("Parquet file", "write it again") as whole:
                return pd.read_parquet(whole)
    numbers = {name for name in drop_factor(options.columns) if _is_number(name, options)}
    return read_text(member, {*NUMBERS, *numbers})


def _is_number(name: str, options: ReadingOptions) -> bool:
    """Whether the file's column goes to a column of numbers."""
    return any(split_factor(text)[0] == name and not BY_NAME[column].text for column, text in options.columns.items())
