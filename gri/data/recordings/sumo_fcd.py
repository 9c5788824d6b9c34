"""SUMO's FCD output (SUMO doc: Simulation/Output/FCDOutput) as XML, CSV or Parquet.

x and y are the middle of the front bumper in the net's plane, in m; the angle is in degrees, clockwise from north. The
lane is named by the net. Lengths are not in the output: `ReadingOptions.types` names the route or additional file that
has the vehicle types. Persons and containers are passed over.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from gri.data.recordings.files import Member
from gri.data.recordings.names import plain
from gri.data.recordings.parts import Part, ReadingOptions
from gri.data.recordings.text_tables import MOST_ROWS, as_numbers, read_text
from gri.errors import InputError

NUMBERS = ("timesteptime", "vehiclex", "vehicley", "vehicleangle", "vehiclespeed", "vehicleacceleration")
TEXTS = ("vehicleid", "vehicletype", "vehiclelane")
REQUIRED = ("timesteptime", "vehicleid", "vehiclex", "vehicley")
_IN_XML = ("id", "type", "lane", "x", "y", "angle", "speed", "acceleration")
FIX = "write the output again with x and y (--fcd-output, without --fcd-output.geo)"


def read(inside: Sequence[Member], options: ReadingOptions, notes: list[str]) -> Iterator[Part]:
    """One part per file."""
    types = vehicle_types(options.types) if options.types else {}
    for member in inside:
        rows = _rows(member)
        if missing := [name for name in REQUIRED if name not in rows]:
            raise InputError(f"{member}: {missing[0].replace('vehicle', 'vehicle_')} is missing; {FIX}")
        rows = rows[rows["vehicleid"].notna()]  # steps without vehicles
        kind = rows["vehicletype"].astype("string") if "vehicletype" in rows else pd.Series("", rows.index)
        if not types:
            notes.append(f"{member}: lengths are not in FCD output; give the file with the vehicle types: --types FILE")
        table = pd.DataFrame(
            {
                "recording": member.stem if len(inside) > 1 else "",
                "time_s": rows["timesteptime"],
                "vehicle_id": rows["vehicleid"].astype(str),
                "x_m": rows["vehiclex"],
                "y_m": rows["vehicley"],
                "length_m": kind.map({name: found[0] for name, found in types.items()}),
                "width_m": kind.map({name: found[1] for name, found in types.items()}),
                "class": kind.map({name: found[2] for name, found in types.items()}) if types else kind,
            }
        )
        if "vehicleangle" in rows:
            table["heading_rad"] = np.radians(90 - rows["vehicleangle"])
        for column, name in (("speed_mps", "vehiclespeed"), ("acceleration_mps2", "vehicleacceleration")):
            if name in rows:
                table[column] = rows[name]
        if "vehiclelane" in rows and rows["vehiclelane"].notna().any():
            table["lane_label"] = rows["vehiclelane"]
        yield Part(table, str(member), "front", in_plane=True)


def _rows(member: Member) -> pd.DataFrame:
    with member.open() as stream:
        start = stream.read(4)
    if start == b"PAR1":
        with member.open_whole("Parquet file", FIX) as stream:
            table = pd.read_parquet(stream)
        table = table.set_axis([plain(str(name)) for name in table.columns], axis=1)
        return table.assign(**{name: as_numbers(table[name], member) for name in NUMBERS if name in table})
    if start.lstrip(b"\xef\xbb\xbf")[:1] == b"<":
        return _of_xml(member)
    return read_text(member, NUMBERS, plain, (*NUMBERS, *TEXTS))


def _of_xml(member: Member) -> pd.DataFrame:
    columns: dict[str, list[Any]] = {name: [] for name in ("time", *_IN_XML)}
    time = ""
    with member.open("FCD output", FIX) as stream:
        root = None
        for event, element in ElementTree.iterparse(stream, ("start", "end")):
            root = element if root is None else root
            if event == "start" and element.tag == "timestep":
                time = element.get("time", "")
            elif event == "end" and element.tag == "vehicle":
                columns["time"].append(time)
                for name in _IN_XML:
                    columns[name].append(element.get(name))
            elif event == "end" and element.tag == "timestep":
                root.clear()
            if len(columns["time"]) > MOST_ROWS:
                raise InputError(f"{member}: has more than {MOST_ROWS:,} rows; give a part of it")
    if not columns["time"]:
        raise InputError(f"{member}: got no vehicles in it, wanted an <fcd-export> with timesteps of vehicles; {FIX}")
    named = {"timesteptime" if name == "time" else f"vehicle{name}": values for name, values in columns.items()}
    table = pd.DataFrame({name: values for name, values in named.items() if any(v is not None for v in values)})
    return table.assign(**{name: as_numbers(table[name], str(member)) for name in NUMBERS if name in table})


DEFAULTS = {  # length and width [m] by SUMO's vehicle class (SUMO doc: Vehicle Type Parameter Defaults)
    "passenger": (5.0, 1.8), "truck": (7.1, 2.4), "trailer": (16.5, 2.55), "bus": (12.0, 2.5), "coach": (14.0, 2.6),
    "motorcycle": (2.2, 0.9), "delivery": (6.5, 2.16), "emergency": (6.5, 2.16), "bicycle": (1.6, 0.65),
}  # fmt: skip


def vehicle_types(path: Path) -> dict[str, tuple[float, float, str]]:
    """Length [m], width [m] and SUMO's class of each vehicle type of a route or additional file.

    Errors: `InputError` if it is not XML, or has no vehicle types.
    """
    found = {}
    fix = "give the route or additional file with the <vType> elements"
    with Member(path).open("SUMO file", fix) as stream:
        for _, element in ElementTree.iterparse(stream):
            if element.tag == "vType" and (name := element.get("id")):
                kind = element.get("vClass", "passenger")
                length, width = DEFAULTS.get(kind, DEFAULTS["passenger"])
                found[name] = (float(element.get("length", length)), float(element.get("width", width)), kind)
    if not found:
        raise InputError(
            f"{path}: got no <vType>, wanted vehicle types; give the route or additional file that has them"
        )
    return found
