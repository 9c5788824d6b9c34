"""Recordings of any layout, read into the form that defects, smoothing and the search for scenes work on.

That form is `gri.data.ngsim.recordings.Recording`. Its rows are in feet and single precision, as NGSIM's are, so that
the same motion gives the same scenes, to the last bit, whatever layout it comes in.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from zlib import crc32

import numpy as np
import pandas as pd

from gri.data.ngsim.columns import FOOT, FRAME
from gri.data.ngsim.recordings import ROW_TYPE, Recording, RecordingStore, store_recordings
from gri.data.recordings import lanes
from gri.data.recordings.clock import with_frames
from gri.data.recordings.files import members
from gri.data.recordings.layouts import find_layout
from gri.data.recordings.parts import Part, Point, ReadingOptions
from gri.data.recordings.road_axis import estimated_axis, given_axis, on_roads
from gri.data.recordings.table import CLASSES, NO_VEHICLES, checked
from gri.errors import InputError, guarded_reading
from gri.progress import Progress, no_progress
from gri.storage.scratch import ScratchFolder

FARTHEST = 16_000.0
"""Positions that are farther away are counted from the first one, as single precision is too coarse there [m]."""


@dataclass
class Recordings:
    """The recordings of a file or folder, in their order, and what a person should know about the reading."""

    found: list[Recording] | RecordingStore
    layout: str
    unreadable: Counter[str] = field(default_factory=Counter)
    """Number of rows with a missing time, vehicle or position, by site; they are left out."""
    notes: list[str] = field(default_factory=list)

    def __iter__(self) -> Iterator[Recording]:
        return iter(self.found)

    def __len__(self) -> int:
        return len(self.found)


def open_recordings(
    path: Path, folder: Path, options: ReadingOptions | None = None, progress: Progress = no_progress
) -> Recordings:
    """The recordings of a file, folder or zip archive of any layout; rows of NGSIM's are stored in `folder`.

    Errors: `InputError` that names file, line or column if the layout is not recognised, a column is missing, a cell is
    no number, or the units or times cannot be right.
    """
    options = options or ReadingOptions()
    inside = members(path)
    layout, inside = find_layout(path, inside, options)
    if layout.read is None:
        store = store_recordings(path, folder, options.site, progress)
        notes = []
        if store.is_rounded:
            notes = [f"{path}: Global_Time is rounded to seconds or more; recordings are told apart only roughly"]
        return Recordings(store, layout.name, store.unreadable, notes)
    found: list[Recording] = []
    result = Recordings(found, layout.name)
    with guarded_reading(path, f"recording in the layout {layout.name}", "correct the file, or give --layout"):
        for done, part in enumerate(layout.read(inside, options, result.notes)):
            progress(f"reading {path.name}", done + 1, max(done + 1, len(inside)), float(len(part.table)))
            for name, table in _on_road(part, options, result.notes):
                found += _recordings(name, table, options.site or _site(path), result)
    if not found:
        raise InputError(f"{path}: has no rows of vehicles on a road; give a recording")
    return result


def recordings_of(path: Path, options: ReadingOptions | None = None) -> Iterator[Recording]:
    """The recordings of a file, one after the other (`open_recordings`)."""
    with ScratchFolder() as folder:
        yield from open_recordings(path, Path(folder), options)


def _site(path: Path) -> str:
    return path.name.lower().partition(".")[0]


def _on_road(part: Part, options: ReadingOptions, notes: list[str]) -> Iterator[tuple[str, pd.DataFrame]]:
    """The part as tidy tables with positions of front bumpers along roads, one per direction of travel."""
    if not part.in_plane:
        yield part.name, _with_front(_on_lanes(part.table, options), options.point or part.point)
        return
    table = part.table.dropna(subset=["time_s", "vehicle_id", "x_m", "y_m"])
    table = table.sort_values("time_s", kind="stable")
    path = table["vehicle_id"].astype(str)
    table = table.assign(path=table["recording"].astype(str) + "/" + path if "recording" in table else path)
    if options.axis:
        axis = given_axis(options.axis)
    else:
        axis = estimated_axis(table, part.name)
        angle = np.degrees(np.arctan2(axis.direction[1], axis.direction[0]))
        shape = "a curve" if axis.bend else "a straight line"
        notes.append(f"{part.name}: the road's axis is {shape} at {angle:.1f}°, estimated from the paths (see --axis)")
    for suffix, road in on_roads(table, axis, notes):
        if suffix:
            names = road["recording"].astype(str) if "recording" in road else pd.Series("", road.index)
            road = road.assign(recording=[f"{name}-{suffix}".lstrip("-") for name in names])
        yield part.name, _with_front(_on_lanes(road, options), options.point or part.point)


def _on_lanes(road: pd.DataFrame, options: ReadingOptions) -> pd.DataFrame:
    """The table with lanes from the given lines between them, else from the names of lanes, where there are any."""
    if options.lane_edges and "d_m" in road:
        return road.assign(lane=lanes.from_edges(road["d_m"], options.lane_edges))
    if "lane_label" in road and "lane" not in road:
        return road.assign(lane=lanes.from_labels(road["lane_label"], road["d_m"]))
    return road


def _with_front(table: pd.DataFrame, point: Point) -> pd.DataFrame:
    """The table with `s_m` of front bumpers instead of middles or rear bumpers."""
    if point == "front" or "length_m" not in table:
        return table
    return table.assign(s_m=table["s_m"] + table["length_m"].fillna(0.0) * (0.5 if point == "centre" else 1.0))


def _recordings(name: str, table: pd.DataFrame, site: str, result: Recordings) -> Iterator[Recording]:
    """The recordings of a tidy table."""
    table = checked(table, name)
    known = table[["time_s", "s_m"]].notna().all(axis=1) & table["vehicle_id"].notna()
    result.unreadable[site] += int((~known).sum())
    others = table["class"] == NO_VEHICLES
    if (known & others).any():
        count = table.loc[known & others, "vehicle_id"].nunique()
        result.notes.append(f"{name}: {count} pedestrians, cyclists and the like are left out")
    table = _with_lanes(table[known & ~others], name, result.notes)
    for label, rows in table.groupby(table["recording"].astype(str), sort=True):
        where = f"{name}, recording {label}" if label else name
        rows = rows.assign(vehicle=vehicle_numbers(rows, where))
        rows = with_frames(_with_speeds(rows), where, result.notes)
        _check_units(rows, where)
        if len(rows):
            yield as_recording(rows, site, str(label), where, result.notes)


def vehicle_numbers(rows: pd.DataFrame, where: str) -> np.ndarray:
    """The vehicles' numbers: their ids if those are whole numbers, else numbers from 1 in the order of entry.

    Splits go by vehicle number, so numbers should grow with time (`gri.data.ngsim.rules.splits_of`).
    """
    ids = rows["vehicle_id"]
    numbers = pd.to_numeric(ids, errors="coerce").to_numpy(float)
    if np.isfinite(numbers).all() and (numbers == np.round(numbers)).all() and (np.abs(numbers) < 2**31).all():
        return numbers.astype(int)
    text = ids.astype(str)
    entry = rows["time_s"].groupby(text).min().reset_index().sort_values(["time_s", "vehicle_id"], kind="stable")
    order: Mapping[str, int] = {str(name): k + 1 for k, name in enumerate(entry["vehicle_id"])}
    return text.map(order).to_numpy(int)


def _with_lanes(rows: pd.DataFrame, where: str, notes: list[str]) -> pd.DataFrame:
    if rows["lane"].notna().any():
        return rows.assign(lane=rows["lane"].fillna(0.0))
    if rows["d_m"].isna().all():
        raise InputError(
            f"{where}: got neither lanes nor lateral positions, wanted one of them; name the column with"
            " --map lane=COLUMN or --map d_m=COLUMN"
        )
    edges = lanes.estimated_edges(rows["d_m"])
    shown = ", ".join(f"{edge:.2f}" for edge in edges)
    between = f", with lines at {shown} m (see --lane-edges)" if edges else ""
    notes.append(f"{where}: {len(edges) + 1} lanes, estimated from lateral positions{between}")
    return rows.assign(lane=lanes.from_edges(rows["d_m"], edges))


def _with_speeds(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows with speeds; where all are missing, those of the positions."""
    if rows["speed_mps"].notna().all():
        return rows
    ordered = rows.sort_values(["vehicle", "time_s"], kind="stable")
    track = ordered.groupby("vehicle", sort=False)
    steps, moved = track["time_s"].diff(), track["s_m"].diff()
    speed = (moved / steps.where(steps > 0)).groupby(ordered["vehicle"], sort=False).bfill().fillna(0.0)
    return rows.assign(speed_mps=rows["speed_mps"].fillna(speed))


