"""The tidy table of recorded vehicles: the one form that every layout is turned into (docs/recordings.md)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from gri.errors import InputError


@dataclass(frozen=True)
class Column:
    """A column of the tidy table: its unit and meaning, and whether it must be there."""

    name: str
    unit: str
    meaning: str
    required: bool = False
    text: bool = False


COLUMNS = (
    Column(
        "recording", "", "times and vehicles are unique within a recording; default: the name of the file", text=True
    ),
    Column("time_s", "s", "time", required=True),
    Column("vehicle_id", "", "number or text", required=True, text=True),
    Column("lane", "", "1 is the leftmost, counted to the right; 0 or empty: no through lane (a ramp, a shoulder)"),
    Column("s_m", "m", "position of the front bumper along the road, increasing in the direction of travel", True),
    Column("d_m", "m", "lateral position of the middle of the front bumper, increasing to the left"),
    Column("speed_mps", "m/s", "speed; default: the derivative of the position"),
    Column("acceleration_mps2", "m/s²", "acceleration along the road"),
    Column("length_m", "m", "length; empty or 0: unknown"),
    Column("width_m", "m", "width; empty or 0: unknown"),
    Column("class", "", "class of the vehicle", text=True),
)
"""The columns of the tidy table, in their order."""
PLANE_COLUMNS = (
    Column("x_m", "m", "position in a plane, instead of s_m and d_m"),
    Column("y_m", "m", "position in a plane; the plane is seen from above, y is to the left of x"),
    Column("heading_rad", "rad", "direction of travel in the plane, counter-clockwise from x"),
    Column(
        "lane_label", "", "name of the lane in the source; lanes are numbered by their lateral positions", text=True
    ),
)
"""Columns of tables whose positions are in a plane; `gri.data.recordings.road_axis` makes tidy tables of them."""
BY_NAME = {column.name: column for column in (*COLUMNS, *PLANE_COLUMNS)}
NUMBERS = tuple(name for name, column in BY_NAME.items() if not column.text)

CLASSES: Mapping[str, int] = {"unknown": 0, "motorcycle": 1, "car": 2, "truck": 3, "bus": 4, "van": 5}
"""Codes of the classes of vehicles; 1 to 3 are those of NGSIM."""
NO_VEHICLES = "no motor vehicle"
_WORDS = {
    **dict.fromkeys(
        ("car", "passenger", "automobile", "auto", "sedan", "suv", "midsize", "pickup", "taxi", "hov"), "car"
    ),
    **dict.fromkeys(("van", "delivery", "lcv"), "van"),
    **dict.fromkeys(("truck", "trailer", "semi", "lorry", "hgv", "truck_bus", "heavy"), "truck"),
    **dict.fromkeys(("bus", "coach"), "bus"),
    **dict.fromkeys(("motorcycle", "motorbike", "moped"), "motorcycle"),
    **dict.fromkeys(
        ("pedestrian", "bicycle", "bike", "cyclist", "person", "scooter", "animal", "pedestrian/bicycle"), NO_VEHICLES
    ),
    **dict.fromkeys(("1", "1.0"), "motorcycle"),
    **dict.fromkeys(("2", "2.0"), "car"),
    **dict.fromkeys(("3", "3.0"), "truck"),
}


def class_named(word: object) -> str:
    """The class that a word of a source means: one of `CLASSES`, or `NO_VEHICLES` for those that are none.

    Numbers are NGSIM's. Words that are not known, and missing ones, are `unknown`.
    """
    return _WORDS.get(str(word).strip().lower(), "unknown")


def classes_of(words: pd.Series) -> pd.Series:
    """`class_named` for every row."""
    known = {word: class_named(word) for word in words.unique()}
    return words.map(known).fillna("unknown")


def checked(table: pd.DataFrame, where: str) -> pd.DataFrame:
    """The tidy table with all of `COLUMNS`, in their order: numbers as float64, ids and classes as text.

    What is optional and missing becomes NaN, `unknown` or `where`. `where` names the file.

    Errors: `InputError` if a required column is missing, or a number is infinite.
    """
    for column in COLUMNS:
        if column.required and column.name not in table:
            known = ", ".join(map(str, table.columns[:12]))
            raise InputError(
                f"{where}: column {column.name} is missing, got {known}; name it with --map {column.name}=COLUMN, or"
                " with a factor, --map s_m=COLUMN*0.3048"
            )
    found: dict[str, pd.Series] = {}
    for column in COLUMNS:
        values = table.get(column.name)
        if not column.text:
            found[column.name] = _numbers(values, column.name, where, table.index)
        elif values is not None:
            found[column.name] = values
    found["class"] = classes_of(found["class"]) if "class" in found else pd.Series("unknown", table.index)
    found.setdefault("recording", pd.Series("", table.index))
    return pd.DataFrame({column.name: found[column.name] for column in COLUMNS})


def _numbers(values: pd.Series | None, name: str, where: str, index: pd.Index) -> pd.Series:
    if values is None:
        return pd.Series(np.nan, index)
    numbers = values.astype(float)
    if np.isinf(numbers).any():
        raise InputError(f"{where}: column {name} has an infinite number, wanted finite ones; correct the file")
    return numbers
