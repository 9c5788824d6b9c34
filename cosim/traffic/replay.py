"""A recording as the surrounding traffic: every vehicle moves as it was recorded, until a policy drives it.

`recorded_tracks` reads the recording. A vehicle that a policy drove and handed back stays with SUMO's driver.
"""

from collections import defaultdict
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace

from cosim.spec.demand import Flow, Traffic
from cosim.spec.scenario import Replay
from cosim.sumo import Sumo
from cosim.world.road_frame import RoadFrame
from gri.errors import InputError


@dataclass(frozen=True)
class RecordedTrack:
    """One recorded vehicle in the road frame: one value per simulation step from `first_step` on.

    `s` and `d` [m] are the front bumper's coordinates, `heading` [rad] is relative to the road, `v` is in m/s.
    """

    name: str
    lane: int
    """Number of the lane in which the vehicle appears first."""
    truck: bool
    length: float
    width: float
    first_step: int
    s: Float[np.ndarray, " K"]
    d: Float[np.ndarray, " K"]
    heading: Float[np.ndarray, " K"]
    v: Float[np.ndarray, " K"]

    @property
    def last_step(self) -> int:
        """The last step at which the vehicle is present."""
        return self.first_step + len(self.s) - 1


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

    def present_for(self, duration: float) -> frozenset[str]:
        """The vehicles whose recording lasts for at least `duration` [s] more."""
        wanted = self._steps + round(duration / self._step)
        return frozenset(track.name for track in self._present if track.last_step >= wanted)

    def move(self) -> None:
        """Command every vehicle to its recorded pose one step from now; insert and remove vehicles at their times.

        A vehicle that has a command already, from a policy, is left alone.
        """
        self._steps += 1
        for track in self._starting.pop(self._steps, ()):
            self._insert(track)
        self._present = [track for track in self._present if self._stays(track)]
        rows = [
            (track, self._steps - track.first_step)
            for track in self._present
            if not self._world.is_commanded(track.name)
        ]
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

    def _stays(self, track: RecordedTrack) -> bool:
        """Whether the vehicle still moves as recorded or as a policy commands; removes it at the end of its track."""
        if self._world.is_commanded(track.name):
            return True
        if self._world.is_taken(track.name) and self._steps > track.last_step:
            self._world.remove(track.name)
        return self._world.is_taken(track.name)


def _flow(traffic: Traffic, name: str) -> Flow:
    for flow in traffic.flows:
        if flow.name == name:
            return flow
    raise InputError(f"background.flows: got {name!r}, the traffic has {', '.join(f.name for f in traffic.flows)}")
