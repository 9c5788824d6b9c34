"""What a driver finds, wants and needs behind the vehicle ahead: headways, and the braking to stay behind it."""

import math
from dataclasses import dataclass

CLEARANCE, TOUCHING = 1.0, 0.01  # [m] that a driver who must brake keeps to the vehicle ahead; nearer is a contact
SHORTEST_TIME = 0.3  # [s], the shortest time headway that a driver accepts
NOTICED = 1.0  # [m/s²] of required braking, from which on it counts


@dataclass(frozen=True)
class Headway:
    """What a driver wants to keep to the vehicle ahead: a time headway `time` [s] and a minimum gap `gap` [m]."""

    time: float
    gap: float


@dataclass(frozen=True)
class Ahead:
    """What is ahead: the net gap [m] to it, its speed v [m/s] and its acceleration a [m/s²]."""

    gap: float
    v: float
    a: float


def found(own: Headway, v: float, ahead: Ahead) -> Headway:
    """The headway of a vehicle at the speed `v` [m/s] behind another; at most the driver's own.

    Where the gap closes, it is the one that is left after NOTICED braking.
    """
    gap = max(ahead.gap - max(v - ahead.v, 0.0) ** 2 / (2 * NOTICED), 0.0)
    minimum = min(own.gap, 0.5 * gap)
    return Headway(min(own.time, max((gap - minimum) / max(min(v, ahead.v), 1.0), SHORTEST_TIME)), minimum)


def required_braking(v: float, ahead: Ahead | None) -> float:
    """The constant braking [m/s²] with which a vehicle at the speed `v` [m/s] stays behind the one ahead.

    The vehicle ahead goes on braking as now, to a standstill. Infinite where both touch.
    """
    if ahead is None:
        return 0.0
    if ahead.gap < TOUCHING:
        return math.inf
    room = max(ahead.gap - CLEARANCE, 0.5 * ahead.gap)
    closing, braking = v - ahead.v, max(-ahead.a, 0.0)
    if closing > 0 and 2 * room * braking < closing * ahead.v:  # equally fast before the one ahead stands
        return braking + closing**2 / (2 * room)
    stopping_distance = 0.0 if ahead.v == 0 else ahead.v**2 / (2 * braking) if braking > 0 else math.inf
    return v**2 / (2 * (room + stopping_distance))
