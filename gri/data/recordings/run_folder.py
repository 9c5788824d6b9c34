"""A run folder of `cosim run`: the table of all vehicles around its groups, or else the table of the groups.

Positions are those of front bumpers in the road's frame, in m. Each episode becomes a recording, and so does each
counterpart, in which SUMO drives the same vehicles. Lanes are not in the tables; they are estimated.
"""

from collections.abc import Iterator, Sequence

import pandas as pd

from gri.data.recordings.files import Member
from gri.data.recordings.parts import Part, ReadingOptions
from gri.errors import InputError

FILES = ("surroundings.parquet", "steps.parquet")
COLUMNS = ("episode", "counterpart", "time", "vehicle", "s", "d", "v", "a")


def read(inside: Sequence[Member], options: ReadingOptions, notes: list[str]) -> Iterator[Part]:
    """One part per kind of episode: driven by a policy, and left to SUMO."""
    member = next((m for name in FILES for m in inside if m.name == name), inside[0])
    with member.open_whole("table of a run", "run it again") as stream:
        table = pd.read_parquet(stream)
    if missing := [name for name in COLUMNS if name not in table]:
        raise InputError(f"{member}: column {missing[0]} is missing, wanted a table of a run; give a run folder")
    if "present" in table:
        table = table[table["present"]]
    if member.name != FILES[0]:
        notes.append(f"{member}: has the vehicles of groups only; a run with surroundings has all vehicles")
    for counterpart, rows in table.groupby("counterpart", sort=True):
        name = rows["episode"].astype(str) + ("-counterpart" if counterpart else "")
        tidy = pd.DataFrame(
            {
                "recording": name,
                "time_s": rows["time"],
                "vehicle_id": rows["vehicle"].astype(str),
                "s_m": rows["s"].astype(float),
                "d_m": rows["d"].astype(float),
                "speed_mps": rows["v"].astype(float),
                "acceleration_mps2": rows["a"].astype(float),
                "length_m": rows["length"].astype(float) if "length" in rows else 0.0,
                "width_m": rows["width"].astype(float) if "width" in rows else 0.0,
                "class": "unknown",
            }
        )
        yield Part(tidy, str(member))
