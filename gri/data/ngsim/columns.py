"""The columns of NGSIM's trajectory files, in the order of the official text files, and their units.

Positions are those of the middle of the front bumper. `Local_X` is the distance from the left edge of the road, to the
right. `Local_Y` is the distance along the road from the entry edge. Both are in ft. Speeds are in ft/s, accelerations
in ft/s², `Global_Time` in ms (FHWA's data dictionary).
"""

import re

OFFICIAL_COLUMNS = (
    "vehicle_id", "frame_id", "total_frames", "global_time", "local_x", "local_y", "global_x", "global_y", "v_length",
    "v_width", "v_class", "v_vel", "v_acc", "lane_id", "preceding", "following", "space_headway", "time_headway",
)  # fmt: skip
REQUIRED_COLUMNS = (
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
LOCATION_COLUMN = "location"
FOOT = 0.3048
"""Length of one foot [m]."""
FRAME = 0.1
"""Time between two frames [s]."""
ACCELERATION_LIMIT = 11.2
"""The official accelerations are clipped at this value [ft/s²]."""
ALIASES = {"space_hdwy": "space_headway", "time_hdwy": "time_headway", "preceeding": "preceding"}


def canonical_name(name: str) -> str:
    """A column's name in the spelling of this module: `v_Length`, `"v_length"` and ` V_LENGTH` are the same column."""
    plain = re.sub(r"[\s\"']+", "", name).lower()
    return ALIASES.get(plain, plain)
