"""Lane-change requests in SUMO's model LC2013: which vehicle asks which other one to make room.

SUMO does not report to which vehicle a request goes. In LC2013, a vehicle that urgently wants to change lanes and is
blocked there asks the next vehicle behind in that lane to slow down, and a slower vehicle ahead in that lane to let
itself be overtaken. If it cannot or need not overtake the vehicle ahead, it already keeps a distance to it and will
drive behind it: that vehicle is its target.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.sumo import Drivers
from cosim.world.snapshot import LaneChange, LaneTraffic

URGENT = int(LaneChange.URGENT)  # as plain integers, which are faster
SIDES = tuple(
    (int(wish), int(follower), int(leader))
    for wish, follower, leader in (
        (LaneChange.LEFT, LaneChange.BLOCKED_BY_LEFT_FOLLOWER, LaneChange.BLOCKED_BY_LEFT_LEADER),
        (LaneChange.RIGHT, LaneChange.BLOCKED_BY_RIGHT_FOLLOWER, LaneChange.BLOCKED_BY_RIGHT_LEADER),
    )
)
SAME_LANE = 1.0  # [m] of lateral distance between lanes that continue each other


@dataclass(frozen=True)
class LaneChangeEvent:
    """A lane change that SUMO made: the vehicle, the indices of both lanes, and the lane-change state behind it."""

    vehicle: str
    from_lane: int
    to_lane: int
    state: int
    new_follower: str
    """Id of the vehicle behind it in the new lane; "" if there is none near."""


@dataclass(frozen=True)
class LaneChangeRequests:
    """Effects of urgent wishes to change lanes on other vehicles, by row of a `LaneTraffic`."""

    requesters: dict[int, str]
    """Row of each vehicle that is asked to make room -> id of the vehicle that asks it; of several, the nearest."""
    targets: dict[int, tuple[str, float]]
    """Row of each vehicle with an urgent wish -> id of the vehicle ahead in the wanted lane, and the gap to it [m]."""


def find_requests(drivers: Drivers, driving: LaneTraffic, candidates: Iterable[int]) -> LaneChangeRequests:
    """The requests and targets of the candidates (rows), and of the vehicles that they ask, which may ask others."""
    asked: dict[int, tuple[float, str]] = {}
    targets: dict[int, tuple[str, float]] = {}
    rows = driving.row_of
    waiting = sorted(candidates)
    queued = set(waiting)
    for row in waiting:  # grows in the loop
        vehicle = driving.ids[row]
        for to_left, (wish, follower, leader) in zip((True, False), SIDES, strict=True):
            state = drivers.lane_change_state(vehicle, to_left)
            if not (state & URGENT and state & wish):
                continue
            others = [drivers.neighbour(vehicle, to_left, ahead=False)] if state & follower else []
            target, gap = drivers.neighbour(vehicle, to_left, ahead=True)
            if target in rows:
                targets[row] = target, gap
                if state & leader and driving.v[row] > driving.v[rows[target]]:
                    others.append((target, gap))
            for other, distance in others:
                at = rows.get(other)
                if at is not None and distance < asked.get(at, (np.inf, ""))[0]:
                    asked[at] = distance, vehicle
                    if at not in queued:
                        queued.add(at)
                        waiting.append(at)
    return LaneChangeRequests({row: requester for row, (_, requester) in asked.items()}, targets)


def follower_row(driving: LaneTraffic, vehicle: str, centres: Sequence[float]) -> int | None:
    """Row of the vehicle that follows `vehicle` in its lane; None without one.

    `centres` [m] are the lateral positions of the lanes. The follower may still be on an earlier edge of the lane.
    """
    if vehicle not in driving.row_of:
        return None
    own = centres[driving.lane[driving.row_of[vehicle]]]
    followers = [row for row, leader in enumerate(driving.leader) if leader == vehicle]
    return next((row for row in followers if abs(centres[driving.lane[row]] - own) < SAME_LANE), None)


def secure_gap_margin(drivers: Drivers, driving: LaneTraffic, follower: int, leader: int) -> float:
    """Gap between two vehicles (rows) minus the secure gap of the following driver [m]."""
    behind, ahead = driving.ids[follower], driving.ids[leader]
    secure = drivers.secure_gap(behind, driving.v[follower], ahead, driving.v[leader], drivers.braking(ahead))
    return driving.gap[follower] - secure
