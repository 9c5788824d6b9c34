"""Names of columns as they are compared, and what a person says about them with `--map`."""

import re
from collections.abc import Mapping

import numpy as np
import pandas as pd

from gri.data.recordings.table import BY_NAME
from gri.errors import InputError


def plain(name: str) -> str:
    """A name in small letters without signs: `xloc-kf`, `xloc_kf` and `XLOC KF` are the same column."""
    return re.sub(r"[^a-z0-9{}<>]", "", name.lower())


def read_map(texts: list[str]) -> dict[str, str]:
    """The texts `column=name` or `column=name*factor` as a mapping. Errors: `InputError` for any other text."""
    found: dict[str, str] = {}
    for text in texts:
        column, equals, name = text.partition("=")
        column = column.strip()
        if not equals or not name.strip() or column not in BY_NAME:
            raise InputError(
                f"--map: got {text!r}, wanted COLUMN=NAME or COLUMN=NAME*FACTOR, where COLUMN is one of"
                f" {', '.join(BY_NAME)} and NAME is a column of the file"
            )
        found[column] = name.strip()
    return found


def mapped(table: pd.DataFrame, columns: Mapping[str, str], where: str) -> pd.DataFrame:
    """The table with the columns of the tidy table that `columns` names; the others stay.

    Errors: `InputError` if the table has no such column, or a factor belongs to a column of text.
    """
    found: dict[str, pd.Series] = {}
    for column, text in columns.items():
        name, factor = split_factor(text)
        if name not in table:
            known = ", ".join(map(str, table.columns[:20]))
            raise InputError(f"{where}: --map {column}={text}: got no column {name!r}, wanted one of {known}")
        values = table[name]
        if factor is not None:
            if BY_NAME[column].text or not pd.api.types.is_numeric_dtype(values):
                raise InputError(f"{where}: --map {column}={text}: got a factor for a column of text; leave it out")
            values = values.astype(np.float64) * factor
        found[column] = values
    return table.drop(columns=[name for name in found if name in table]).assign(**found)


def split_factor(text: str) -> tuple[str, float | None]:
    """`name*0.3048` as name and factor; the factor is None if there is none."""
    name, star, factor = text.rpartition("*")
    if star and re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", factor.strip()):
        return name.strip(), float(factor)
    return text, None


def drop_factor(columns: Mapping[str, str]) -> set[str]:
    """The columns of the file that `columns` names."""
    return {split_factor(text)[0] for text in columns.values()}


def read_edges(text: str | None) -> tuple[float, ...]:
    """Numbers separated by commas. Errors: `InputError` if one is no finite number."""
    try:
        found = tuple(float(part) for part in (text or "").split(",") if part.strip())
    except ValueError:
        found = (np.nan,)
    if not np.isfinite(found).all():
        raise InputError(f"--lane-edges: got {text!r}, wanted lateral positions in m such as -3.5,-7")
    return found
