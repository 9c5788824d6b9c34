"""highD (Krajewski et al. 2018): `NN_tracks.csv` beside `NN_tracksMeta.csv` and `NN_recordingMeta.csv`.

x is to the right and y downwards in the picture, in m; both are those of the upper left corner of the box of a vehicle,
whose `width` is the vehicle's length and whose `height` is its width. Vehicles of the upper carriageway drive to the
left (direction 1), those of the lower one to the right (2). Lanes are numbered from the top, the median included; the
lane markings of the recording say how many there are. Each direction becomes a recording of its own, seen in driving
direction.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from gri.data.recordings.files import Member
from gri.data.recordings.names import plain
from gri.data.recordings.parts import Part, ReadingOptions
from gri.data.recordings.text_tables import read_text
from gri.errors import InputError

NUMBERS = ("frame", "id", "x", "y", "width", "height", "xvelocity", "xacceleration", "laneid")
RATE = 25.0  # [1/s] of all published recordings


def read(inside: Sequence[Member], options: ReadingOptions, notes: list[str]) -> Iterator[Part]:
    """One part per recording and direction."""
    tracks = [member for member in inside if member.name.lower().endswith("_tracks.csv") or len(inside) == 1]
    if not tracks:
        raise InputError(
            f"{inside[0]}: got no file NN_tracks.csv, wanted at least one; give the folder or a file of it"
        )
    for member in tracks:
        rows = read_text(member, NUMBERS, plain, (*NUMBERS, "drivingdirection", "class"))
        if missing := [name for name in NUMBERS if name not in rows]:
            raise InputError(f"{member}: column {missing[0]} of highD's tracks is missing; download the file again")
        rate, upper = recording_meta(member, notes)
        rows = _with_vehicles(rows, member)
        yield from (_direction(rows, member, way, rate, upper) for way in (1, 2) if (rows["way"] == way).any())


def beside(member: Member, kind: str) -> Member:
    """The file of metadata beside a file of tracks; it need not exist."""
    return member.sibling(f"{member.stem.removesuffix('_tracks')}_{kind}.csv")


def recording_meta(member: Member, notes: list[str]) -> tuple[float, int | None]:
    """The frame rate [1/s] and the number of lanes of the upper carriageway (None: not known)."""
    file = beside(member, "recordingMeta")
    if not file.exists():
        notes.append(f"{member}: no file {file.name} beside it; {RATE:g} frames per second are assumed")
        return RATE, None
    meta = read_text(file, ("framerate",), plain)
    rate = float(meta["framerate"].iloc[0]) if "framerate" in meta else RATE
    if not 1 <= rate <= 1000:
        raise InputError(f"{file}:2: column frameRate: got {rate:g}, wanted 1 to 1000 frames per second")
    upper = meta["upperlanemarkings"].iloc[0] if "upperlanemarkings" in meta else None
    return rate, None if upper is None or pd.isna(upper) else len(str(upper).strip("; ").split(";")) - 1


def _with_vehicles(rows: pd.DataFrame, member: Member) -> pd.DataFrame:
    """The rows with `way` (1: to the left, 2: to the right) and `class`."""
    file = beside(member, "tracksMeta")
    if file.exists():
        meta = read_text(file, ("id", "drivingdirection"), plain, ("id", "drivingdirection", "class")).set_index("id")
        rows = rows.assign(**{name: rows["id"].map(meta[name]) for name in meta.columns})
    towards = np.where(rows.groupby("id")["xvelocity"].transform("mean") < 0, 1.0, 2.0)
    way = rows["drivingdirection"].fillna(pd.Series(towards, rows.index)) if "drivingdirection" in rows else towards
    return rows.assign(way=way)


def _direction(rows: pd.DataFrame, member: Member, way: int, rate: float, upper: int | None) -> Part:
    """One carriageway, in driving direction."""
    right, left_edge = rows["x"] + rows["width"], rows["x"]
    end = float(right.max())
    chosen = rows["way"] == way
    front = right if way == 2 else end - left_edge
    middle = rows["y"] + rows["height"] / 2
    sign = 1.0 if way == 2 else -1.0
    if upper is not None:
        first, last = upper + 3, upper + 1
    else:
        first, last = (float(rows.loc[chosen, "laneid"].agg(which)) for which in ("min", "max"))
    lane = rows["laneid"] - first + 1 if way == 2 else last - rows["laneid"] + 1
    table = pd.DataFrame(
        {
            "recording": f"{member.stem.removesuffix('_tracks')}-{way}",
            "time_s": rows["frame"] / rate,
            "vehicle_id": rows["id"],
            "lane": lane.clip(lower=0),
            "s_m": front,
            "d_m": -sign * middle,
            "speed_mps": sign * rows["xvelocity"],
            "acceleration_mps2": sign * rows["xacceleration"],
            "length_m": rows["width"],
            "width_m": rows["height"],
            "class": rows.get("class", "unknown"),
        }
    )
    return Part(table[chosen], str(member))
