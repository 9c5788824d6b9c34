"""Recorded vehicles that react to driven ones: replayed until they would come too close, then car following.

A vehicle *deviates* from the recording from the moment on at which something else than the recording moves it: a
policy, SUMO after the hand-back, or car following after its release. A replayed vehicle is released where all of this
holds for a deviating vehicle ahead:

- the boxes of both overlap across the road, now or on the recorded path of the next second;
- the one ahead is farther back than it was recorded at this time;
- to stay 1 m behind it, braking of `RELEASE_BRAKING` is needed, if the one ahead goes on braking as now.

From then on it keeps to its recorded path, at the speed that SUMO's car-following model and the parameters of its
driver allow behind the next vehicle on that path. It wants the headway that it finds, if that is shorter than its own.
Released vehicles deviate, so those behind them react as well. While no vehicle deviates, none is released.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from cosim.measures.following import Ahead, Headway, found, required_braking
from cosim.sumo import Sumo
from cosim.traffic.recorded_track import RecordedTrack
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot

RELEASE_BRAKING = 2.0  # [m/s²]; SUMO's drivers here brake with 3.5 at most unless there is an emergency
HARDEST_BRAKING = 9.0  # [m/s²], what a dry road allows
LOOK_AHEAD = 1.0  # [s] of its recorded path on which a vehicle looks for others
PLACES = 6  # on that path at which it looks
FARTHER_BACK = 0.01  # [m] behind its recorded place, from which on a vehicle hinders others


@dataclass(frozen=True)
class Release:
    """A recorded vehicle that was released at `time` [s] behind `ahead`; `root` is the driven vehicle that began it."""

    time: float
    vehicle: str
    ahead: str
    root: str


@dataclass(frozen=True)
class _Released:
    """A released vehicle on its path: its place s [m], speed v [m/s] and the headway that it wants."""

    track: RecordedTrack
    s: float
    v: float
    headway: Headway


class ReactingVehicles:
    """Decides which of the `tracks` are released, and moves those that are; `step` [s] is the simulation's."""

    def __init__(self, world: Sumo, road: RoadFrame, tracks: Sequence[RecordedTrack], step: float) -> None:
        self._world, self._road, self._dt = world, road, step
        self._tracks = {track.name: track for track in tracks}
        self._ends: dict[str, int] = {}  # last step of each recording
        for track in tracks:
            self._ends[_recording(track)] = max(track.last_step, self._ends.get(_recording(track), 0))
        self._roots: dict[str, str] = {}  # of each deviating vehicle: the driven vehicle that began it
        self._released: dict[str, _Released] = {}
        self.releases: list[Release] = []

    def has_released(self, vehicle: str) -> bool:
        """Whether a vehicle has been released."""
        return vehicle in self._released

    def last_step(self, track: RecordedTrack) -> int:
        """The last step at which a released vehicle is present: it leaves where it was recorded last, or with all.

        A vehicle that is late does not vanish on its way, where it hides those ahead of it from others.
        """
        state = self._released[track.name]
        return 0 if state.s > float(track.s[-1]) else self._ends[_recording(track)]

    def look(self, others: Sequence[RecordedTrack]) -> Snapshot | None:
        """What is on the road before a step in which others move these vehicles; None while nobody deviates.

        To be called before vehicles are added in this step, which are not on the road yet.
        """
        for track in others:
            self._roots.setdefault(track.name, track.name)
            self._released.pop(track.name, None)
        return self._world.snapshot(self._road) if self._roots else None

    def move(self, now: Snapshot, steps: int, recorded: Sequence[RecordedTrack]) -> list[RecordedTrack]:
        """Command the released vehicles, also those that are released now, for the step number `steps`.

        `recorded` are the tracks of vehicles that nobody else commands. Returns those that go on as recorded.
        """
        self._roots = {vehicle: root for vehicle, root in self._roots.items() if vehicle in now.row_of}
        self._released = {vehicle: state for vehicle, state in self._released.items() if vehicle in now.row_of}
        hindering = np.array([self._is_farther_back(vehicle, now, steps - 1) for vehicle in now.ids], dtype=bool)
        if hindering.any():
            for track in recorded:
                if track.name in now.row_of and track.name not in self._released:
                    self._release_if_needed(track, now, hindering, steps - 1)
        for track in recorded:
            if track.name in self._released:
                self._follow(track.name, now)
        return [track for track in recorded if track.name not in self._released]

    def _is_farther_back(self, vehicle: str, now: Snapshot, step: int) -> bool:
        """Whether a vehicle deviates and is behind its recorded place, or is where it was not recorded any more."""
        if vehicle not in self._roots:
            return False
        track = self._tracks[vehicle]
        recorded = step - track.first_step
        return recorded >= len(track.s) or bool(now.s[now.row_of[vehicle]] < track.s[recorded] - FARTHER_BACK)

    def _release_if_needed(
        self, track: RecordedTrack, now: Snapshot, hindering: Bool[np.ndarray, " V"], step: int
    ) -> None:
        row = now.row_of[track.name]
        path = track.d[step - track.first_step :][: round(LOOK_AHEAD / self._dt) + 1]
        ahead = hindering & _on_path(now, row, path)
        for other in sorted(np.flatnonzero(ahead).tolist(), key=lambda other: (now.s[other], now.ids[other])):
            found_ahead = _ahead(now, row, other)
            if required_braking(float(now.v[row]), found_ahead) < RELEASE_BRAKING:
                continue
            own = Headway(*self._world.drivers.headway(track.name))
            headway = found(own, float(now.v[row]), found_ahead)
            self._world.set_headway(track.name, headway.time, headway.gap)
            self._released[track.name] = _Released(track, float(now.s[row]), float(now.v[row]), headway)
            root = self._roots[now.ids[other]]
            self._roots[track.name] = root
            self.releases.append(Release(now.time, track.name, now.ids[other], root))
            return

    def _follow(self, vehicle: str, now: Snapshot) -> None:
        """Command a released vehicle: its recorded path, at the speed of its car-following model."""
        state, row, drivers = self._released[vehicle], now.row_of[vehicle], self._world.drivers
        track, v = state.track, state.v
        along = np.maximum.accumulate(track.s)
        d = np.interp(state.s + v * np.linspace(0.0, LOOK_AHEAD, PLACES), along, track.d)
        others = np.flatnonzero(_on_path(now, row, d))
        wanted, braking = drivers.allowed_speed(vehicle), drivers.braking(vehicle)
        if len(others):
            gaps = now.s[others] - now.length[others] - state.s
            nearest = int(others[gaps.argmin()])
            ahead = _ahead(now, row, nearest)
            room = ahead.gap - state.headway.gap
            wanted = min(wanted, drivers.follow_speed(vehicle, v, room, ahead.v, drivers.braking(now.ids[nearest])))
            braking = min(max(braking, required_braking(v, ahead)), HARDEST_BRAKING)
        acceleration = drivers.parameters(vehicle).acceleration
        speed = max(min(wanted, v + acceleration * self._dt), v - braking * self._dt, 0.0)
        s = state.s + speed * self._dt
        at = np.array([s]), np.array([float(np.interp(s, along, track.d))])
        xy, heading = self._road.to_world(*at)
        turned = float(np.interp(s, along, track.heading))
        self._world.command(vehicle, float(xy[0, 0]), float(xy[0, 1]), float(heading[0]) + turned, speed)
        self._released[vehicle] = replace(state, s=s, v=speed)


def _recording(track: RecordedTrack) -> str:
    return track.name.rpartition("/")[0]


def _on_path(now: Snapshot, row: int, path: Float[np.ndarray, " P"]) -> Bool[np.ndarray, " V"]:
    """The vehicles ahead of one whose boxes overlap, across the road, its box somewhere on its path (d [m])."""
    apart = 0.5 * (now.width + now.width[row])
    in_way = (np.abs(now.d[:, None] - path) < apart[:, None]).any(axis=1)
    return in_way & (now.s > now.s[row])


def _ahead(now: Snapshot, row: int, other: int) -> Ahead:
    gap = now.s[other] - now.length[other] - now.s[row]
    return Ahead(float(gap), float(now.v[other]), float(now.a[other]))
