"""Reference drivers in the first second, by hand."""

import numpy as np
import pytest

from cosim.perturb.reference_manoeuvres import can_be_avoided
from tests.cosim.perturb.test_displaced_starts import LANE, cars

ROAD = (-1.5 * LANE, 0.5 * LANE)  # two lanes; the vehicle in the middle of the right one is at d = −LANE


def avoided(*vehicles, moved=(0,), driven=(0,), braking=8.0, sides=None):
    states = cars(*vehicles)
    return can_be_avoided(states, np.isin(np.arange(len(states.s)), moved), driven, braking, sides)


def test_an_empty_road_is_safe():
    assert avoided((100, 0, 20))
    assert avoided((100, 0, 20), (150, 0, 20))


def test_a_contact_within_four_tenths_of_a_second_cannot_be_braked_away():
    """At 20 m/s, 3 m behind a standing vehicle: 8 m/s² save 0.64 m in 0.4 s."""
    assert not avoided((100, 0, 20), (108, 0, 0))


def test_the_vehicle_behind_does_not_react_in_the_first_second():
    """6.5 m ahead of a vehicle that is 6.2 m/s faster: 0.3 m are left after 1 s, and 6.2²/16 = 2.4 m are needed.

    Vehicle `entering.151` of US-101, put abreast of its leader: every tested policy, and SUMO, were hit after 0.8 to
    1 s. Braking at once by the vehicle behind would do, and the formula for braking alone called the start feasible.
    """
    assert not avoided((270.1, 0, 13.4), (270.1 - 5 - 6.5, 0, 19.6))
    assert avoided((270.1, 0, 13.4), (270.1 - 5 - 8.7, 0, 19.6))
    assert not avoided((270.1, 0, 13.4), (270.1 - 5 - 8.5, 0, 19.6))


def test_steering_away_avoids_what_braking_cannot():
    """At 30 m/s, 38 m behind 5 m/s: braking needs 25²/16 = 39 m, and 2.2 s. Aside in 1 s: 1.5 m of the needed 1.8 m."""
    slow = (143, -LANE, 5)
    assert not avoided((100, -LANE, 30), slow, sides=ROAD)
    assert not avoided((100, -LANE + 0.4, 30), slow)
    assert avoided((100, -LANE + 0.4, 30), slow, sides=ROAD)
    beside = (103, 0, 30), (97, 0, 30)
    assert not avoided((100, -LANE + 0.4, 30), slow, *beside, sides=ROAD), "the lane to the left is full"
    assert not avoided((100, -LANE + 0.4, 30), slow, sides=(-1.5 * LANE, -0.6 * LANE)), "the road ends there"


def test_a_vehicle_that_hardly_moves_cannot_steer_away():
    """It is 3 m ahead of one that comes with 20 m/s, and 0.4 m beside its middle."""
    assert not avoided((100, 0.4, 1), (92, 0, 20), sides=(-9.0, 9.0))


def test_two_driven_vehicles_choose_together():
    """0 has to brake for the standing vehicle, 1 follows 2 m behind and has to brake, too."""
    pair = (100, 0, 15), (93, 0, 15), (120, 0, 0)
    assert avoided(*pair, driven=(0, 1))
    assert not avoided(*pair, driven=(0,)), "SUMO's driver does not react in the first second"


def test_less_friction_needs_more_room():
    assert avoided((100, 0, 20), (135, 0, 0))
    assert not avoided((100, 0, 20), (135, 0, 0), braking=2.0)


@pytest.mark.parametrize("moved", [(0,), (1,)])
def test_what_happens_between_others_does_not_count(moved):
    """The last two are about to collide, far from the rest, and in front of a driven vehicle that was not moved."""
    assert avoided((100, 0, 10), (150, LANE, 10), (125, 2 * LANE, 30), (131, 2 * LANE, 0), moved=moved, driven=(0, 1))


def test_a_follower_that_keeps_its_distance_by_itself_is_no_reason_to_exclude_a_start():
    """Vehicle 1 was not moved; the outsider behind it closes up fast, as it does in the undisturbed traffic."""
    crowd = (100, -LANE, 10), (150, 0, 10), (142, 0, 20)
    assert avoided(*crowd, moved=(0,), driven=(0, 1))
    assert not avoided(*crowd, moved=(1,), driven=(0, 1))
