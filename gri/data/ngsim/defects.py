"""What is wrong with a recording: repairs that lose nothing, and counts of what a person should know.

Repaired: repeated rows are dropped, gaps of up to `FILLED` frames are filled by straight lines. Never repaired: where a
vehicle jumps, its track is cut in two, so that no scene holds the jump. Everything else is counted only.
"""

from collections import Counter
from dataclasses import dataclass

import msgspec
import numpy as np

from gri.data.ngsim.columns import CLIPPED, FOOT, FRAME
from gri.data.ngsim.recordings import Recording
from gri.errors import InputError

FILLED = 5
"""Missing frames in a row that are filled."""
JUMP = 1.5
"""[m] by which a step along the road may differ from the recorded speed, at 10 Hz."""
SIDESTEP = 1.0
"""[m], the farthest a vehicle can move sideways in 0.1 s."""
LONG_CAR = 12.0  # [m]
FLICKER = 10  # frames: a lane left again within this time was not driven in


@dataclass(frozen=True)
class Tracks:
    """Clean rows at 10 Hz in SI units, by track and frame; a track is one vehicle without gaps or jumps.

    x counts along the road, y to the left; both are those of the reference point of the file. All arrays have one
    entry per row, R in all.
    """

    vehicle: np.ndarray
    track: np.ndarray
    frame: np.ndarray
    x: np.ndarray
    y: np.ndarray
    length: np.ndarray
    width: np.ndarray
    kind: np.ndarray
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
    road: tuple[float, float]
    """Least and greatest position along the road [m]."""
    speed: float
    """Mean [m/s]."""
    lanes: tuple[int, ...]
    defects: dict[str, int]
    """Counts of rows, or of what the name says; 0 where nothing was found."""


def clean(recording: Recording) -> tuple[Tracks, Quality]:
    """The recording's tracks and its report. Errors: `InputError` where the units are not feet and seconds."""
    rows = recording.rows
    found: Counter[str] = Counter()
    rows = _without_repeats(rows[np.lexsort((rows["frame"], rows["vehicle"]))], found)
    _check_units(recording.name, rows)
    same, step = _steps(rows)
    jumped = _jumps(rows, same & (step == 1), found)
    gap = same & (step > 1)
    found["gaps filled"] = int((gap & (step <= FILLED + 1)).sum())
    found["gaps left, track cut"] = int((gap & (step > FILLED + 1)).sum())
    begins = ~same | jumped | (gap & (step > FILLED + 1))
    _count(rows, same & (step == 1) & ~jumped, found)
    tracks = _filled(rows, np.cumsum(begins) - 1)
    found["vehicles overlapping ahead"] = _overlaps(tracks)
    return tracks, _quality(recording, rows, tracks, found)


def _quality(recording: Recording, rows: np.ndarray, tracks: Tracks, found: Counter[str]) -> Quality:
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
        defects=dict(found),
    )


