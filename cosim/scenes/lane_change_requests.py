"""Who asks whom to make room for a lane change, as SUMO's model LC2013 does it, and what lane changes do to others.

SUMO does not tell to whom a request goes. It goes from who urgently wants to a lane, and is blocked there, to the next
vehicle behind, which is to slow down, and to a slower one ahead, which is to let itself be overtaken. Who cannot or
need not overtake the one ahead there keeps a distance to it already: it will drive behind it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.sumo import Drivers
from cosim.world.snapshot import Driving, LaneChange

URGENT = int(LaneChange.URGENT)  # as plain numbers, which are faster
SIDES = tuple(
    (int(wish), int(behind), int(ahead))
    for wish, behind, ahead in (
        (LaneChange.LEFT, LaneChange.BLOCKED_BY_LEFT_FOLLOWER, LaneChange.BLOCKED_BY_LEFT_LEADER),
        (LaneChange.RIGHT, LaneChange.BLOCKED_BY_RIGHT_FOLLOWER, LaneChange.BLOCKED_BY_RIGHT_LEADER),
    )
)
SAME_LANE = 1.0  # [m] of lateral distance between lanes that continue each other


@dataclass(frozen=True)
class Change:
    """A lane change: of whom, from which of the lanes to which, and the lane-change state it was decided in."""

    vehicle: str
    source: int
    target: int
    state: int
    behind: str
    """Who drives behind it in the new lane; "": nobody near."""


@dataclass(frozen=True)
class LaneChangeRequests:
    """What comes of urgent wishes to change lanes, by row of a `Driving`."""

    askers: dict[int, str]
    """By whom a vehicle is asked; of several by the nearest."""
    targets: dict[int, tuple[str, float]]
    """Behind whom a vehicle that urgently wants to another lane would drive there, and the gap to it [m]."""


def find_requests(drivers: Drivers, driving: Driving, candidates: Iterable[int]) -> LaneChangeRequests:
    """Who asks whom, and who wants to drive behind whom, of the candidates and, as helpers may ask too, the asked."""
    asked: dict[int, tuple[float, str]] = {}
    targets: dict[int, tuple[str, float]] = {}
    rows = driving.where
    waiting = sorted(candidates)
    seen = set(waiting)
    for row in waiting:  # grows
        vehicle = driving.ids[row]
        for to_left, (wish, behind, ahead) in zip((True, False), SIDES, strict=True):
            state = drivers.lane_change_state(vehicle, to_left)
            if not (state & URGENT and state & wish):
                continue
            others = [drivers.neighbour(vehicle, to_left, ahead=False)] if state & behind else []
            target, gap = drivers.neighbour(vehicle, to_left, ahead=True)
            if target in rows:
                targets[row] = target, gap
                if state & ahead and driving.v[row] > driving.v[rows[target]]:
                    others.append((target, gap))
            for other, distance in others:
                at = rows.get(other)
                if at is not None and distance < asked.get(at, (np.inf, ""))[0]:
                    asked[at] = distance, vehicle
                    if at not in seen:
                        seen.add(at)
                        waiting.append(at)
    return LaneChangeRequests({row: asker for row, (_, asker) in asked.items()}, targets)


def new_follower(driving: Driving, vehicle: str, centres: Sequence[float]) -> int | None:
    """Row of who drives behind a vehicle in its lane, wherever that began; `centres` [m] are those of the lanes."""
    if vehicle not in driving.where:
        return None
    own = centres[driving.lane[driving.where[vehicle]]]
    followers = [row for row, leader in enumerate(driving.leader) if leader == vehicle]
    return next((row for row in followers if abs(centres[driving.lane[row]] - own) < SAME_LANE), None)


def room(drivers: Drivers, driving: Driving, behind: int, own: int) -> float:
    """What is left of the gap between two vehicles beyond the one the rear driver holds to be secure [m]."""
    rear, front = driving.ids[behind], driving.ids[own]
    secure = drivers.secure_gap(rear, driving.v[behind], front, driving.v[own], drivers.braking(front))
    return driving.gap[behind] - secure
