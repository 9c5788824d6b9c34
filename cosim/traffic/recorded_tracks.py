"""Reading a recording for its replay: the track of every vehicle at the steps of the simulation.

Positions are smoothed (gri.data.ngsim.smoothing) and interpolated to the simulation's steps. The recordings of a file
are played one after the other. This brings pandas and scipy, which only a replay needs.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from cosim.spec.input_files import recording_path
from cosim.spec.scenario import Replay
from cosim.traffic.replay import RecordedTrack
from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import clean
from gri.data.ngsim.smoothing import Motion, Smoothing, smoothed
from gri.data.recordings.reading import recordings_of
from gri.data.recordings.table import CLASSES
from gri.errors import InputError

PAUSE = 2.0  # [s] between two recordings
MOVING = 1.0  # [m/s], below which a direction of travel cannot be told from noise
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
        if np.ptp(motion.y) == 0 or not (motion.length > 0).all():
            raise InputError(
                f"{path}: has no lateral positions or no sizes of vehicles, so that no vehicle can be placed "
                "on the road; give a recording that has them"
            )
        found += _tracks(recording.name, motion, background, step, begin)
        begin += float(np.ptp(motion.step)) * FRAME + PAUSE
    return tuple(sorted(found, key=lambda track: (track.first_step, track.name)))


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
