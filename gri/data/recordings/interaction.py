"""INTERACTION (Zhan et al. 2019): `vehicle_tracks_NNN.csv`, 10 Hz.

x and y are the middle of a vehicle in the plane of the map, in m; psi_rad is counter-clockwise from x. There are no
lanes in the tracks. The files of prediction tasks hold many cases of a few seconds each, told apart by `case_id`.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from gri.data.recordings.files import Member
from gri.data.recordings.names import plain
from gri.data.recordings.parts import Part, ReadingOptions
from gri.data.recordings.text_tables import read_text
from gri.errors import InputError

NUMBERS = ("timestampms", "x", "y", "vx", "vy", "psirad", "length", "width")
TEXTS = ("trackid", "agenttype")


def read(inside: Sequence[Member], options: ReadingOptions, notes: list[str]) -> Iterator[Part]:
    """One part per file of vehicles."""
    files = [m for m in inside if m.name.lower().endswith((".csv", ".txt")) and "pedestrian" not in m.name.lower()]
    for member in files or inside:
        rows = read_text(member, (*NUMBERS, "caseid"), plain, (*NUMBERS, *TEXTS, "caseid"))
        if missing := [name for name in (*NUMBERS, *TEXTS) if name not in rows]:
            raise InputError(
                f"{member}: column {missing[0]} of INTERACTION's tracks is missing; download the file again"
            )
        name = member.stem.rpartition("_")[2] if len(files) > 1 else ""
        cases = rows["caseid"].fillna(0).astype(int).astype(str) if "caseid" in rows else pd.Series("", rows.index)
        table = pd.DataFrame(
            {
                "recording": [f"{name}-{case}".strip("-") for case in cases],
                "time_s": rows["timestampms"] / 1000,
                "vehicle_id": rows["trackid"],
                "x_m": rows["x"],
                "y_m": rows["y"],
                "heading_rad": rows["psirad"],
                "speed_mps": np.hypot(rows["vx"], rows["vy"]),
                "length_m": rows["length"],
                "width_m": rows["width"],
                "class": rows["agenttype"],
            }
        )
        yield Part(table, str(member), "centre", in_plane=True)
