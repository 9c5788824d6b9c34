"""Which groups can be driven in one branch."""

from cosim.world.groups import Group, isolated
from tests.cosim.world.test_group_search import traffic

A, B, C = (Group((f"{name}0", f"{name}1", f"{name}2"), 0.0) for name in "abc")


def vehicles(name: str, front: float, d: float) -> list[tuple[str, float, float]]:
    """Three vehicles in one lane, 20 m apart; the vehicle 2 is at `front`."""
    return [(f"{name}{role}", front - 20.0 * (2 - role), d) for role in range(3)]


def test_groups_beside_each_other_share_a_branch():
    now = traffic(*vehicles("a", 500, 0), *vehicles("b", 510, 3.5), *vehicles("c", 495, -3.5))
    assert isolated([A, B, C], now) == [(A, B, C)]


def test_a_vehicle_2_beside_or_behind_a_driven_vehicle_does_not():
    """Vehicle 1 of the first group is at 480 m."""
    beside = traffic(*vehicles("a", 500, 0), *vehicles("b", 480, 3.5))
    assert isolated([A, B], beside) == [(A,), (B,)]
    just_ahead = traffic(*vehicles("a", 500, 0), *vehicles("b", 480.1, 3.5))
    assert isolated([A, B], just_ahead) == [(A, B)]


def test_groups_in_one_lane_do_not_however_far_apart():
    now = traffic(*vehicles("a", 900, 0), *vehicles("b", 300, 0), *vehicles("c", 310, 3.5))
    assert isolated([A, B, C], now) == [(A,), (B, C)]


def test_every_group_is_in_exactly_one_set_and_the_first_stays_first():
    now = traffic(*vehicles("a", 900, 0), *vehicles("b", 300, 0), *vehicles("c", 905, 3.5))
    assert isolated([A, B, C], now) == [(A, C), (B,)]
    assert isolated([], now) == []
