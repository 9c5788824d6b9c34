"""What traffic does in the study area, recorded once a second; hard braking, contacts and lost vehicles in every step.

All figures of a run with shares are made from the `Recording` (cosim/measures/traffic_measures.py).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
import pandas as pd

from cosim.loop.traffic_history import TrafficHistory
from cosim.measures.surrogate_safety import net_gap, time_to_collision
from cosim.measures.traffic_measures import HARD_BRAKING, LONG_STANDING
from cosim.sumo import Sumo
from cosim.sumo.emissions import SUBSTANCES, emission_rates
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import Snapshot, StepReport

REPEATED = 10.0  # [s] within which SUMO's reports of the same two vehicles are one contact


@dataclass(frozen=True)
class TrafficEvent:
    """A contact, a lost or teleported vehicle, or a policy that failed; `time` [s], `vehicles` who took part."""

    time: float
    kind: str
    vehicles: tuple[str, ...]
    detail: str = ""


@dataclass(frozen=True)
class Recording:
    """What was recorded. `samples`: a row per vehicle in the study area and second (docs/reference/run-tables.md).

    `brakings` counts, per vehicle, how often it began to brake harder than each of HARD_BRAKING.
    """

    samples: pd.DataFrame
    brakings: pd.DataFrame
    events: tuple[TrafficEvent, ...]


@dataclass
class TrafficRecorder:
    """Records the traffic on these edges, the first `length` [m] of the road; `driver_of` names who drives whom."""

    world: Sumo
    frame: RoadFrame
    length: float
    lanes: dict[str, int]
    driver_of: dict[str, str]
    events: list[TrafficEvent] = field(default_factory=list)
    _parts: list[dict[str, object]] = field(default_factory=list)
    _brakings: dict[str, list[int]] = field(default_factory=dict)
    _touching: dict[tuple[str, ...], float] = field(default_factory=dict)
    _standing_since: dict[str, tuple[str, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._inside = np.zeros(0, dtype=bool)  # by column of the history
        self._was_braking: list[np.ndarray] = [np.zeros(0, dtype=bool) for _ in HARD_BRAKING]

    def second(self, history: TrafficHistory) -> None:
        """Record the vehicles that are in the study area now."""
        now = self.world.snapshot(self.frame)
        edge = [lane.rpartition("_")[0] for lane in now.lane]
        rows = np.flatnonzero(
            (now.s >= 0) & (now.s < self.length) & np.array([name in self.lanes for name in edge], dtype=bool)
        )
        ids = [now.ids[row] for row in rows.tolist()]
        self._find_lost(now)
        self._inside[:] = False
        self._inside[[history.column_of[vehicle] for vehicle in ids]] = True
        lane = np.array([self.lanes[edge[row]] - int(now.lane[row].rpartition("_")[2]) for row in rows.tolist()], int)
        rates = emission_rates(ids)
        self._parts.append(
            {
                "time": np.full(len(rows), now.time),
                "vehicle": ids,
                "lane": lane,
                "x": now.s[rows],
                "v": now.v[rows],
                "a": now.a[rows],
                "length": now.length[rows],
                **_towards_next(now.s[rows], now.v[rows], now.length[rows], lane),
                **{name: rates[:, k] for k, name in enumerate(SUBSTANCES)},
            }
        )

    def step(
        self, history: TrafficHistory, report: StepReport, departed_now: Sequence[str], left: Sequence[str]
    ) -> None:
        """Note contacts, lost vehicles and hard braking of one step."""
        time = report.time
        for pair in dict.fromkeys(tuple(sorted(pair)) for pair in report.collisions):
            if time - self._touching.get(pair, -REPEATED) >= REPEATED:
                self.events.append(TrafficEvent(time, "contact", pair))
            self._touching[pair] = time
        for vehicle in report.teleported:
            self.events.append(TrafficEvent(time, "misplaced", (vehicle,), "teleported by SUMO"))
        gone = set(left) - set(report.arrived) - set(report.teleported)
        self.events += [TrafficEvent(time, "misplaced", (v,), "vanished without having arrived") for v in sorted(gone)]
        size = len(history.a)
        if size > len(self._inside):
            more = size - len(self._inside)
            self._inside = np.pad(self._inside, (0, more))
            self._was_braking = [np.pad(was, (0, more)) for was in self._was_braking]
        new = [history.column_of[vehicle] for vehicle in departed_now]
        self._inside[new] = False
        for k, threshold in enumerate(HARD_BRAKING):
            braking = history.a < -threshold
            began = braking & ~self._was_braking[k] & self._inside
            self._was_braking[k] = braking
            if began.any():
                which = set(np.flatnonzero(began).tolist())
                for vehicle, column in history.column_of.items():
                    if column in which:
                        self._brakings.setdefault(vehicle, [0] * len(HARD_BRAKING))[k] += 1

    def _find_lost(self, now: Snapshot) -> None:
        """Note vehicles that are on no lane, and those that have stood at one place for LONG_STANDING."""
        for vehicle, lane, v in zip(now.ids, now.lane, now.v.tolist(), strict=True):
            if not lane:
                self.events.append(TrafficEvent(now.time, "misplaced", (vehicle,), "on no lane"))
            if v > 0.1:
                self._standing_since.pop(vehicle, None)
                continue
            _, since = self._standing_since.setdefault(vehicle, (lane, now.time))
            if now.time - since == LONG_STANDING:
                self.events.append(TrafficEvent(now.time, "stuck", (vehicle,), f"{LONG_STANDING:g} s on lane {lane}"))

    def recording(self) -> Recording:
        """All that was recorded."""
        names = list(self._parts[0]) if self._parts else []
        columns = {
            name: [*chain.from_iterable(part[name] for part in self._parts)]  # type: ignore[arg-type]
            if name == "vehicle"
            else np.concatenate([part[name] for part in self._parts])  # type: ignore[arg-type]
            for name in names
        }
        samples = pd.DataFrame(columns)
        samples.insert(2, "driver", samples["vehicle"].map(self.driver_of).fillna("sumo"))
        counts = [f"brakings_{threshold:g}" for threshold in HARD_BRAKING]
        brakings = pd.DataFrame.from_dict(self._brakings, orient="index", columns=counts)
        return Recording(samples, brakings.rename_axis("vehicle").reset_index(), tuple(self.events))


def _towards_next(s: np.ndarray, v: np.ndarray, length: np.ndarray, lane: np.ndarray) -> dict[str, np.ndarray]:
    """Gap [m] and time to collision [s] of each vehicle to the next one ahead in its lane; +inf for nobody."""
    order = np.lexsort((s, lane))
    gap, ttc = np.full(len(s), np.inf), np.full(len(s), np.inf)
    behind, ahead = order[:-1], order[1:]
    same = lane[behind] == lane[ahead]
    behind, ahead = behind[same], ahead[same]
    gap[behind] = net_gap(s[behind], s[ahead], length[ahead])
    ttc[behind] = time_to_collision(gap[behind], v[behind], v[ahead])
    return {"gap": gap, "ttc": ttc}