def _check_units(rows: pd.DataFrame, where: str) -> None:
    """Errors: `InputError` if speeds do not agree with distances, or lengths look like feet."""
    vehicle, frame, s = (rows[name].to_numpy() for name in ("vehicle", "frame", "s_m"))
    moved = (np.diff(vehicle) == 0) & (np.diff(frame) == 1)
    travelled, expected = float(np.diff(s)[moved].sum()), float(rows["speed_mps"].to_numpy()[1:][moved].sum()) * 0.1
    if expected > 30 and not 0.8 < travelled / expected < 1.25:
        hint = "; they decrease in driving direction: map s_m=COLUMN*-1" if travelled < 0 else ""
        raise InputError(
            f"{where}: vehicles move {travelled / expected:.2f} times as far as their speeds say, wanted about 1{hint};"
            " give positions in m along the road and speeds in m/s, or factors, such as --map speed_mps=COLUMN*0.3048"
        )
    lengths = rows["length_m"].to_numpy()
    if (lengths > 0).any() and not 2.0 <= float(np.median(lengths[lengths > 0])) <= 9.5:
        raise InputError(
            f"{where}: the median length of vehicles is {np.median(lengths[lengths > 0]):.1f} m, wanted 2 to 9.5 m;"
            " give lengths in m, or a factor, such as --map length_m=COLUMN*0.3048"
        )


