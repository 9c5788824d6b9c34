"""Group rules on hand-made traffic, and why candidates are no groups."""

from collections import Counter
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from cosim.spec.scenario import CarFollowing, Merge
from cosim.world.group_search import GroupSearch, search_groups, why_not_more
from cosim.world.groups import MergeLanes, next_ahead
from cosim.world.snapshot import LaneStrip, Snapshot

RULE = CarFollowing(min_gap=2, max_gap=45, max_time_gap=2.5, min_speed=1)
ZONE = (0.0, 600.0)
LANES = MergeLanes(LaneStrip("e_0", 0.0, 600.0, 0.0, 3.5), LaneStrip("e_1", 0.0, 600.0, 3.5, 3.5))


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


def search(history, rule: CarFollowing | Merge = RULE, limit=9, barred=()) -> GroupSearch:
    return search_groups(history, rule, zone=ZONE, barred=dict.fromkeys(barred, "barred"), limit=limit, lanes=LANES)


def pick(history, rule: CarFollowing | Merge = RULE, limit=9, barred=()):
    return [group.ids for group in search(history, rule, limit, barred).groups]


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


def test_only_vehicles_inside_the_zone_that_are_not_barred():
    now = traffic(("x", 10, 0), ("y", 30, 0), ("z", 50, 0))
    assert not pick([now], barred=["z"])
    assert search([now], barred=["z"]).failed == {"barred": 1}
    outside = traffic(("x", 590, 0), ("y", 610, 0), ("z", 630, 0))
    assert search([outside]) == GroupSearch()


def test_merge_finds_lag_and_leader_in_the_lane_to_the_left():
    rule = Merge(lane="e_0", zone=(0.0, 100.0), min_gap=1, max_gap=45)
    now = traffic(
        ("m", 50, 0), ("lag", 30, 3.5), ("lead", 75, 3.5), ("far", 120, 3.5), lanes=("e_0", "e_1", "e_1", "e_1")
    )
    assert pick([now], rule) == [("m", "lag", "lead")]
    assert not pick([now], Merge(lane="e_0", zone=(60.0, 100.0)))
    assert not pick([now], Merge(lane="e_0", zone=(0.0, 100.0), min_gap=25))


@pytest.mark.parametrize(
    ("column", "v", "failed"),
    [
        ((("x", 0, 0), ("y", 6, 0), ("z", 40, 0)), 10.0, "gap < 2 m"),
        ((("x", 0, 0), ("y", 20, 0), ("z", 71, 0)), 10.0, "gap > 45 m"),
        ((("x", 0, 0), ("y", 25, 0), ("z", 50, 0)), 7.0, "time gap > 2.5 s"),
        ((("x", 0, 0), ("y", 7.1, 0), ("z", 14.2, 0)), 0.9, "speed < 1 m/s"),
    ],
)
def test_a_chain_that_is_no_group_says_which_limit_it_fails(column, v, failed):
    found = search([traffic(*column, v=v)])
    assert (found.groups, found.seen, found.failed) == ((), 1, {failed: 1})


def test_what_happened_during_the_history_is_said():
    now = traffic(("x", 10, 0), ("y", 30, 0), ("z", 50, 0))
    before = traffic(("x", 0, 0), ("y", 20, 0), ("z", 40, 0))
    slow = replace(before, v=np.array([5.9, 10.0, 10.0]))
    assert search([slow, now]).failed == {"speed difference > 4 m/s during the history": 1}
    assert search([replace(before, d=before.d + 3.5), now]).failed == {"lane change during the history": 1}
    other = replace(before, ids=("y", "x", "z"))
    assert search([other, now]).failed == {"in another order or lane during the history": 1}


def test_every_candidate_is_a_group_or_failed_or_is_beyond_the_limit():
    column = [(name, 20.0 * k, 0.0) for k, name in enumerate("abcdefg")]
    found = search([traffic(*column)])
    assert found.seen == 5
    assert len(found.groups) + sum(found.failed.values()) == found.seen
    assert found.failed == {"shares a vehicle with another group": 3}


def test_a_merge_that_is_no_group_says_why():
    lanes = ("e_0", "e_1", "e_1")
    now = traffic(("m", 50, 0), ("lag", 30, 3.5), ("lead", 75, 3.5), lanes=lanes)

    def failed(snapshot=now, **changes):
        rule = {"lane": "e_0", "zone": (0.0, 100.0), "min_gap": 1, "max_gap": 45} | changes
        (reason,) = search([now, snapshot], Merge(**rule)).failed
        return reason

    assert failed(zone=(60.0, 100.0)) == "outside the zone [60.0, 100.0] m"
    assert failed(traffic(("m", 50, 0), ("lag", 30, 3.5), lanes=lanes[:2])) == "no vehicle behind or ahead on lane e_1"
    assert failed(min_gap=25) == "gap < 25 m"
    assert failed(min_speed=11) == "speed < 11 m/s"
    assert failed(replace(now, v=np.array([10.0, 17.0, 10.0]))) == "speed difference > 6 m/s"
    assert failed(replace(now, ids=("m", "new", "lead"))) == "absent during the history"
    assert search([replace(now, d=now.d[[1, 0, 2]]), now], Merge(lane="e_0", zone=(0.0, 100.0))).failed == {
        "lane change during the history": 1
    }


def test_the_reasons_are_told_most_frequent_first():
    found = search([traffic(("x", 0, 0), ("y", 20, 0), ("z", 71, 0))]) + GroupSearch((), 3, Counter({"gap < 2 m": 2}))
    assert (found.seen, found.failed) == (4, {"gap > 45 m": 1, "gap < 2 m": 2})
    told = why_not_more("car_following", found.seen, found.failed)
    assert told == "4 chains of three vehicles in the study area seen, once a second: 2 gap < 2 m; 1 gap > 45 m"
    assert why_not_more("merge", 0, {}) == "0 vehicles on the ending lane seen, once a second"


def test_chains_of_any_size():
    """Five vehicles in a row: the chains of four and five, and how a missing one is told."""
    rows = [traffic(*((name, 20.0 * k, 0.0) for k, name in enumerate("abcde")), time=t) for t in (0.0, 1.0)]
    assert pick(rows, replace_size(5)) == [tuple("abcde")]
    assert pick(rows, replace_size(4)) == [tuple("bcde")]  # the one farthest ahead; no vehicle is in two groups
    assert pick(rows, replace_size(2)) == [("d", "e"), ("b", "c")]
    assert pick(rows, replace_size(6)) == []
    assert (
        why_not_more("car_following", 7, {}, size=5)
        == "7 chains of five vehicles in the study area seen, once a second"
    )


def replace_size(size: int) -> CarFollowing:
    return msgspec.structs.replace(RULE, size=size)
