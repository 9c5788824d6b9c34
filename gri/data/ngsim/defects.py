"""Defects of a recording: what is repaired, and what is only counted.

Repeated rows are dropped. Gaps of up to `MAX_FILLED_FRAMES` frames are filled by linear interpolation. Where a vehicle
jumps, or a gap is longer, its track is cut in two, so that no scene contains the jump. All other defects are only
counted.
"""

from collections import Counter
from dataclasses import dataclass

import msgspec
import numpy as np

from gri.data.ngsim.columns import ACCELERATION_LIMIT, FOOT, FRAME
from gri.data.ngsim.recordings import Recording
from gri.errors import InputError

MAX_FILLED_FRAMES = 5
"""Longest gap in a track that is filled [frames]."""
MAX_LONGITUDINAL_DEVIATION = 1.5
"""A step of 0.1 s along the road that differs by more from recorded speed times time is a jump [m]."""
MAX_LATERAL_STEP = 1.0
"""A longer step of 0.1 s across the road is a jump [m]."""
LONG_CAR = 12.0
"""A vehicle of class 2 (automobile) that is longer has a wrong class or length [m]."""
MIN_FRAMES_IN_LANE = 10
"""A lane that is left again sooner is probably an error of detection [frames]."""


@dataclass(frozen=True)
class Tracks:
    """Clean rows at 10 Hz in SI units, ordered by track and frame. A track is one vehicle without gaps or jumps.

    All arrays are [R], one entry for each row. x [m] increases along the road, y [m] to the left. Both are positions of
    the file's reference point, in NGSIM the middle of the front bumper.
    """

    vehicle: np.ndarray
    """Number of the vehicle in the recording."""
    track: np.ndarray
    """Number of the track, from 0."""
    frame: np.ndarray
    x: np.ndarray
    y: np.ndarray
    length: np.ndarray
    """[m]; 0 if not recorded."""
    width: np.ndarray
    """[m]; 0 if not recorded."""
    kind: np.ndarray
    """Class: 1 motorcycle, 2 automobile, 3 truck."""
    lane: np.ndarray

    def __len__(self) -> int:
        return len(self.track)


class Quality(msgspec.Struct, frozen=True, kw_only=True):
    """The data report of one recording."""

    recording: str
    rows: int
    vehicles: int
    tracks: int
    start: int
    """Global_Time of the first frame [ms]."""
    seconds: float
    """Time from the first to the last frame [s]."""
    road: tuple[float, float]
    """Smallest and largest position along the road [m]."""
    speed: float
    """Mean speed [m/s]."""
    lanes: tuple[int, ...]
    defects: dict[str, int]
    """Number of rows, or of the events that the name says, for each defect."""


def clean(recording: Recording) -> tuple[Tracks, Quality]:
    """The recording's tracks and its data report.

    Errors: `InputError` if the units are not feet and seconds.
    """
    rows = recording.rows
    counts: Counter[str] = Counter()
    rows = _drop_repeated_rows(rows[np.lexsort((rows["frame"], rows["vehicle"]))], counts)
    _check_units(recording.name, rows)
    same, step = _steps(rows)
    jumped = _jumped_rows(rows, same & (step == 1), counts)
    gap = same & (step > 1)
    counts["gaps filled"] = int((gap & (step <= MAX_FILLED_FRAMES + 1)).sum())
    counts["gaps left, track cut"] = int((gap & (step > MAX_FILLED_FRAMES + 1)).sum())
    begins = ~same | jumped | (gap & (step > MAX_FILLED_FRAMES + 1))
    _count_defects(rows, same & (step == 1) & ~jumped, counts)
    tracks = _fill_gaps(rows, np.cumsum(begins) - 1)
    counts["vehicles overlapping ahead"] = _count_overlaps(tracks)
    return tracks, _quality(recording, rows, tracks, counts)


def _quality(recording: Recording, rows: np.ndarray, tracks: Tracks, counts: Counter[str]) -> Quality:
    first, last = int(rows["frame"].min()), int(rows["frame"].max())
    return Quality(
        recording=recording.name,
        rows=len(recording.rows),
        vehicles=len(np.unique(rows["vehicle"])),
        tracks=int(tracks.track[-1]) + 1,
        start=recording.clock + 100 * first,
        seconds=round((last - first + 1) * FRAME, 1),
        road=(round(float(tracks.x.min()), 1), round(float(tracks.x.max()), 1)),
        speed=round(float(rows["speed"].mean()) * FOOT, 2),
        lanes=tuple(int(lane) for lane in np.unique(rows["lane"])),
        defects=dict(counts),
    )


