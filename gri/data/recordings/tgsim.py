"""TGSIM (FHWA 2024): one CSV file per site, 10 Hz, several runs told apart by `run_index`.

xloc_kf and yloc_kf are the middle of a vehicle in the reference picture, in m, y downwards from the upper left
corner. lane_kf names the lane; what its numbers mean differs between sites, so lanes are numbered by where their
vehicles drive.
type_most_common is a number: 0 pedestrian, 1 bicycle, 2 scooter, 3 car, 4 automated car, 5 motorcycle, 6 bus, 7 truck.
Some files write names with hyphens (`xloc-kf`), some have speed and acceleration by axis (`speed_kf_x`).
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from gri.data.recordings.files import Member
from gri.data.recordings.names import plain
from gri.data.recordings.parts import Part, ReadingOptions
from gri.data.recordings.text_tables import read_text
from gri.errors import InputError

NUMBERS = ("time", "xlockf", "ylockf", "lengthsmoothed", "widthsmoothed")
OPTIONAL = ("speedkf", "accelerationkf", "speedkfx", "speedkfy", "runindex")
TYPES = {0: "pedestrian", 1: "bicycle", 2: "scooter", 3: "car", 4: "car", 5: "motorcycle", 6: "bus", 7: "truck"}


def read(inside: Sequence[Member], options: ReadingOptions, notes: list[str]) -> Iterator[Part]:
    """One part per file and run."""
    for member in inside:
        rows = read_text(
            member,
            (*NUMBERS, *OPTIONAL, "typemostcommon"),
            plain,
            (*NUMBERS, *OPTIONAL, "id", "lanekf", "typemostcommon"),
        )
        if missing := [name for name in (*NUMBERS, "id") if name not in rows]:
            raise InputError(
                f"{member}: column {missing[0]} of TGSIM's trajectories is missing; download the file again"
            )
        run = rows["runindex"].fillna(0).astype(int).astype(str) if "runindex" in rows else pd.Series("", rows.index)
        table = pd.DataFrame(
            {
                "recording": run,
                "time_s": rows["time"],
                "vehicle_id": rows["id"],
                "x_m": rows["xlockf"],
                "y_m": -rows["ylockf"],
                "length_m": rows["lengthsmoothed"],
                "width_m": rows["widthsmoothed"],
                "class": rows["typemostcommon"].map(TYPES) if "typemostcommon" in rows else "unknown",
            }
        )
        if "speedkf" in rows:
            table["speed_mps"] = rows["speedkf"].abs()
        elif {"speedkfx", "speedkfy"} <= set(rows.columns):
            table["speed_mps"] = np.hypot(rows["speedkfx"], rows["speedkfy"])
        if "accelerationkf" in rows:
            table["acceleration_mps2"] = rows["accelerationkf"]
        if "lanekf" in rows:
            table["lane_label"] = rows["lanekf"].astype("string").str.replace(r"\.0$", "", regex=True)
        for name, part in table.groupby("recording", sort=True):
            label = f"{member}, run {name}" if name else str(member)
            yield Part(part, label, "centre", in_plane=True)
