"""Group rules on hand-made traffic."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.spec.scenario import CarFollowing, Merge
from cosim.world.groups import find_groups, next_ahead
from cosim.world.snapshot import Snapshot

RULE = CarFollowing(min_gap=2, max_gap=45, max_time_gap=2.5, min_speed=1)
ZONE = (0.0, 600.0)


def traffic(*vehicles: tuple[str, float, float], time: float = 0.0, v: float = 10.0, lanes=None) -> Snapshot:
    """A snapshot of (id, s, d); all 5 m long and equally fast."""
    n = len(vehicles)
    s, d = (np.array([x[k] for x in vehicles], dtype=float) for k in (1, 2))
    return Snapshot(
        time=time,
        ids=tuple(x[0] for x in vehicles),
        xy=np.stack([s, d], axis=1),
        heading=np.zeros(n),
        v=np.full(n, v),
        a=np.zeros(n),
        s=s,
        d=d,
        length=np.full(n, 5.0),
        width=np.full(n, 1.8),
        lane=tuple(lanes or ("e_0",) * n),
    )


def pick(history, rule=RULE, limit=9, eligible=None):
    ids = frozenset(history[-1].ids) if eligible is None else frozenset(eligible)
    return [group.ids for group in find_groups(history, rule, zone=ZONE, eligible=ids, limit=limit)]


def test_leaders_are_per_lane():
    snapshot = traffic(("a", 0, 0), ("b", 20, 3.5), ("c", 30, 0), ("d", 50, 0.1))
    assert next_ahead(snapshot, np.arange(4)).tolist() == [2, -1, 3, -1]


def test_a_chain_is_found_from_the_rear_up():
    assert pick([traffic(("x", 0, 0), ("y", 20, 0), ("z", 40, 0))]) == [("x", "y", "z")]


def test_no_vehicle_is_in_two_groups_and_the_front_comes_first():
    column = [(name, 20.0 * k, 0.0) for k, name in enumerate("abcdefg")]
    groups = pick([traffic(*column)])
    assert groups == [("e", "f", "g"), ("b", "c", "d")]
    assert pick([traffic(*column)], limit=1) == groups[:1]


@pytest.mark.parametrize(
    ("middle", "found"),
    [(20.0, True), (6.0, False), (38.0, False)],  # net gaps 15 and 15; 1 and 29; 33 and -3
)
def test_gaps_bound_a_group(middle, found):
    assert bool(pick([traffic(("x", 0, 0), ("y", middle, 0), ("z", 40, 0))])) is found


def test_time_gap_bounds_a_group_at_low_speed():
    column = (("x", 0, 0), ("y", 25, 0), ("z", 50, 0))  # 20 m net
    assert pick([traffic(*column, v=10.0)])  # 2.0 s
    assert not pick([traffic(*column, v=7.0)])  # 2.9 s


def test_somebody_in_between_at_any_time_breaks_the_chain():
    now = traffic(("x", 10, 0), ("y", 30, 0), ("z", 50, 0), ("w", 20, 3.5))
    before = traffic(("x", 0, 0), ("y", 20, 0), ("z", 40, 0), ("w", 10, 0))
    assert not pick([before, now])
    assert pick([replace(before, d=now.d), now])


def test_a_vehicle_that_changed_its_lane_is_not_taken():
    """All three changed together: each is the other's leader all the time, but nobody kept the lane."""
    before = traffic(("x", 0, 3.5), ("y", 20, 3.5), ("z", 40, 3.5))
    now = traffic(("x", 10, 0), ("y", 30, 0), ("z", 50, 0))
    assert not pick([before, now])


def test_a_vehicle_that_is_still_catching_up_is_not_taken():
    before = traffic(("x", 0, 0), ("y", 20, 0), ("z", 40, 0))
    now = traffic(("x", 10, 0), ("y", 30, 0), ("z", 50, 0))
    slow = replace(before, v=np.array([5.9, 10.0, 10.0]))
    assert pick([before, now])
    assert not pick([slow, now])


def test_a_vehicle_that_was_not_there_is_not_taken():
    now = traffic(("x", 10, 0), ("y", 30, 0), ("z", 50, 0))
    before = traffic(("x", 0, 0), ("y", 20, 0))
    assert not pick([before, now])


def test_only_eligible_vehicles_inside_the_zone():
    now = traffic(("x", 10, 0), ("y", 30, 0), ("z", 50, 0))
    assert not pick([now], eligible={"x", "y"})
    outside = traffic(("x", 590, 0), ("y", 610, 0), ("z", 630, 0))
    assert not pick([outside])


def test_merge_finds_lag_and_leader_in_the_lane_to_the_left():
    rule = Merge(lane="e_0", zone=(0.0, 100.0), min_gap=1, max_gap=45)
    now = traffic(
        ("m", 50, 0), ("lag", 30, 3.5), ("lead", 75, 3.5), ("far", 120, 3.5), lanes=("e_0", "e_1", "e_1", "e_1")
    )
    assert pick([now], rule) == [("m", "lag", "lead")]
    assert not pick([now], Merge(lane="e_0", zone=(60.0, 100.0)))
    assert not pick([now], Merge(lane="e_0", zone=(0.0, 100.0), min_gap=25))