def _steps(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each row: is it of the same vehicle as the row before, and how many frames later is it?"""
    same = np.diff(rows["vehicle"], prepend=rows["vehicle"][:1] - 1) == 0
    return same, np.diff(rows["frame"], prepend=rows["frame"][:1])


def _drop_repeated_rows(rows: np.ndarray, counts: Counter[str]) -> np.ndarray:
    same, step = _steps(rows)
    again = same & (step == 0)
    alike = np.zeros(len(rows), bool)
    alike[1:] = rows[1:] == rows[:-1]
    counts["repeated rows"] = int((again & alike).sum())
    counts["rows that contradict another of the same frame"] = int((again & ~alike).sum())
    return rows[~again]


def _jumped_rows(rows: np.ndarray, next_frame: np.ndarray, counts: Counter[str]) -> np.ndarray:
    """For each row: has the vehicle jumped there from the row before?

    Where two vehicles jump to each other's previous positions, their numbers were swapped.
    """
    along = np.diff(rows["y"], prepend=rows["y"][:1]) * FOOT
    aside = np.diff(rows["x"], prepend=rows["x"][:1]) * FOOT
    expected = rows["speed"] * FOOT * FRAME
    jumped = next_frame & ((np.abs(along - expected) > MAX_LONGITUDINAL_DEVIATION) | (np.abs(aside) > MAX_LATERAL_STEP))
    swapped = 0
    places = np.flatnonzero(jumped)
    for place in places:
        there = places[(rows["frame"][places] == rows["frame"][place]) & (places != place)]
        was = np.stack([rows["x"][there - 1], rows["y"][there - 1]], -1) * FOOT
        here = np.array([rows["x"][place], rows["y"][place]]) * FOOT
        reach = np.abs(was - here) - np.array([0.0, float(expected[place])])
        swapped += int((reach <= (MAX_LATERAL_STEP, MAX_LONGITUDINAL_DEVIATION)).all(1).any())
    counts["numbers swapped with another vehicle"] = swapped
    counts["other jumps"] = int(jumped.sum()) - swapped
    return jumped


def _count_defects(rows: np.ndarray, next_frame: np.ndarray, counts: Counter[str]) -> None:
    along = np.diff(rows["y"], prepend=rows["y"][:1]) * FOOT
    acceleration = np.abs(rows["acceleration"])
    counts["accelerations cut off at 11.2 ft/s2"] = int((np.abs(acceleration - ACCELERATION_LIMIT) < 0.01).sum())
    counts["accelerations above 8 m/s2"] = int((acceleration * FOOT > 8.0).sum())
    counts["steps backwards"] = int((next_frame & (along < -0.15)).sum())
    counts["rows without a length"] = int((rows["length"] <= 0).sum())
    long_car = (rows["length"] * FOOT > LONG_CAR) & (rows["kind"] == 2)
    counts["rows of cars longer than 12 m"] = int(long_car.sum())
    changed = np.flatnonzero(next_frame & (np.diff(rows["lane"], prepend=rows["lane"][:1]) != 0))
    back = (np.diff(changed) < MIN_FRAMES_IN_LANE) & (rows["vehicle"][changed[1:]] == rows["vehicle"][changed[:-1]])
    counts["lanes left again within 1 s"] = int(back.sum())


def _fill_gaps(rows: np.ndarray, track: np.ndarray) -> Tracks:
    """Rows in SI units, with the missing frames of every track filled by linear interpolation."""
    first = np.r_[True, track[1:] != track[:-1]]
    step = np.where(first, 1, np.diff(rows["frame"], prepend=rows["frame"][:1]))
    index = np.repeat(np.arange(len(rows)), step)  # each recorded row, once more for each missing frame before it
    early = _frames_before_next_row(step)
    share = early / step[index]
    before = np.where(first[index], index, index - 1)

    def line(name: str) -> np.ndarray:
        values = rows[name].astype(float)
        return (1 - share) * values[index] + share * values[before]

    return Tracks(
        vehicle=rows["vehicle"][index],
        track=track[index],
        frame=rows["frame"][index] - early.astype(int),
        x=line("y") * FOOT,
        y=-line("x") * FOOT,
        length=rows["length"][index] * FOOT,
        width=rows["width"][index] * FOOT,
        kind=rows["kind"][index],
        lane=rows["lane"][index],
    )


def _frames_before_next_row(step: np.ndarray) -> np.ndarray:
    """For each row after filling: the distance to the next recorded row [frames], given the steps between those."""
    ends = np.cumsum(step)
    return (np.repeat(ends, step) - 1 - np.arange(ends[-1])).astype(float)


def _count_overlaps(tracks: Tracks) -> int:
    """Number of rows in which a vehicle overlaps with the vehicle ahead of it in its lane."""
    order = np.lexsort((tracks.x, tracks.lane, tracks.frame))
    behind, ahead = order[:-1], order[1:]
    together = (tracks.frame[behind] == tracks.frame[ahead]) & (tracks.lane[behind] == tracks.lane[ahead])
    return int((together & (tracks.x[ahead] - tracks.x[behind] < tracks.length[ahead])).sum())


def _check_units(name: str, rows: np.ndarray) -> None:
    """Check that lengths are in feet and that speeds agree with the distances travelled.

    Errors: `InputError` if lengths (or headways, if there are no lengths) look like metres, or if speeds do not agree.
    """
    same, step = _steps(rows)
    moved = (same & (step == 1))[1:]
    travelled = float(np.diff(rows["y"])[moved].sum())
    expected = float(rows["speed"][1:][moved].sum()) * FRAME
    if expected > 30 and not 0.8 < travelled / expected < 1.25:
        raise InputError(
            f"{name}: vehicles move {travelled / expected:.2f} times as far as v_Vel says, wanted about 1; "
            "they are not in the same units; give Local_Y in ft along the road and v_Vel in ft/s"
        )
    lengths, headways = rows["length"][rows["length"] > 0], rows["headway"][rows["headway"] > 0]
    metric = len(lengths) > 0 and float(np.median(lengths)) < 9.0
    if not len(lengths) and len(headways) > 100:
        metric = float(np.quantile(headways, 0.01)) < 12.0  # vehicles never stand only 12 ft apart, front to front
    if metric:
        raise InputError(
            f"{name}: lengths or headways look like metres, wanted feet; give the official file, or multiply Local_X, "
            "Local_Y, v_Length, v_Width, v_Vel, v_Acc and Space_Headway by 3.28084"
        )
