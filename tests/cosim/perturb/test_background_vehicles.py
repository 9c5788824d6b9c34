"""What perturbed background vehicles do, by hand."""

import numpy as np
import pytest

from cosim.perturb.background_vehicles import find_cut_in_vehicle, plan_braking, plan_cut_in
from cosim.perturb.displaced_starts import VehicleStates
from cosim.spec.perturbations import LeaderBraking, NeighbourCutIn

LANE = 3.66


def cars(*vehicles: tuple[float, float, float]) -> VehicleStates:
    s, d, v = np.array(vehicles, dtype=float).reshape(-1, 3).T
    return VehicleStates(s, d, v, np.full(len(s), 5.0), np.full(len(s), 1.8))


def test_the_leader_brakes_for_two_seconds():
    """From 12 m/s at 4 m/s²: 4 m/s after 2 s and (12 + 4)/2 · 2 = 16 m."""
    plan = plan_braking("x", 100.0, 3.0, 12.0, LeaderBraking(intensity=4.0), 0.2)
    assert len(plan.s) == 10
    assert plan.v[-1] == pytest.approx(4.0)
    assert plan.s[-1] == pytest.approx(116.0)
    assert plan.v[0] == pytest.approx(12 - 0.8)
    assert (plan.d == 3.0).all()


def test_the_leader_stands_in_the_end():
    plan = plan_braking("x", 100.0, 0.0, 5.0, LeaderBraking(intensity=8.0), 0.2)
    assert plan.v[-1] == 0
    assert plan.s[-1] == pytest.approx(100 + 25 / 16, abs=0.1)  # v²/2b
    assert (np.diff(plan.s) >= 0).all()


GROUP = cars((100, 0, 10), (120, 0, 10), (140, 0, 10))


def test_who_cuts_in_fits_into_the_gap():
    """The gap between 1 and 2 is from 120 to 135 m: 1 m clear of both, the front of a 5 m vehicle is in (126, 134)."""
    spec = NeighbourCutIn(intensity=0.0)

    def chosen(*others):
        return find_cut_in_vehicle(GROUP, 1, cars(*others), spec)

    assert chosen((125, LANE, 9)) is None
    assert chosen((127, LANE, 9)) == 0
    assert chosen((134.5, LANE, 9)) is None
    assert chosen((133, LANE, 9), (128, -LANE, 9)) == 1  # the nearer one to vehicle 1
    assert chosen((130, 2 * LANE, 9)) is None
    assert chosen((130, 0, 9)) is None


def test_cutting_in():
    """From the left at 12 m/s to 10 − 2 = 8 m/s; half-way across after 1 s, there after 2 s."""
    plan = plan_cut_in("x", (128.0, LANE, 12.0), 0.0, 10.0, NeighbourCutIn(intensity=2.0), 0.2)
    assert len(plan.s) == 20
    assert plan.d[4] == pytest.approx(LANE / 2)
    assert plan.d[9] == pytest.approx(0.0)
    assert plan.v[-1] == 8.0
    assert plan.v[0] == pytest.approx(11.4)
    assert plan.heading[4] < 0
    assert plan.heading[-1] == 0
    moved = np.hypot(np.diff(plan.s), np.diff(plan.d))
    assert np.allclose(np.tan(plan.heading[1:]), np.diff(plan.d) / np.diff(plan.s))
    assert moved.max() < 0.2 * 12.5


def test_who_is_slower_already_does_not_speed_up():
    plan = plan_cut_in("x", (128.0, LANE, 5.0), 0.0, 10.0, NeighbourCutIn(intensity=2.0), 0.2)
    assert (plan.v == 5.0).all()
