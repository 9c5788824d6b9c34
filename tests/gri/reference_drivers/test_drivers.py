"""The judgements of the reference drivers, against numbers worked out by hand from the formulas of their sources."""

import numpy as np
import pytest

from gri.reference_drivers.drivers import R157, CarefulHuman, FuzzySafety, Rss, Situation


def situation(
    gap: float, v: float, v_other: float, *, side: float = -1.0, approach: float = 0.0, wandered: float = 3.5, a=0.0
) -> Situation:
    """One other vehicle; both are 4.3 m long."""
    values = (gap + 4.3, gap, side, 8.6, v, v_other, approach, wandered, a)
    return Situation(*(np.array([value], dtype=float) for value in values))


@pytest.mark.parametrize(("gap", "risk"), [(12.8, True), (12.9, False)])
def test_r157_reacts_up_to_its_critical_ttc(gap, risk):
    now = situation(gap, 20.0, 10.0, side=0.5)  # 10/12 + 0.35 + 0.1 = 1.2833 s
    assert R157().judge(now).risk[0] == risk


def test_r157_waits_for_the_lane_intrusion_and_ignores_who_is_behind():
    assert not R157().judge(situation(5.0, 20.0, 10.0, side=0.51)).risk[0]
    behind = situation(-5.0, 20.0, 10.0)
    assert behind.centres[0] < 0
    assert not R157().judge(behind).risk[0]


def test_the_variants_of_the_careful_human_differ_before_the_overlap():
    wandering = situation(15.0, 20.0, 10.0, side=1.0, wandered=0.6)
    assert CarefulHuman(wandering=True).judge(wandering).risk[0]
    assert not CarefulHuman().judge(wandering).risk[0]
    assert not CarefulHuman(wandering=True).judge(situation(15.0, 20.0, 10.0, side=1.3, wandered=0.3)).risk[0]


def test_a_vehicle_that_overlaps_sideways_beyond_the_critical_ttc_is_no_cut_in_any_more():
    judged = CarefulHuman().judge(situation(21.0, 20.0, 10.0))
    assert judged.settled[0]
    assert not judged.risk[0]


def test_proactive_metric_grades_the_distance():
    safe = 20 * 0.75 + 400 / 8 - 100 / 14 + 2
    unsafe = 20 * 0.75 + 400 / 12 - 100 / 14
    middle = situation((safe + unsafe) / 2 + 2, 20.0, 10.0)
    assert FuzzySafety().proactive(middle)[0] == pytest.approx(0.5)
    assert FuzzySafety().proactive(situation(safe + 2.1, 20.0, 10.0))[0] == 0
    assert FuzzySafety().proactive(situation(unsafe + 1.9, 20.0, 10.0))[0] == 1


def test_critical_metric_with_and_without_speed_left_over():
    # Without braking u' = u: (20 − 10)·0.75 = 7.5 m and 100/8 = 12.5 m, 100/12 = 8.33 m.
    middle = situation(7.5 + (12.5 + 100 / 12) / 2, 20.0, 10.0)
    assert FuzzySafety().critical(middle)[0] == pytest.approx(0.5)
    # Braking with 4 m/s² from 12 m/s: u' = 9 < 10 m/s; the least distance is 4/8 = 0.5 m.
    assert FuzzySafety().critical(situation(0.49, 12.0, 10.0, a=-4.0))[0] == 1
    assert FuzzySafety().critical(situation(0.51, 12.0, 10.0, a=-4.0))[0] == 0
    assert FuzzySafety().critical(situation(1.0, 10.0, 10.0))[0] == 0


def test_fsm_ignores_a_vehicle_that_it_has_passed_before_it_can_enter():
    slowly = situation(10.0, 20.0, 10.0, side=1.6, approach=0.5)  # beside in 3.2 s, passed in 1.86 s
    quickly = situation(10.0, 20.0, 10.0, side=0.6, approach=0.5)
    assert not FuzzySafety().judge(slowly).risk[0]
    assert FuzzySafety().judge(quickly).risk[0]


def test_rss_needs_both_distances_to_be_undercut():
    along = 20 * 0.75 + 3 * 0.75**2 / 2 + 22.25**2 / 12 - 100 / 12
    across = 0.3 + (2 + 0.75) * 0.75 / 2 + 1.75**2 / 2
    assert Rss().along(np.array([20.0]), np.array([10.0]))[0] == pytest.approx(along)
    assert Rss().across(np.array([1.0]))[0] == pytest.approx(across)
    for gap, side, risk in ((along - 0.1, across - 0.1, True), (along + 0.1, 0.0, False), (1.0, across + 0.1, False)):
        assert Rss().judge(situation(gap, 20.0, 10.0, side=side, approach=1.0)).risk[0] == risk
