"""Who asks whom to make room for a lane change, as SUMO's model LC2013 does it, and what lane changes do to others.

SUMO does not tell to whom a request goes. It goes from who urgently wants to a lane, and is blocked there, to the next
vehicle behind, which is to slow down, and to a slower one ahead, which is to let itself be overtaken.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cosim.snapshot import Driving, LaneChange
from cosim.sumo import Sumo

URGENT = int(LaneChange.URGENT)  # as plain numbers, which are faster
SIDES = tuple(
    (int(wish), int(behind), int(ahead))
    for wish, behind, ahead in (
        (LaneChange.LEFT, LaneChange.BLOCKED_BY_LEFT_FOLLOWER, LaneChange.BLOCKED_BY_LEFT_LEADER),
        (LaneChange.RIGHT, LaneChange.BLOCKED_BY_RIGHT_FOLLOWER, LaneChange.BLOCKED_BY_RIGHT_LEADER),
    )
)
NEAR = 40.0  # [m] from who urgently wants to change lanes; who helps it may have to ask others
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


def askers(world: Sumo, driving: Driving, restless: Sequence[int], s: Float[np.ndarray, " V"]) -> dict[int, str]:
    """By whom each row is asked; of several by the nearest.

    Who asks is restless, that is, must leave its lane, or is near one who urgently wants to, and helps; `s` [m] says
    where everybody is.
    """

    def states_of(rows: Iterable[int]) -> dict[int, tuple[int, int]]:
        ids = driving.ids
        return {
            row: (world.lane_change_state(ids[row], True), world.lane_change_state(ids[row], False)) for row in rows
        }

    states = states_of(restless)
    urgent = _urgent(states)
    if not urgent:
        return {}
    near = np.flatnonzero((np.abs(s - s[urgent, None]) < NEAR).any(0)).tolist()
    states |= states_of(set(near) - set(states))
    urgent = _urgent(states)
    found: dict[int, tuple[float, str]] = {}
    rows = {vehicle: row for row, vehicle in enumerate(driving.ids)}
    for row in urgent:
        for other, distance in _asked(world, driving, row, states[row], rows):
            if other in rows and distance < found.get(rows[other], (np.inf, ""))[0]:
                found[rows[other]] = distance, driving.ids[row]
    return {row: asker for row, (_, asker) in found.items()}


def _urgent(states: dict[int, tuple[int, int]]) -> list[int]:
    return sorted(row for row, (left, right) in states.items() if (left | right) & URGENT)


def _asked(
    world: Sumo, driving: Driving, row: int, states: tuple[int, int], rows: dict[str, int]
) -> Iterator[tuple[str, float]]:
    """Whom a vehicle asks, and how far away they are [m]."""
    vehicle = driving.ids[row]
    for to_left, state, (wish, behind, ahead) in zip((True, False), states, SIDES, strict=True):
        if not (state & URGENT and state & wish):
            continue
        if state & behind:
            yield world.neighbour(vehicle, to_left, ahead=False)
        if state & ahead:
            other, distance = world.neighbour(vehicle, to_left, ahead=True)
            if other in rows and driving.v[row] > driving.v[rows[other]]:
                yield other, distance


def now_behind(driving: Driving, vehicle: str, centres: Sequence[float]) -> int | None:
    """Row of who drives behind a vehicle in its lane, wherever that began; `centres` [m] are those of the lanes."""
    if vehicle not in driving.ids:
        return None
    own = centres[driving.lane[driving.ids.index(vehicle)]]
    followers = [row for row, leader in enumerate(driving.leader) if leader == vehicle]
    return next((row for row in followers if abs(centres[driving.lane[row]] - own) < SAME_LANE), None)


def room(world: Sumo, driving: Driving, behind: int, own: int) -> float:
    """What is left of the gap between two vehicles beyond the one the rear driver holds to be secure [m]."""
    rear, front = driving.ids[behind], driving.ids[own]
    secure = world.secure_gap(rear, driving.v[behind], front, driving.v[own], world.braking(front))
    return driving.gap[behind] - secure
