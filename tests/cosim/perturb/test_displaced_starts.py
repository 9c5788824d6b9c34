"""Displaced starts and their feasibility, by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.perturb.displaced_starts import (
    BRAKING,
    CAR_FOLLOWING,
    MERGE,
    Infeasible,
    VehicleStates,
    collides_despite_braking,
    displaced,
    infeasibility,
)
from cosim.spec.perturbations import HeadwayMetres, HeadwayRatio, LeaderBraking, RemoveThird, SpeedOffset

LANE = 3.66
ROAD = np.array([[0.0, 640.0]] * 3)


def cars(*vehicles: tuple[float, float, float], length=5.0, width=1.8) -> VehicleStates:
    """Vehicles given by (s, d, v)."""
    s, d, v = np.array(vehicles, dtype=float).reshape(-1, 3).T
    return VehicleStates(s, d, v, np.full(len(s), length), np.full(len(s), width))


CHAIN = cars((100, 0, 10), (120, 0, 10), (140, 0, 10))
MERGING = cars((100, -LANE, 10), (90, 0, 10), (120, 0, 10))
NOBODY = cars()


def judged(
    after: VehicleStates, others=NOBODY, before=CHAIN, rule=CAR_FOLLOWING, present=(True, True, True), span=ROAD
):
    return infeasibility(before, after, others, present=np.array(present), span=span, rule=rule)


@pytest.mark.parametrize(
    ("spec", "s"),
    [
        (HeadwayRatio(intensity=0.5), [110, 120, 140]),
        (HeadwayRatio(intensity=1.2), [124, 120, 140]),
        (HeadwayRatio(intensity=-0.5), [90, 120, 140]),
        (HeadwayMetres(intensity=3.0), [103, 120, 140]),
        (RemoveThird(intensity=0.25), [105, 120, 140]),
        (LeaderBraking(intensity=4.0), [100, 120, 140]),
    ],
)
def test_displacements_of_a_chain(spec, s):
    assert displaced(CHAIN, (spec,), CAR_FOLLOWING).s.tolist() == s


def test_displacements_of_a_merge():
    """Vehicle 0 follows 2, 20 m ahead; without 2 it is the lag vehicle 1 that comes nearer, 10 m behind 0."""
    assert displaced(MERGING, (HeadwayRatio(intensity=1.5),), MERGE).s.tolist() == [130, 90, 120]
    assert displaced(MERGING, (RemoveThird(intensity=0.5),), MERGE).s.tolist() == [100, 95, 120]


def test_speeds_are_shifted_and_do_not_turn_negative():
    assert displaced(CHAIN, (SpeedOffset(intensity=3.0),), CAR_FOLLOWING).v.tolist() == [13, 10, 10]
    assert displaced(CHAIN, (SpeedOffset(intensity=-30.0),), CAR_FOLLOWING).v.tolist() == [0, 10, 10]


@given(st.floats(-1, 1), st.floats(0, 0.9))
def test_ratios_compose(first, second):
    """(1 − δ1)(1 − δ2)·Δx, in any order."""
    specs = [HeadwayRatio(intensity=delta) for delta in (first, second)]
    one, other = (displaced(CHAIN, order, CAR_FOLLOWING).s[0] for order in (specs, specs[::-1]))
    assert one == pytest.approx(other)
    assert 120 - one == pytest.approx((1 - first) * (1 - second) * 20)


def test_an_undisturbed_start_is_feasible_whatever_it_is():
    assert judged(CHAIN, others=cars((100, 0, 0))) is None


def moved(s0, v0=10.0):
    return cars((s0, 0, v0), (120, 0, 10), (140, 0, 10))


def test_a_start_in_another_vehicle_is_an_overlap():
    """The rear of 1 is at 115 m: 115 touches, 115.1 overlaps."""
    assert judged(moved(115)) is None
    assert judged(moved(115.1)) is Infeasible.OVERLAP
    assert judged(moved(80), others=cars((84.9, 0, 10))) is not None


def test_ahead_of_the_leader_in_one_lane_is_out_of_order():
    assert judged(moved(127)) is Infeasible.ORDER
    assert judged(moved(60), others=cars((90, 0, 10))) is Infeasible.ORDER  # somebody is in between now
    assert judged(moved(60), others=cars((90, LANE, 10))) is None


def test_a_merging_vehicle_may_start_ahead_of_its_leader():
    after = displaced(MERGING, (HeadwayRatio(intensity=1.5),), MERGE)
    assert judged(after, before=MERGING, rule=MERGE) is None
    assert judged(after, before=MERGING, rule=MERGE, others=cars((132, -LANE, 10))) is Infeasible.OVERLAP


def test_the_lane_ends():
    after = displaced(MERGING, (HeadwayRatio(intensity=1.5),), MERGE)
    short = np.array([[0.0, 125.0], [0, 640], [0, 640]])
    assert judged(after, before=MERGING, rule=MERGE, span=short) is Infeasible.OFF_ROAD
    assert judged(moved(-1)) is Infeasible.OFF_ROAD


def test_braking_cannot_help():
    """At 18 m/s behind 10 m/s the gap closes by 8²/(2·8) = 4 m: a gap of 3.9 m is too small, 4.1 m is not."""
    assert judged(moved(115 - 3.9, v0=18)) is Infeasible.UNAVOIDABLE
    assert judged(moved(115 - 4.1, v0=18)) is None


def test_the_vehicle_behind_counts_too():
    """Slowed down to 2 m/s in front of 10 m/s: the gap closes by 8 m in the first second, then by 8²/16 = 4 m."""
    after = moved(100, v0=2)
    assert judged(after, others=cars((100 - 5 - 11.9, 0, 10))) is Infeasible.UNAVOIDABLE
    assert judged(after, others=cars((100 - 5 - 12.1, 0, 10))) is None


def test_who_was_removed_is_in_nobodys_way():
    after = cars((100, 0, 10), (139, 0, 10), (140, 0, 10))
    assert judged(after) is Infeasible.OVERLAP
    assert judged(after, present=(True, True, False)) is None


def test_collides_despite_braking_agrees_with_the_closed_form():
    ahead = np.full(100, 10.0)
    assert collides_despite_braking(3.9, 18.0, ahead, 0.2)
    assert not collides_despite_braking(4.1, 18.0, ahead, 0.2)
    assert collides_despite_braking(0.5, 10.0, np.maximum(10 - 2 * BRAKING * 0.2 * np.arange(20), 0), 0.2)
