"""The gradual hand-back: SUMO's driver wants the headway that it gets and relaxes to its own over seconds.

A driver that takes over at a shorter headway than its own would brake at once. Human drivers accept a short headway
after a lane change and open it slowly (Laval and Leclercq 2008, "Microscopic modeling of the relaxation phenomenon").
So each vehicle that was handed back wants, at first, the time headway and the minimum gap that it finds. Both grow to
the driver's own values. Meanwhile the acceleration begins with the last one of the policy, its jerk is limited, and the
vehicle drifts to the centre of its lane. The functions here plan one vehicle; `returning_vehicles` carries it out.
"""

import math
from dataclasses import dataclass, replace

from cosim.measures.following import NOTICED, Ahead, Headway, required_braking

DURATION = 10.0  # [s] for which the jerk is limited at least
TIME_RATE, GAP_RATE = 0.1, 0.2  # [s/s] and [m/s], at which the wanted headway grows
PER_GAP, PER_SPEED, PER_ACCELERATION = 0.15, 0.6, 0.3  # [1/s²], [1/s], []: how the driver follows the vehicle ahead
COMFORTABLE_JERK, FIRM_JERK, EMERGENCY_JERK = 5.0, 9.0, 30.0  # [m/s³]
FIRM, EMERGENCY = 2.0, 5.0  # [m/s²] of required braking: from here on the jerk is larger
HARDEST_BRAKING = 9.0  # [m/s²], what a dry road allows
PLACES = 10  # of a drift that are looked at
LATERAL_SPEED, SHORTEST_DRIFT = 0.4, 3.0  # [m/s] at most, and [s] at least, for the drift to the centre of the lane


def relaxed(headway: Headway, own: Headway, dt: float) -> Headway:
    """The headway `dt` [s] later: nearer to the driver's own."""
    return Headway(min(headway.time + TIME_RATE * dt, own.time), min(headway.gap + GAP_RATE * dt, own.gap))


def wanted_acceleration(v: float, limit: float, acceleration: float, headway: Headway, ahead: Ahead | None) -> float:
    """Acceleration [m/s²] of a driver at the speed `v` [m/s] who may drive `limit` [m/s]; at most `acceleration`.

    On a free road, that of the intelligent driver model. Behind another vehicle, linear in the error of the gap, the
    difference of the speeds and the acceleration ahead; the required braking, if that is harder.
    """
    free = max(acceleration * (1 - (v / max(limit, 0.1)) ** 4), -NOTICED)
    if ahead is None:
        return free
    error = ahead.gap - headway.gap - headway.time * v
    follow = PER_GAP * error + PER_SPEED * (ahead.v - v) + PER_ACCELERATION * ahead.a
    required = required_braking(v, ahead)
    return max(min(free, follow, -required if required > NOTICED else math.inf), -HARDEST_BRAKING)


def next_acceleration(a: float, wanted: float, required: float, dt: float) -> float:
    """The acceleration [m/s²] after `dt` [s]: from `a` towards the wanted one, with a jerk as large as is needed."""
    jerk = COMFORTABLE_JERK if required < FIRM else FIRM_JERK if required < EMERGENCY else EMERGENCY_JERK
    return a + min(max(wanted - a, -jerk * dt), COMFORTABLE_JERK * dt)


@dataclass(frozen=True)
class Drift:
    """The way to the centre of the lane, from `offset` [m] to its left with the lateral speed `rate` [m/s].

    A polynomial of fifth degree: lateral position, speed and acceleration end at 0 after `duration` [s].
    """

    offset: float
    rate: float

    @property
    def duration(self) -> float:
        return max(1.875 * abs(self.offset) / LATERAL_SPEED, SHORTEST_DRIFT)

    def at(self, time: float) -> float:
        """The lateral position [m] `time` [s] after the start."""
        duration = self.duration
        u = min(time / duration, 1.0)
        way = 1 - 10 * u**3 + 15 * u**4 - 6 * u**5
        return self.offset * way + self.rate * duration * (u - 6 * u**3 + 8 * u**4 - 3 * u**5)

    def range_from(self, time: float) -> tuple[float, float]:
        """The rightmost and the leftmost lateral position [m] from `time` [s] on."""
        left = max(self.duration - time, 0.0)
        if not left:
            return self.at(time), self.at(time)
        places = [self.at(time + left * k / PLACES) for k in range(PLACES + 1)]
        return min(places), max(places)


@dataclass(frozen=True)
class Stop:
    """A vehicle that brakes to a standstill: s, d [m], heading relative to the road [rad], v [m/s], a [m/s²].

    It brakes with `braking` [m/s²] in the end, which grows by `jerk` [m/s³].
    """

    s: float
    d: float
    heading: float
    v: float
    a: float
    braking: float
    jerk: float

    def after(self, dt: float) -> "Stop":
        """The vehicle `dt` [s] later; it straightens out."""
        a = self.a + min(max(-self.braking - self.a, -self.jerk * dt), self.jerk * dt)
        v = max(self.v + a * dt, 0.0)
        way = 0.5 * (self.v + v) * dt
        s, d = self.s + way * math.cos(self.heading), self.d + way * math.sin(self.heading)
        return replace(self, s=s, d=d, heading=0.8 * self.heading, v=v, a=(v - self.v) / dt)
