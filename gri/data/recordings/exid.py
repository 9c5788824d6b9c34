"""exiD (Moers et al. 2022) and its siblings inD, rounD and uniD: `NN_tracks.csv` beside two files of metadata.

xCenter and yCenter are the middle of a vehicle in a plane, in m, y upwards; `heading` is in degrees, counter-clockwise
from x. Where a vehicle overlaps several lanelets, the first one of the list is its lane.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from gri.data.recordings.files import Member
from gri.data.recordings.highd import beside, recording_meta
from gri.data.recordings.names import plain
from gri.data.recordings.parts import Part, ReadingOptions
from gri.data.recordings.text_tables import read_text
from gri.errors import InputError

NUMBERS = ("trackid", "frame", "xcenter", "ycenter", "heading", "width", "length", "xvelocity", "yvelocity")
OPTIONAL = ("lonvelocity", "lonacceleration")
LANE = "laneletid"


def read(inside: Sequence[Member], options: ReadingOptions, notes: list[str]) -> Iterator[Part]:
    """One part per recording."""
    tracks = [member for member in inside if member.name.lower().endswith("_tracks.csv") or len(inside) == 1]
    if not tracks:
        raise InputError(
            f"{inside[0]}: got no file NN_tracks.csv, wanted at least one; give the folder or a file of it"
        )
    for member in tracks:
        rows = read_text(
            member, (*NUMBERS, *OPTIONAL, "recordingid"), plain, (*NUMBERS, *OPTIONAL, "recordingid", LANE)
        )
        if missing := [name for name in NUMBERS if name not in rows]:
            raise InputError(f"{member}: column {missing[0]} of exiD's tracks is missing; download the file again")
        rate, _ = recording_meta(member, notes)
        file = beside(member, "tracksMeta")
        kinds = None
        if file.exists():
            meta = read_text(file, ("trackid",), plain, ("trackid", "class")).set_index("trackid")
            kinds = rows["trackid"].map(meta["class"]) if "class" in meta else None
        table = pd.DataFrame(
            {
                "recording": rows["recordingid"].fillna(0).astype(int).astype(str)
                if "recordingid" in rows
                else member.stem,
                "time_s": rows["frame"] / rate,
                "vehicle_id": rows["trackid"],
                "x_m": rows["xcenter"],
                "y_m": rows["ycenter"],
                "heading_rad": np.radians(rows["heading"]),
                "speed_mps": rows["lonvelocity"]
                if "lonvelocity" in rows
                else np.hypot(rows["xvelocity"], rows["yvelocity"]),
                "length_m": rows["length"],
                "width_m": rows["width"],
                "class": "unknown" if kinds is None else kinds,
            }
        )
        if "lonacceleration" in rows:
            table["acceleration_mps2"] = rows["lonacceleration"]
        if LANE in rows:
            table["lane_label"] = rows[LANE].astype("string").str.partition(";")[0].str.replace(r"\.0$", "", regex=True)
        yield Part(table, str(member), "centre", in_plane=True)