def _steps(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether each row is of the vehicle before it, and how many frames later."""
    same = np.diff(rows["vehicle"], prepend=rows["vehicle"][:1] - 1) == 0
    return same, np.diff(rows["frame"], prepend=rows["frame"][:1])


def _without_repeats(rows: np.ndarray, found: Counter[str]) -> np.ndarray:
    same, step = _steps(rows)
    again = same & (step == 0)
    alike = np.zeros(len(rows), bool)
    alike[1:] = rows[1:] == rows[:-1]
    found["repeated rows"] = int((again & alike).sum())
    found["rows that contradict another of the same frame"] = int((again & ~alike).sum())
    return rows[~again]


def _jumps(rows: np.ndarray, next_frame: np.ndarray, found: Counter[str]) -> np.ndarray:
    """Rows a vehicle cannot have reached in one frame; two that trade places are numbers swapped."""
    along = np.diff(rows["y"], prepend=rows["y"][:1]) * FOOT
    aside = np.diff(rows["x"], prepend=rows["x"][:1]) * FOOT
    expected = rows["speed"] * FOOT * FRAME
    jumped = next_frame & ((np.abs(along - expected) > JUMP) | (np.abs(aside) > SIDESTEP))
    swapped = 0
    places = np.flatnonzero(jumped)
    for place in places:
        there = places[(rows["frame"][places] == rows["frame"][place]) & (places != place)]
        was = np.stack([rows["x"][there - 1], rows["y"][there - 1]], -1) * FOOT
        here = np.array([rows["x"][place], rows["y"][place]]) * FOOT
        reach = np.abs(was - here) - np.array([0.0, float(expected[place])])
        swapped += int((reach <= (SIDESTEP, JUMP)).all(1).any())
    found["numbers swapped with another vehicle"] = swapped
    found["other jumps"] = int(jumped.sum()) - swapped
    return jumped


def _count(rows: np.ndarray, next_frame: np.ndarray, found: Counter[str]) -> None:
    along = np.diff(rows["y"], prepend=rows["y"][:1]) * FOOT
    acceleration = np.abs(rows["acceleration"])
    found["accelerations cut off at 11.2 ft/s2"] = int((np.abs(acceleration - CLIPPED) < 0.01).sum())
    found["accelerations above 8 m/s2"] = int((acceleration * FOOT > 8.0).sum())
    found["steps backwards"] = int((next_frame & (along < -0.15)).sum())
    found["rows without a length"] = int((rows["length"] <= 0).sum())
    long_car = (rows["length"] * FOOT > LONG_CAR) & (rows["kind"] == 2)
    found["rows of cars longer than 12 m"] = int(long_car.sum())
    changed = np.flatnonzero(next_frame & (np.diff(rows["lane"], prepend=rows["lane"][:1]) != 0))
    back = (np.diff(changed) < FLICKER) & (rows["vehicle"][changed[1:]] == rows["vehicle"][changed[:-1]])
    found["lanes left again within 1 s"] = int(back.sum())


def _filled(rows: np.ndarray, track: np.ndarray) -> Tracks:
    """SI units, with the missing frames of every track on straight lines."""
    first = np.r_[True, track[1:] != track[:-1]]
    step = np.where(first, 1, np.diff(rows["frame"], prepend=rows["frame"][:1]))
    index = np.repeat(np.arange(len(rows)), step)  # a row stands for itself and for the missing ones before it
    late = _late(step)
    share = late / step[index]
    before = np.where(first[index], index, index - 1)

    def line(name: str) -> np.ndarray:
        values = rows[name].astype(float)
        return (1 - share) * values[index] + share * values[before]

    return Tracks(
        vehicle=rows["vehicle"][index],
        track=track[index],
        frame=rows["frame"][index] - late.astype(int),
        x=line("y") * FOOT,
        y=-line("x") * FOOT,
        length=rows["length"][index] * FOOT,
        width=rows["width"][index] * FOOT,
        kind=rows["kind"][index],
        lane=rows["lane"][index],
    )


def _late(step: np.ndarray) -> np.ndarray:
    """For each row after filling: how many frames before the row it was filled from."""
    ends = np.cumsum(step)
    return (np.repeat(ends, step) - 1 - np.arange(ends[-1])).astype(float)


def _overlaps(tracks: Tracks) -> int:
    """Rows in which the vehicle ahead in the lane, with its length, reaches back over the vehicle's front."""
    order = np.lexsort((tracks.x, tracks.lane, tracks.frame))
    behind, ahead = order[:-1], order[1:]
    together = (tracks.frame[behind] == tracks.frame[ahead]) & (tracks.lane[behind] == tracks.lane[ahead])
    return int((together & (tracks.x[ahead] - tracks.x[behind] < tracks.length[ahead])).sum())


def _check_units(name: str, rows: np.ndarray) -> None:
    """Lengths, lanes and headways tell feet from metres; speeds must fit the steps."""
    same, step = _steps(rows)
    moved = (same & (step == 1))[1:]
    travelled = float(np.diff(rows["y"])[moved].sum())
    expected = float(rows["speed"][1:][moved].sum()) * FRAME
    if expected > 30 and not 0.8 < travelled / expected < 1.25:
        raise InputError(
            f"{name}: vehicles move {travelled / expected:.2f} times as far as v_Vel says, wanted about 1; "
            "Local_Y and v_Vel are not in the same units (ft and ft/s), or Local_Y does not count along the road"
        )
    lengths, headways = rows["length"][rows["length"] > 0], rows["headway"][rows["headway"] > 0]
    metric = len(lengths) > 0 and float(np.median(lengths)) < 9.0
    if not len(lengths) and len(headways) > 100:
        metric = float(np.quantile(headways, 0.01)) < 12.0  # 12 ft from front to front: nobody stands that close
    if metric:
        raise InputError(
            f"{name}: lengths or headways look like metres, wanted feet; give the official file, or multiply Local_X, "
            "Local_Y, v_Length, v_Width, v_Vel, v_Acc and Space_Headway by 3.28084"
        )
