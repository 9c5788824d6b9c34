"""I-24 MOTION (Gloudemans et al. 2023), release 1: a JSON array with one document per piece of a vehicle's trajectory.

`x_position` [ft] is the middle of the rear bumper along the road and increases eastbound; mile marker 60 is 60 · 5280
ft. `y_position` [ft] is positive on the westbound side and negative on the eastbound side. `direction` is 1 eastbound
and -1 westbound. Lanes are bands of 12 ft: lane 1 from 12 to 24 ft from the middle of the road. `timestamp` has seconds
since 1970 at about 25 Hz. The pieces are not joined. Each direction becomes a recording of its own.
"""

import json
from collections.abc import Iterator, Sequence
from io import TextIOWrapper
from typing import Any, cast

import numpy as np
import pandas as pd

from gri.data.ngsim.columns import FOOT
from gri.data.recordings.files import FIX, Member
from gri.data.recordings.parts import Part, ReadingOptions
from gri.data.recordings.text_tables import MOST_ROWS
from gri.errors import InputError

MILE = 5280.0  # [ft]
BEGIN = {1: 58.7 * MILE, -1: 62.7 * MILE}
"""Where s = 0 by direction [ft]: the ends of the testbed."""
BAND = 12.0  # [ft]
LANES = 5  # farther out are ramps and shoulders
NAMES = {1: "eastbound", -1: "westbound"}
CLASSES = {0: "car", 1: "car", 2: "van", 3: "car", 4: "truck", 5: "truck", 6: "motorcycle"}
CHUNK = 1 << 22  # characters read at once


def read(inside: Sequence[Member], options: ReadingOptions, notes: list[str]) -> Iterator[Part]:
    """One part per file and direction."""
    for member in inside:
        pieces: dict[int, list[pd.DataFrame]] = {1: [], -1: []}
        rows = 0
        for number, document in enumerate(documents(member)):
            way, piece = _piece(document, member, number)
            rows += len(piece)
            if rows > MOST_ROWS:
                raise InputError(f"{member}: has more than {MOST_ROWS:,} positions; give a part of it")
            pieces[way].append(piece)
        if not rows:
            raise InputError(f"{member}: has no trajectories, wanted an array of documents; {FIX}")
        first = min(float(piece["time_s"].iloc[0]) for way in pieces.values() for piece in way if len(piece))
        notes.append(f"{member}: times are counted from {int(first)} s since 1970")
        for way, found in pieces.items():
            if found:
                table = pd.concat(found, ignore_index=True)
                table["time_s"] = table["time_s"] - int(first)
                yield Part(table.assign(recording=NAMES[way]), f"{member}, {NAMES[way]}", "rear")


def documents(member: Member) -> Iterator[dict[str, Any]]:
    """The documents of a JSON array, or of one after the other. Memory holds one of them.

    Errors: `InputError` that names the number of the document if the file is cut short or is no array of objects.
    """
    decoder, number, is_array = json.JSONDecoder(), 0, False
    with member.open() as stream, TextIOWrapper(cast(Any, stream), encoding="utf-8-sig") as text:
        buffer, place, ended = "", 0, False
        while True:
            while place < len(buffer) and buffer[place] in " \t\r\n[,":
                is_array |= buffer[place] == "["
                place += 1
            if place < len(buffer) and buffer[place] == "]":
                return
            try:
                value, end = decoder.raw_decode(buffer, place)
            except json.JSONDecodeError as error:
                if ended and place >= len(buffer):
                    if number and not is_array:
                        return
                    raise InputError(f"{member}: document {number + 1}: the file ends there; {FIX}") from None
                if ended or len(buffer) - place > 64 * CHUNK:
                    raise InputError(
                        f"{member}: document {number + 1}: not readable as JSON ({error.msg}); {FIX}"
                    ) from None
                part = text.read(CHUNK)
                buffer, place, ended = buffer[place:] + part, 0, not part
                continue
            if not isinstance(value, dict):
                raise InputError(
                    f"{member}: document {number + 1}: got {type(value).__name__}, wanted an object with timestamp,"
                    f" x_position and y_position; {FIX}"
                )
            place, number = end, number + 1
            yield value


def _piece(document: dict[str, Any], member: Member, number: int) -> tuple[int, pd.DataFrame]:
    where = f"{member}: document {number + 1}"
    try:
        time, x, y = (np.asarray(document[k], float) for k in ("timestamp", "x_position", "y_position"))
        length, width = (float(document.get(k) or 0.0) for k in ("length", "width"))
        way = int(document["direction"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{where}: {error} is missing or no number, wanted I-24 MOTION's fields; {FIX}") from None
    if way not in BEGIN or not time.ndim == x.ndim == y.ndim == 1 or not len(time) == len(x) == len(y):
        raise InputError(
            f"{where}: got direction {way}, {time.size} times, {x.size} and {y.size} positions, wanted direction 1 or"
            f" -1, and as many positions as times; {FIX}"
        )
    from_middle = -way * y  # [ft], to the right
    lane = np.floor(from_middle / BAND)
    name = document.get("_id", number)
    s = way * (x - BEGIN[way]) * FOOT
    order = np.argsort(time, kind="stable")
    table = pd.DataFrame(
        {
            "time_s": time,
            "vehicle_id": str(name.get("$oid", name) if isinstance(name, dict) else name),
            "lane": np.where((lane >= 1) & (lane <= LANES), lane, 0.0),
            "s_m": s,
            "d_m": -from_middle * FOOT,
            "length_m": length * FOOT,
            "width_m": width * FOOT,
            "class": CLASSES.get(int(document.get("coarse_vehicle_class", -1) or 0), "unknown"),
        }
    )
    return way, table.iloc[order]
