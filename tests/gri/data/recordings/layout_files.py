"""The same made-up traffic in every layout that is published, at 10 Hz, written as those data sets write it.

The traffic is that of `tests.gri.data.ngsim.conftest`: platoons and a merge on a straight road, in NGSIM's columns.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from gri.data.recordings.reading import clock_of
from tests.gri.data.ngsim.conftest import FOOT, merging, platoon

LENGTH, WIDTH = 15.0, 6.0  # [ft] of every vehicle
EDGES = (-12 * FOOT, -24 * FOOT, -36 * FOOT)  # lines between the lanes of the traffic [m]
KINDS = {1: "Motorcycle", 2: "Car", 3: "Truck"}


def traffic(frames: int = 120) -> pd.DataFrame:
    """Platoons of all three splits, a merge, a truck and a motorcycle; the columns are NGSIM's, without the clock."""
    parts = [platoon(first_id=301, lane=1, frames=frames), platoon(first_id=901, lane=4, frames=frames)]
    parts += [platoon(first_id=1, lane=4, frames=frames).assign(Local_Y=lambda t: t["Local_Y"] + 900.0)]
    parts += [merging(frames, first_id=210)]
    table = pd.concat(parts, ignore_index=True)
    rng = np.random.default_rng(5)
    wave = {v: rng.uniform(0, 6, 2) for v in table["Vehicle_ID"].unique()}
    for vehicle, (phase, other) in wave.items():
        rows = table["Vehicle_ID"] == vehicle
        time = table.loc[rows, "Frame_ID"] * 0.1
        table.loc[rows, "Local_Y"] += 1.5 * np.sin(time * 0.7 + phase)
        table.loc[rows, "v_Vel"] += 1.05 * np.cos(time * 0.7 + phase)
        table.loc[rows, "Local_X"] += 0.3 * np.sin(time * 0.5 + other)
    table.loc[table["Vehicle_ID"] == 903, "v_Class"] = 3
    table.loc[table["Vehicle_ID"] == 901, "v_Class"] = 1
    return table


def plane(table: pd.DataFrame) -> pd.DataFrame:
    """Middles of vehicles in a plane whose x is along the road [m], and what all such layouts have."""
    return pd.DataFrame(
        {
            "id": table["Vehicle_ID"],
            "frame": table["Frame_ID"],
            "front": table["Local_Y"] * FOOT,
            "x": table["Local_Y"] * FOOT - LENGTH * FOOT / 2,
            "y": -table["Local_X"] * FOOT,
            "v": table["v_Vel"] * FOOT,
            "length": LENGTH * FOOT,
            "width": WIDTH * FOOT,
            "lane": table["Lane_ID"],
            "kind": table["v_Class"].map(KINDS),
        }
    )


