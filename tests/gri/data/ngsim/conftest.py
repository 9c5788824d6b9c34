"""Generated traffic in the layout of the official files: no recorded data."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

COLUMNS = [
    "Vehicle_ID", "Frame_ID", "Total_Frames", "Global_Time", "Local_X", "Local_Y", "Global_X", "Global_Y", "v_Length",
    "v_Width", "v_Class", "v_Vel", "v_Acc", "Lane_ID", "Preceding", "Following", "Space_Headway", "Time_Headway",
]  # fmt: skip
CLOCK = 1118846980200  # US-101's day [ms]
FOOT = 0.3048


def platoon(
    vehicles: int = 3, frames: int = 80, first_id: int = 1, lane: int = 2, clock: int = CLOCK, speed: float = 30.0
) -> pd.DataFrame:
    """Vehicles 60 ft apart in one lane at a constant speed [ft/s], the highest number in front."""
    parts = []
    for k in range(vehicles):
        frame = np.arange(1, frames + 1)
        part = pd.DataFrame(0.0, index=frame, columns=COLUMNS)
        part["Vehicle_ID"], part["Frame_ID"], part["Total_Frames"] = first_id + k, frame, frames
        part["Global_Time"] = clock + 100 * frame
        part["Local_X"], part["Local_Y"] = 6.0 + 12 * (lane - 1), 50.0 + 60 * k + speed * 0.1 * frame
        part["v_Length"], part["v_Width"], part["v_Class"], part["v_Vel"] = 15.0, 6.0, 2, speed
        part["Lane_ID"], part["Space_Headway"] = lane, 60.0
        parts.append(part)
    return pd.concat(parts, ignore_index=True)


def merging(frames: int = 120, first_id: int = 1, crossing: int = 60) -> pd.DataFrame:
    """Vehicle 1 leaves lane 3 for lane 2, where 2 and 3 drive ahead of it and 4 behind."""
    table = platoon(4, frames, first_id)
    changer = table["Vehicle_ID"] == first_id
    frame = table["Frame_ID"][changer]
    place = 30.0 - 12.0 / (1 + np.exp(-(frame - crossing) / 5))
    table.loc[changer, "Local_X"] = place
    table.loc[changer, "Lane_ID"] = np.where(place > 24, 3, 2)
    lag = table["Vehicle_ID"] == first_id + 3
    table.loc[lag, "Local_Y"] = table.loc[lag, "Local_Y"] - 240.0
    return table


def as_text(table: pd.DataFrame, path: Path) -> Path:
    """The official form: whitespace, no header."""
    whole = ["Vehicle_ID", "Frame_ID", "Total_Frames", "Global_Time", "v_Class", "Lane_ID", "Preceding", "Following"]
    path.write_text(table.astype(dict.fromkeys(whole, "int64")).to_string(index=False, header=False) + "\n")
    return path


def as_portal(tables: dict[str, pd.DataFrame], path: Path) -> Path:
    """The data portal's form: all sites in one file, more columns, thousands separators, quotes, other capitals."""
    parts = [table.assign(Location=site, Int_ID="", Direction="", O_Zone="") for site, table in tables.items()]
    table = pd.concat(parts, ignore_index=True).rename(columns={"v_Length": "v_length"})
    for name in ("Global_Time", "Global_X", "Local_Y"):
        table[name] = table[name].map("{:,}".format)
    table.to_csv(path, index=False)
    return path


@pytest.fixture
def text_file(tmp_path: Path) -> Callable[[pd.DataFrame], Path]:
    return lambda table: as_text(table, tmp_path / "trajectories.txt")
