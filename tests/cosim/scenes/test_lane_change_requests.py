"""Requests to make room, in hand-made traffic."""

import math

from cosim.scenes.lane_change_requests import find_requests, follower_row
from cosim.sumo import Drivers
from cosim.world.snapshot import LaneChange, LaneTraffic

WISH = int(LaneChange.LEFT | LaneChange.STRATEGIC | LaneChange.URGENT)
FOLLOWER, LEADER = int(LaneChange.BLOCKED_BY_LEFT_FOLLOWER), int(LaneChange.BLOCKED_BY_LEFT_LEADER)


class HandMadeDrivers(Drivers):
    """Drivers with given neighbours, (vehicle, ahead) -> (other, distance), and lane-change states to the left."""

    def __init__(self, neighbours: dict[tuple[str, bool], tuple[str, float]], **left: int) -> None:
        self.neighbours, self.left = neighbours, left

    def lane_change_state(self, vehicle: str, left: bool) -> int:
        return self.left.get(vehicle, 0) if left else 0

    def neighbour(self, vehicle: str, left: bool, ahead: bool) -> tuple[str, float]:
        return self.neighbours.get((vehicle, ahead), ("", math.inf)) if left else ("", math.inf)


def driving(v: dict[str, float] | None = None, leader: dict[str, str] | None = None) -> LaneTraffic:
    """Vehicles m, n on lane 0; f, l on lane 1."""
    ids = ["m", "n", "f", "l"]
    return LaneTraffic(
        ids=ids,
        lane=[0, 0, 1, 1],
        position=[0.0] * 4,
        v=[(v or {}).get(name, 10.0) for name in ids],
        leader=[(leader or {}).get(name, "") for name in ids],
        gap=[10.0] * 4,
    )


def asked(drivers: HandMadeDrivers, traffic: LaneTraffic | None = None) -> dict[int, str]:
    return find_requests(drivers, traffic or driving(), [0, 1]).requesters


def test_an_urgent_lane_change_asks_the_blocking_follower():
    near = {("m", False): ("f", 5.0)}
    assert asked(HandMadeDrivers(near, m=WISH | FOLLOWER)) == {2: "m"}
    assert asked(HandMadeDrivers(near, m=WISH)) == {}
    assert asked(HandMadeDrivers(near, m=(WISH | FOLLOWER) & ~int(LaneChange.URGENT))) == {}
    assert asked(HandMadeDrivers(near, m=FOLLOWER)) == {}
    assert find_requests(HandMadeDrivers(near, m=WISH | FOLLOWER), driving(), [1]).requesters == {}


def test_a_slower_leader_is_asked_to_be_overtaken():
    drivers = HandMadeDrivers({("m", True): ("l", 5.0)}, m=WISH | LEADER)
    assert asked(drivers, driving({"l": 8.0})) == {3: "m"}
    assert asked(drivers, driving({"l": 12.0})) == {}


def test_an_asked_vehicle_may_ask_another_one():
    drivers = HandMadeDrivers(
        {("m", False): ("n", 5.0), ("n", False): ("l", 3.0)}, m=WISH | FOLLOWER, n=WISH | FOLLOWER
    )
    assert find_requests(drivers, driving(), [0]).requesters == {1: "m", 3: "n"}
    assert find_requests(drivers, driving(), []).requesters == {}


def test_an_urgent_lane_change_has_a_target_blocked_or_not():
    near = {("m", True): ("l", 5.0), ("m", False): ("f", 4.0)}
    for state in (WISH, WISH | FOLLOWER, WISH | LEADER):
        assert find_requests(HandMadeDrivers(near, m=state), driving({"l": 12.0}), [0, 1]).targets == {0: ("l", 5.0)}
    assert find_requests(HandMadeDrivers(near, m=WISH & ~int(LaneChange.URGENT)), driving(), [0, 1]).targets == {}
    assert find_requests(HandMadeDrivers({}, m=WISH), driving(), [0, 1]).targets == {}


def test_of_two_requests_the_nearer_one_counts():
    near = {("m", False): ("f", 5.0), ("n", False): ("f", 3.0)}
    assert asked(HandMadeDrivers(near, m=WISH | FOLLOWER, n=WISH | FOLLOWER)) == {2: "n"}


def test_the_follower_in_the_same_lane():
    traffic = driving(leader={"f": "l", "m": "l"})
    assert follower_row(traffic, "l", [-3.5, 0.0]) == 2
    assert follower_row(traffic, "f", [-3.5, 0.0]) is None
    assert follower_row(traffic, "gone", [-3.5, 0.0]) is None