def clock_of(label: str) -> int:
    """The number from which lateral motion is drawn: the recording's name if it is a number, else a checksum of it."""
    return int(label) if label.lstrip("-").isdigit() else crc32(label.encode()) if label else 0


def as_recording(rows: pd.DataFrame, site: str, label: str, where: str, notes: list[str]) -> Recording:
    """Rows with frames as a `Recording`, whose rows are in feet."""
    s = rows["s_m"].to_numpy()
    if np.abs(s).max() > FARTHEST:
        first = float(np.floor(s.min() / 100) * 100)
        notes.append(f"{where}: positions are counted from s_m = {first:g} m")
        s = s - first
    found = np.zeros(len(rows), ROW_TYPE)
    found["vehicle"], found["frame"] = rows["vehicle"], rows["frame"]
    found["y"] = s / FOOT
    found["x"] = -rows["d_m"].fillna(0.0).to_numpy() / FOOT
    found["kind"] = rows["class"].map(CLASSES).to_numpy()
    found["lane"] = rows["lane"].to_numpy()
    of_field = {"length": "length_m", "width": "width_m", "speed": "speed_mps", "acceleration": "acceleration_mps2"}
    for name, column in of_field.items():
        found[name] = rows[column].fillna(0.0).to_numpy() / FOOT
    return Recording(site, clock_of(label), found, label)


def tidy_table(recording: Recording) -> pd.DataFrame:
    """A recording as a tidy table; scenes of it are those of the recording, to the last bit."""
    rows = recording.rows
    names = {code: name for name, code in CLASSES.items()}
    metres = {name: rows[name].astype(float) * FOOT for name in ("x", "y", "speed", "acceleration", "length", "width")}
    return pd.DataFrame(
        {
            "recording": recording.label or str(recording.clock),
            "time_s": (rows["frame"] * FRAME).round(1),
            "vehicle_id": rows["vehicle"].astype(int),
            "lane": rows["lane"].astype(int),
            "s_m": metres["y"],
            "d_m": -metres["x"] if np.ptp(rows["x"]) > 0 else np.nan,
            "speed_mps": metres["speed"],
            "acceleration_mps2": metres["acceleration"],
            "length_m": metres["length"],
            "width_m": metres["width"],
            "class": pd.Series(rows["kind"]).map(names).fillna("unknown"),
        }
    )
