"""The columns of NGSIM's trajectory files, in the order of the official text files, and their units.

Positions are those of the middle of the front bumper. `Local_X` counts from the left edge of the road to the right,
`Local_Y` along the road from the entry edge, both in feet; speeds are in ft/s, accelerations in ft/s², `Global_Time` in
ms (FHWA's data dictionary).
"""

import re

OFFICIAL = (
    "vehicle_id", "frame_id", "total_frames", "global_time", "local_x", "local_y", "global_x", "global_y", "v_length",
    "v_width", "v_class", "v_vel", "v_acc", "lane_id", "preceding", "following", "space_headway", "time_headway",
)  # fmt: skip
NEEDED = (
    "vehicle_id",
    "frame_id",
    "global_time",
    "local_x",
    "local_y",
    "v_length",
    "v_width",
    "v_class",
    "v_vel",
    "v_acc",
    "lane_id",
    "space_headway",
)
LOCATION = "location"
FOOT = 0.3048  # [m]
FRAME = 0.1  # [s]
CLIPPED = 11.2  # [ft/s²], where the official accelerations are cut off
ALIASES = {"space_hdwy": "space_headway", "time_hdwy": "time_headway", "preceeding": "preceding"}


def normal(name: str) -> str:
    """A column's name as written here: `v_Length`, `"v_length"` and ` V_LENGTH` are the same column."""
    plain = re.sub(r"[\s\"']+", "", name).lower()
    return ALIASES.get(plain, plain)