def ngsim(table: pd.DataFrame, path: Path, label: str) -> Path:
    """NGSIM's csv, whose clock is the one of the recording `label`, so that drawn motion is the same."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.assign(Global_Time=clock_of(label) + 100 * table["Frame_ID"]).to_csv(path, index=False)
    return path


def _folder(path: Path) -> Path:
    path.mkdir(parents=True, exist_ok=True)
    return path


def highd(table: pd.DataFrame, folder: Path, rate: float = 10.0) -> Path:
    """Three files; the traffic is on the lower carriageway, below an upper one of three lanes."""
    p = plane(table)
    tracks = pd.DataFrame(
        {
            "frame": p["frame"], "id": p["id"], "x": p["front"] - p["length"], "y": -p["y"] - p["width"] / 2,
            "width": p["length"], "height": p["width"], "xVelocity": p["v"], "yVelocity": 0.0, "xAcceleration": 0.0,
            "yAcceleration": 0.0, "frontSightDistance": 0.0, "backSightDistance": 0.0, "dhw": 0.0, "thw": 0.0,
            "ttc": 0.0, "precedingXVelocity": 0.0, "precedingId": 0, "followingId": 0, "leftPrecedingId": 0,
            "leftAlongsideId": 0, "leftFollowingId": 0, "rightPrecedingId": 0, "rightAlongsideId": 0,
            "rightFollowingId": 0, "laneId": p["lane"] + 5,
        }
    )  # fmt: skip
    _folder(folder)
    tracks.to_csv(folder / "07_tracks.csv", index=False)
    first = p.groupby("id", as_index=False).first()
    pd.DataFrame(
        {
            "id": first["id"],
            "width": first["length"],
            "height": first["width"],
            "class": first["kind"],
            "drivingDirection": 2,
        }
    ).to_csv(folder / "07_tracksMeta.csv", index=False)
    markings = "3.0;6.6;10.2;13.8"
    pd.DataFrame(
        {
            "id": [7],
            "frameRate": [rate],
            "upperLaneMarkings": [markings],
            "lowerLaneMarkings": ["15.0;18.6;22.2;25.8;29.4"],
        }
    ).to_csv(folder / "07_recordingMeta.csv", index=False)
    return folder / "07_tracks.csv"


def exid(table: pd.DataFrame, folder: Path) -> Path:
    """Three files; the road is along x, lanelets 100, 101, … are its lanes."""
    p = plane(table)
    lanelet = (99 + p["lane"]).astype(str)
    tracks = pd.DataFrame(
        {
            "recordingId": 7, "trackId": p["id"], "frame": p["frame"], "trackLifetime": 0, "xCenter": p["x"],
            "yCenter": p["y"], "heading": 0.0, "width": p["width"], "length": p["length"], "xVelocity": p["v"],
            "yVelocity": 0.0, "xAcceleration": 0.0, "yAcceleration": 0.0, "lonVelocity": p["v"], "latVelocity": 0.0,
            "lonAcceleration": 0.0, "latAcceleration": 0.0, "traveledDistance": 0.0, "latLaneCenterOffset": "0.1;2.0",
            "laneWidth": "3.6;3.6", "laneletId": lanelet + ";99", "laneChange": 0, "lonLaneletPos": "1.0;2.0",
            "laneletLength": "9.0;9.0", "leadId": -1, "rearId": -1,
        }
    )  # fmt: skip
    _folder(folder)
    tracks.to_csv(folder / "07_tracks.csv", index=False)
    first = p.groupby("id", as_index=False).first()
    kinds = first["kind"].str.lower()
    pd.DataFrame({"recordingId": 7, "trackId": first["id"], "class": kinds}).to_csv(
        folder / "07_tracksMeta.csv", index=False
    )
    pd.DataFrame({"recordingId": [7], "frameRate": [10.0], "xUtmOrigin": [0.0], "yUtmOrigin": [0.0]}).to_csv(
        folder / "07_recordingMeta.csv", index=False
    )
    return folder / "07_tracks.csv"


def interaction(table: pd.DataFrame, folder: Path) -> Path:
    """One file of vehicles beside one of pedestrians."""
    p = plane(table)
    tracks = pd.DataFrame(
        {
            "track_id": p["id"], "frame_id": p["frame"], "timestamp_ms": 100 * p["frame"],
            "agent_type": p["kind"].str.lower(), "x": p["x"], "y": p["y"], "vx": p["v"], "vy": 0.0, "psi_rad": 0.0,
            "length": p["length"], "width": p["width"],
        }
    )  # fmt: skip
    _folder(folder)
    tracks.to_csv(folder / "vehicle_tracks_007.csv", index=False)
    tracks.iloc[:2].assign(track_id="P1", agent_type="pedestrian/bicycle").to_csv(
        folder / "pedestrian_tracks_007.csv", index=False
    )
    return folder / "vehicle_tracks_007.csv"


def tgsim(table: pd.DataFrame, folder: Path) -> Path:
    """One file, y downwards in the picture, lanes named by numbers without order, hyphens in names."""
    p = plane(table)
    names = {1: 4, 2: 1, 3: 3, 4: 2}
    found = pd.DataFrame(
        {
            "id": p["id"], "time": (0.1 * p["frame"]).round(1), "xloc-kf": p["x"], "yloc-kf": -p["y"],
            "lane-kf": p["lane"].map(names), "speed-kf": p["v"], "acceleration-kf": 0.0,
            "length-smoothed": p["length"], "width-smoothed": p["width"],
            "type-most-common": p["kind"].map({"Motorcycle": 5, "Car": 3, "Truck": 7}), "acc": "No", "run-index": 7,
        }
    )  # fmt: skip
    found.to_csv(_folder(folder) / "I294_L1_final.csv", index=False)
    return folder / "I294_L1_final.csv"


def i24(table: pd.DataFrame, folder: Path, way: int = -1) -> Path:
    """One JSON array; each vehicle is one document. Seconds are counted from 1669200000."""
    from gri.data.recordings.i24 import BEGIN

    documents = []
    for vehicle, rows in table.groupby("Vehicle_ID"):
        rear = rows["Local_Y"] - LENGTH
        documents.append(
            {
                "_id": {"$oid": f"637c399add50d54aa5{vehicle:06d}"},
                "timestamp": (1669200000 + 0.1 * rows["Frame_ID"]).tolist(),
                "x_position": (BEGIN[way] + way * rear).tolist(),
                "y_position": (-way * (rows["Local_X"] + 12.0)).tolist(),
                "length": LENGTH, "width": WIDTH, "height": 5.0, "direction": way,
                "coarse_vehicle_class": {1: 6, 2: 0, 3: 4}[int(rows["v_Class"].iloc[0])],
                "first_timestamp": 0.0, "last_timestamp": 0.0, "starting_x": 0.0, "ending_x": 0.0,
            }
        )  # fmt: skip
    path = _folder(folder) / "INCEPTION.22-11-22.tutorial.json"
    path.write_text(json.dumps(documents))
    return path


def tidy(table: pd.DataFrame, folder: Path) -> Path:
    """The tidy table."""
    p = plane(table)
    found = pd.DataFrame(
        {
            "time_s": 0.1 * p["frame"], "vehicle_id": p["id"], "lane": p["lane"], "s_m": p["front"], "d_m": p["y"],
            "speed_mps": p["v"], "length_m": p["length"], "width_m": p["width"], "class": p["kind"],
        }
    )  # fmt: skip
    found.to_csv(_folder(folder) / "mine.csv", index=False)
    return folder / "mine.csv"


WRITERS: dict[str, Callable[[pd.DataFrame, Path], Path]] = {
    "highd": highd,
    "exid": exid,
    "interaction": interaction,
    "tgsim": tgsim,
    "i24": i24,
    "tidy": tidy,
}
LABELS = {"highd": "07-2", "exid": "7", "interaction": "", "tgsim": "7", "i24": "westbound", "tidy": ""}
"""Name of the recording that each file holds."""
