"""The planning of the gradual hand-back: headways, braking, jerk, the drift to the centre of the lane."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.loop.gradual_hand_back import (
    EMERGENCY_JERK,
    FIRM_JERK,
    HARDEST_BRAKING,
    LATERAL_SPEED,
    Drift,
    Stop,
    next_acceleration,
    relaxed,
    wanted_acceleration,
)
from cosim.measures.following import SHORTEST_TIME, Ahead, Headway, found, required_braking

DT = 0.2
OWN = Headway(1.4, 2.0)


def follow(v: float, gap: float, leader_speed: list[float], own: Headway = OWN) -> np.ndarray:
    """Columns gap, v, a of a driver that takes over at `gap` [m], behind a leader with these speeds [m/s]."""
    headway, a, rows = found(own, v, Ahead(gap, leader_speed[0], 0.0)), 0.0, []
    for before, now in pairwise(leader_speed):
        ahead = Ahead(gap, before, (now - before) / DT)
        headway = relaxed(headway, own, DT)
        wanted = wanted_acceleration(v, 30.0, 2.0, headway, ahead)
        a = next_acceleration(a, wanted, required_braking(v, ahead), DT)
        following = max(v + a * DT, 0.0)
        a, v = (following - v) / DT, following
        gap += DT * (now - v)
        rows.append((gap, v, a))
    return np.array(rows)


def test_the_headway_that_is_found_is_wanted_and_grows_to_the_own_one():
    headway = found(OWN, 10.0, Ahead(8.0, 10.0, 0.0))
    assert headway == Headway(0.6, 2.0)
    assert found(OWN, 10.0, Ahead(1.0, 10.0, 0.0)) == Headway(SHORTEST_TIME, 0.5)
    assert found(OWN, 10.0, Ahead(40.0, 10.0, 0.0)) == OWN
    assert found(OWN, 10.0, Ahead(8.0, 8.0, 0.0)) == Headway(0.5, 2.0)  # 2 m less when both are equally fast
    seconds = 0.0
    while headway != OWN:
        headway, seconds = relaxed(headway, OWN, DT), seconds + DT
    assert seconds == pytest.approx(8.0, abs=0.21)  # 0.8 s of headway at 0.1 s per second


@pytest.mark.parametrize("gap", [4.0, 8.0, 12.0, 30.0])
def test_behind_a_steady_leader_nobody_brakes_hard_and_the_own_headway_is_reached(gap):
    rows = follow(10.0, gap, [10.0] * 300)
    assert rows[:, 2].min() > -1.5
    assert np.abs(np.diff(rows[:, 2])).max() / DT <= 5.0 + 1e-6
    assert rows[-1, 0] == pytest.approx(2.0 + 1.4 * 10.0, abs=0.5)


@pytest.mark.parametrize("gap", [4.0, 8.0])
def test_a_short_headway_is_no_danger_when_the_leader_stops_at_its_limit(gap):
    """The leader brakes at 3.5 m/s² to a standstill one second after the hand-back."""
    speeds = [10.0] * 5 + [max(10.0 - 0.7 * k, 0.0) for k in range(60)]
    rows = follow(10.0, gap, speeds)
    assert rows[:, 0].min() > 0.3
    assert rows[:, 2].min() > -6.0
    assert rows[-1, 1] < 0.05


speeds = st.floats(0, 40)


@given(
    a=st.floats(-9, 4),
    v=speeds,
    gap=st.floats(-2, 100),
    leader=speeds,
    a_leader=st.floats(-9, 4),
    limit=st.floats(0, 40),
)
def test_acceleration_and_jerk_are_bounded_whatever_is_ahead(a, v, gap, leader, a_leader, limit):
    ahead = Ahead(gap, leader, a_leader)
    required = required_braking(v, ahead)
    wanted = wanted_acceleration(v, limit, 2.0, found(OWN, v, ahead), ahead)
    assert -HARDEST_BRAKING <= wanted <= 2.0
    jerk = (next_acceleration(a, wanted, required, DT) - a) / DT
    assert abs(jerk) <= (FIRM_JERK if required < 5.0 else EMERGENCY_JERK) + 1e-6


@given(offset=st.floats(-1.8, 1.8), rate=st.floats(-0.6, 0.6))
def test_the_drift_has_no_jump_and_ends_in_the_centre(offset, rate):
    drift = Drift(offset, rate)
    time = np.arange(0, drift.duration + 1, 0.01)
    d = np.array([drift.at(t) for t in time])
    speed = np.diff(d) / 0.01
    assert d[0] == pytest.approx(offset, abs=1e-9)
    assert speed[0] == pytest.approx(rate, abs=0.03)
    assert np.abs(speed).max() <= LATERAL_SPEED + abs(rate) + 1e-3
    assert np.abs(np.diff(speed)).max() / 0.01 < 1.5  # [m/s²]
    assert np.abs(d[time >= drift.duration]).max() < 1e-9


@pytest.mark.parametrize(("v", "a", "braking"), [(15.0, 1.0, 8.0), (15.0, -9.0, 4.0), (2.0, 0.0, 3.5), (0.0, 0.0, 8.0)])
def test_a_vehicle_that_must_stop_brakes_as_told_and_stays(v, a, braking):
    stop = Stop(s=100.0, d=-2.0, heading=0.1, v=v, a=a, braking=braking, jerk=30.0)
    states = [stop]
    for _ in range(50):
        states.append(states[-1].after(DT))
    speed = np.array([state.v for state in states])
    assert (np.diff(speed) >= -max(braking, -a) * DT - 1e-9).all()
    assert speed[-1] == 0
    s = np.array([state.s for state in states])
    np.testing.assert_allclose(np.diff(s), 0.5 * (speed[1:] + speed[:-1]) * DT, rtol=0.006)
    assert s[-1] - 100.0 <= v**2 / (2 * min(braking, 3.5)) + v * 0.5
    assert states[-1] == states[-2].after(DT)
    assert abs(states[-1].heading) < 1e-3
