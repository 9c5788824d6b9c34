"""A recording as the surrounding traffic: every vehicle moves as it was recorded, until a policy drives it.

`recorded_tracks` reads the recording. A vehicle that a policy drove and handed back stays with SUMO's driver. Where the
scenario says so, those behind react (`reacting_vehicles`).
"""

from collections import defaultdict
from zlib import crc32

import numpy as np
from msgspec.structs import replace

from cosim.spec.demand import Flow, Traffic
from cosim.spec.scenario import Replay
from cosim.sumo import Sumo
from cosim.traffic.reacting_vehicles import ReactingVehicles, Release
from cosim.traffic.recorded_track import RecordedTrack
from cosim.world.road_frame import RoadFrame
from gri.errors import InputError


def without_demand(traffic: Traffic) -> Traffic:
    """The traffic's drivers and routes with no vehicles on them, no bottleneck and no warm-up."""
    flows = tuple(replace(flow, per_hour=(0.0,)) for flow in traffic.flows)
    return replace(traffic, flows=flows, warm_up=0.0, bottleneck=None)


class RecordedVehicles:
    """Moves the recorded vehicles; `move` is called before every step of the simulation.

    Raises InputError where `background.flows` names a flow that the traffic does not have.
    """

    def __init__(
        self,
        world: Sumo,
        road: RoadFrame,
        tracks: tuple[RecordedTrack, ...],
        step: float,
        background: Replay,
        traffic: Traffic,
    ) -> None:
        self._world, self._road, self._step = world, road, step
        self._flows = {lane: _flow(traffic, flow) for lane, flow in background.flows.items()}
        self._traffic = traffic
        self._starting: dict[int, list[RecordedTrack]] = defaultdict(list)
        for track in tracks:
            self._starting[track.first_step].append(track)
        self._present: list[RecordedTrack] = []
        self._steps = 0
        self._reacting = ReactingVehicles(world, road, tracks, step) if background.react else None

    @property
    def releases(self) -> tuple[Release, ...]:
        """The vehicles that were released to car following, in the order of time; none where nobody is to react."""
        return () if self._reacting is None else tuple(self._reacting.releases)

    def present_for(self, duration: float) -> frozenset[str]:
        """The vehicles whose recording lasts for at least `duration` [s] more."""
        wanted = self._steps + round(duration / self._step)
        return frozenset(track.name for track in self._present if track.last_step >= wanted)

    def move(self) -> None:
        """Command every vehicle to its recorded pose one step from now; insert and remove vehicles at their times.

        A vehicle that has a command already, from a policy, is left alone.
        """
        reacting = self._reacting
        now = None if reacting is None else reacting.look([t for t in self._present if not self._is_recorded(t.name)])
        self._steps += 1
        for track in self._starting.pop(self._steps, ()):
            self._insert(track)
        before = {track.name for track in self._present if self._world.is_taken(track.name)}
        self._present = [track for track in self._present if self._stays(track)]
        recorded = [track for track in self._present if not self._world.is_commanded(track.name)]
        if reacting is not None and now is not None:
            left = before - {track.name for track in self._present}
            recorded = reacting.move(now.only(np.array([v not in left for v in now.ids])), self._steps, recorded)
        rows = [(track, self._steps - track.first_step) for track in recorded]
        if not rows:
            return
        s, d, heading, v = (np.array([getattr(track, n)[k] for track, k in rows]) for n in ("s", "d", "heading", "v"))
        xy, along = self._road.to_world(s, d)
        for (track, _), (x, y, angle, speed) in zip(
            rows, np.column_stack([xy, along + heading, v]).tolist(), strict=True
        ):
            self._world.command(track.name, x, y, angle, speed)

    def _insert(self, track: RecordedTrack) -> None:
        flow = self._flows.get(track.lane, self._traffic.flows[0])
        kind = next(
            (v for v in self._traffic.vehicles if v.name in flow.classes and (v.v_class == "truck") == track.truck),
            next(v for v in self._traffic.vehicles if v.name in flow.classes),
        )
        variant = f"{kind.name}.{crc32(track.name.encode()) % kind.variants}"
        self._world.add(track.name, flow.name, variant, track.length, track.width, float(track.v[0]))
        self._world.take(track.name)
        self._present.append(track)

    def _is_recorded(self, vehicle: str) -> bool:
        """Whether the recording moves the vehicle in the coming step: no policy commands it, SUMO does not drive it."""
        return self._world.is_taken(vehicle) and not self._world.is_commanded(vehicle)

    def _stays(self, track: RecordedTrack) -> bool:
        """Whether the vehicle still moves as recorded or as a policy commands; removes it at the end of its track."""
        if self._world.is_commanded(track.name):
            return True
        last = track.last_step
        if self._reacting is not None and self._reacting.has_released(track.name):
            last = self._reacting.last_step(track)
        if self._world.is_taken(track.name) and self._steps > last:
            self._world.remove(track.name)
        return self._world.is_taken(track.name)


def _flow(traffic: Traffic, name: str) -> Flow:
    for flow in traffic.flows:
        if flow.name == name:
            return flow
    raise InputError(f"background.flows: got {name!r}, the traffic has {', '.join(f.name for f in traffic.flows)}")
