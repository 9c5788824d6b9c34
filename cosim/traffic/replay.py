"""A recording as the surrounding traffic: every vehicle moves as it was recorded, until somebody else drives it.

Positions are smoothed (gri.data.ngsim.smoothing) and interpolated to the simulation's steps. A file's recordings are
played one after the other. Whoever was driven by a policy and handed back stays with SUMO's driver.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from zlib import crc32

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from cosim.spec.demand import Flow, Traffic
from cosim.spec.input_files import recording_path
from cosim.spec.scenario import Replay
from cosim.sumo import Sumo
from cosim.world.road_frame import RoadFrame
from gri.data.ngsim.columns import FRAME
from gri.data.ngsim.defects import clean
from gri.data.ngsim.recordings import recordings
from gri.data.ngsim.smoothing import Motion, Smoothing, smoothed
from gri.errors import InputError

PAUSE = 2.0  # [s] between two recordings
MOVING = 1.0  # [m/s], below which a direction of travel cannot be told from noise
TRUCK_CLASS = 3  # v_Class in NGSIM's files


@dataclass(frozen=True)
class Track:
    """One recorded vehicle in the road frame, a value per step from step `first` on; headings are against the road."""

    name: str
    lane: int  # where it was first seen; NGSIM's number
    truck: bool
    length: float
    width: float
    first: int
    s: Float[np.ndarray, " K"]
    d: Float[np.ndarray, " K"]
    heading: Float[np.ndarray, " K"]
    v: Float[np.ndarray, " K"]

    @property
    def last(self) -> int:
        """The last step at which it is there."""
        return self.first + len(self.s) - 1


def without_demand(traffic: Traffic) -> Traffic:
    """The traffic's drivers and routes, with nobody on them and nothing to warm up."""
    flows = tuple(replace(flow, per_hour=(0.0,)) for flow in traffic.flows)
    return replace(traffic, flows=flows, warm_up=0.0, bottleneck=None)


def tracks_of(background: Replay, step: float) -> tuple[Track, ...]:
    """All tracks of the recording, in the order in which they begin.

    Raises InputError where there is no such file, or it lacks lateral positions or sizes.
    """
    path = recording_path(background)
    found: list[Track] = []
    begin = step
    for recording in recordings(path):
        motion = smoothed(clean(recording)[0], Smoothing(every=1))
        if not len(motion):
            continue
        if np.ptp(motion.y) == 0 or not (motion.length > 0).all():
            raise InputError(
                f"{path}: has no lateral positions (Local_X) or no sizes (v_Length), so that nobody can "
                "be placed on the road; give a recording that has them"
            )
        found += _tracks(recording.name, motion, background, step, begin)
        begin += float(np.ptp(motion.step)) * FRAME + PAUSE
    return tuple(sorted(found, key=lambda track: (track.first, track.name)))


def _tracks(name: str, motion: Motion, background: Replay, step: float, begin: float) -> Iterator[Track]:
    time = begin + (motion.step - motion.step.min()) * FRAME
    bounds = np.flatnonzero(np.r_[True, motion.track[1:] != motion.track[:-1], True])
    for start, end in pairwise(bounds):
        rows = slice(int(start), int(end))
        first, last = np.ceil(time[start] / step - 1e-6), np.floor(time[end - 1] / step + 1e-6)
        at = np.arange(first, last + 1) * step
        if not len(at):
            continue
        x, y, vx, vy = (np.interp(at, time[rows], getattr(motion, n)[rows]) for n in ("x", "y", "vx", "vy"))
        yield Track(
            name=f"{name}/{motion.vehicle[start]}.{motion.track[start]}",
            lane=int(motion.lane[start]),
            truck=bool(motion.kind[start] == TRUCK_CLASS),
            length=float(motion.length[start]),
            width=float(motion.width[start]),
            first=int(first),
            s=x + background.entry,
            d=y + background.lane_1,
            heading=np.where(vx > MOVING, np.arctan2(vy, np.maximum(vx, MOVING)), 0.0),
            v=vx,
        )


class Player:
    """Moves the recorded vehicles; to be called before every step of the simulation."""

    def __init__(
        self,
        world: Sumo,
        road: RoadFrame,
        tracks: tuple[Track, ...],
        step: float,
        background: Replay,
        traffic: Traffic,
    ) -> None:
        self._world, self._road, self._step = world, road, step
        self._flows = {lane: _flow(traffic, flow) for lane, flow in background.flows.items()}
        self._traffic = traffic
        self._starting: dict[int, list[Track]] = defaultdict(list)
        for track in tracks:
            self._starting[track.first].append(track)
        self._ends = {track.name: track.last for track in tracks}
        self._there: list[Track] = []
        self._k = 0

    @property
    def end(self) -> float:
        """When the last vehicle leaves [s]."""
        return max(self._ends.values(), default=0) * self._step

    def lasting(self, duration: float) -> frozenset[str]:
        """The vehicles that will still be there after so many seconds from now."""
        wanted = self._k + round(duration / self._step)
        return frozenset(track.name for track in self._there if track.last >= wanted)

    def __call__(self) -> None:
        """Command all vehicles to where they were recorded one step from now; insert and remove them at their times."""
        self._k += 1
        for track in self._starting.pop(self._k, ()):
            self._insert(track)
        self._there = [track for track in self._there if self._stays(track)]
        rows = [(track, self._k - track.first) for track in self._there if not self._world.is_commanded(track.name)]
        if not rows:
            return
        s, d, heading, v = (np.array([getattr(track, n)[k] for track, k in rows]) for n in ("s", "d", "heading", "v"))
        xy, along = self._road.to_world(s, d)
        for (track, _), (x, y, angle, speed) in zip(
            rows, np.column_stack([xy, along + heading, v]).tolist(), strict=True
        ):
            self._world.command(track.name, x, y, angle, speed)

    def _insert(self, track: Track) -> None:
        flow = self._flows.get(track.lane, self._traffic.flows[0])
        kind = next(
            (v for v in self._traffic.vehicles if v.name in flow.classes and (v.v_class == "truck") == track.truck),
            next(v for v in self._traffic.vehicles if v.name in flow.classes),
        )
        variant = f"{kind.name}.{crc32(track.name.encode()) % kind.variants}"
        self._world.add(track.name, flow.name, variant, track.length, track.width, float(track.v[0]))
        self._world.take(track.name)
        self._there.append(track)

    def _stays(self, track: Track) -> bool:
        """Whether the vehicle is still the recording's, or driven by somebody else; removes it at its end."""
        if self._world.is_commanded(track.name):
            return True
        if self._world.owns(track.name) and self._k > track.last:
            self._world.remove(track.name)
        return self._world.owns(track.name)


def _flow(traffic: Traffic, name: str) -> Flow:
    for flow in traffic.flows:
        if flow.name == name:
            return flow
    raise InputError(f"background.flows: got {name!r}, the traffic has {', '.join(f.name for f in traffic.flows)}")
