"""Reading a recording for its replay: the track of every vehicle at the steps of the simulation.

Positions are smoothed (gri.data.ngsim.smoothing) and interpolated to the simulation's steps. The recordings of a file
are played one after the other. This brings pandas and scipy, which only a replay needs.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from cosim.spec.input_files import recording_path
from cosim.spec.scenario import Replay
from cosim.traffic.recorded_track import RecordedTrack
from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import clean
from gri.data.ngsim.smoothing import Motion, Smoothing, smoothed
from gri.data.recordings.reading import recordings_of
from gri.data.recordings.table import CLASSES
from gri.errors import InputError

PAUSE = 2.0  # [s] between two recordings
MOVING = 1.0  # [m/s], below which a direction of travel cannot be told from noise
WIDTH = 1.8  # [m] of vehicles whose size is unknown
CHANGE = 3.0  # [s] that a lane change takes where lateral positions are unknown
TRUCKS = (CLASSES["truck"], CLASSES["bus"])


def read_tracks(background: Replay, step: float) -> tuple[RecordedTrack, ...]:
    """All tracks of the recording at multiples of `step` [s], in the order in which they begin.

    Raises InputError where there is no such file, or it lacks lateral positions or sizes.
    """
    path = recording_path(background)
    found: list[RecordedTrack] = []
    begin = step
    for recording in recordings_of(path):
        motion = smoothed(clean(recording)[0], Smoothing(every=1))
        if not len(motion):
            continue
        motion = _placed(motion, background, path)
        found += _tracks(recording.name, motion, background, step, begin)
        begin += float(np.ptp(motion.step)) * FRAME + PAUSE
    return tuple(sorted(found, key=lambda track: (track.first_step, track.name)))


def _placed(motion: Motion, background: Replay, path: Path) -> Motion:
    """The motion with what the recording lacks of lateral positions and sizes.

    Raises InputError where the scenario does not say what is to be used instead.
    """
    has_places, has_sizes = np.ptp(motion.y) > 0, bool((motion.length > 0).all())
    missing = [
        f"{what}, so that no vehicle can be placed on the road; give a recording that has them, or background.{field}"
        for what, has, field in (
            ("no lateral positions", has_places, "lane_width"),
            ("no sizes of vehicles", has_sizes, "vehicle_length"),
        )
        if not has and getattr(background, field) is None
    ]
    if missing:
        raise InputError(f"{path}: has {missing[0]}")
    if not has_places:
        assert background.lane_width is not None
        motion = replace(motion, **_lane_centres(motion, background.lane_width))
    if not has_sizes:
        assert background.vehicle_length is not None
        lengths = np.where(motion.length > 0, motion.length, background.vehicle_length)
        motion = replace(motion, length=lengths, width=np.where(motion.width > 0, motion.width, WIDTH))
    return motion


def _lane_centres(motion: Motion, lane_width: float) -> dict[str, Float[np.ndarray, " K"]]:
    """Lateral positions [m] and speeds [m/s] on the centres of the lanes; a change of lanes takes CHANGE s."""
    y, vy = -lane_width * (motion.lane - 1.0), np.zeros(len(motion))
    half = round(CHANGE / FRAME) // 2
    weights = np.full(2 * half + 1, 1 / (2 * half + 1))
    bounds = np.flatnonzero(np.r_[True, motion.track[1:] != motion.track[:-1], True])
    for start, end in pairwise(bounds):
        rows = slice(int(start), int(end))
        if np.ptp(y[rows]) > 0:
            y[rows] = np.convolve(np.pad(y[rows], half, mode="edge"), weights, mode="valid")
            vy[rows] = np.gradient(y[rows], FRAME) if end - start > 1 else 0.0
    return {"y": y, "vy": vy}


def _tracks(name: str, motion: Motion, background: Replay, step: float, begin: float) -> Iterator[RecordedTrack]:
    """The tracks of one recording that begins at `begin` [s] of the simulation."""
    time = begin + (motion.step - motion.step.min()) * FRAME
    bounds = np.flatnonzero(np.r_[True, motion.track[1:] != motion.track[:-1], True])
    for start, end in pairwise(bounds):
        rows = slice(int(start), int(end))
        first, last = np.ceil(time[start] / step - 1e-6), np.floor(time[end - 1] / step + 1e-6)
        at = np.arange(first, last + 1) * step
        if not len(at):
            continue
        x, y, vx, vy = (np.interp(at, time[rows], getattr(motion, n)[rows]) for n in ("x", "y", "vx", "vy"))
        yield RecordedTrack(
            name=f"{name}/{motion.vehicle[start]}.{motion.track[start]}",
            lane=int(motion.lane[start]),
            truck=int(motion.kind[start]) in TRUCKS,
            length=float(motion.length[start]),
            width=float(motion.width[start]),
            first_step=int(first),
            s=x + background.entry,
            d=y + background.lane_1,
            heading=np.where(vx > MOVING, np.arctan2(vy, np.maximum(vx, MOVING)), 0.0),
            v=vx,
        )
