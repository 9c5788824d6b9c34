"""Which road and which lanes are proposed, on nets drawn by hand."""

from collections.abc import Mapping, Sequence

import pytest

from cosim.proposals.main_road import ending_lanes, main_road
from cosim.proposals.net_file import NetLane, NetLanes
from cosim.proposals.scenario_file import merging_lane
from gri.errors import InputError


def net(edges: Mapping[str, Sequence[Sequence[str]]], lights: Sequence[str] = (), limit: float = 30.0) -> NetLanes:
    """A net: for each edge its lanes from the right, each with the lanes it leads to. Lanes are 200 m long."""
    lanes = {}
    for edge, of in edges.items():
        for index, leads_to in enumerate(of):
            name = f"{edge}_{index}"
            shape = ((0.0, 0.0), (200.0, 0.0))
            lanes[name] = NetLane(name, edge, index, 200.0, limit, shape, tuple(leads_to), edge in lights, True)
    return NetLanes(lanes, {edge: tuple(f"{edge}_{k}" for k in range(len(of))) for edge, of in edges.items()}, False)


RAMP = net({"up": [["acc_1"], ["acc_2"]], "ramp": [["acc_0"]], "acc": [[], ["down_0"], ["down_1"]], "down": [[], []]})


def test_the_road_of_most_vehicle_metres_is_proposed_and_the_lane_that_a_ramp_feeds() -> None:
    road = main_road(RAMP, {("up", "acc", "down"): 100, ("ramp", "acc", "down"): 30})
    assert (road.edges, road.vehicles, road.length) == (("up", "acc", "down"), 130, 600.0)
    (lane,) = road.ending
    assert (lane.lane, lane.begin, lane.end, lane.side, lane.entries) == ("acc_0", 200.0, 400.0, "right", ("ramp",))
    assert not lane.leads_off
    assert lane.begin < lane.zone[0] < lane.zone[1] < lane.end - 60
    assert merging_lane(road) == lane


def test_a_road_is_cut_at_traffic_lights() -> None:
    lit = net({"a": [["b_0"], ["b_1"]], "b": [["c_0"], ["c_1"]], "c": [[], []]}, lights=["b"])
    assert main_road(lit, {("a", "b", "c"): 10}).edges == ("a", "b")


def test_a_lane_that_ends_on_the_left_is_told_and_used_if_a_ramp_feeds_it() -> None:
    edges = {"up": [["on_0"], ["on_1"]], "on": [["down_0"], []], "down": [[]]}
    road = main_road(net(edges), {("up", "on", "down"): 10})
    assert [(lane.lane, lane.side) for lane in road.ending] == [("on_1", "left")]
    assert merging_lane(road) is None
    ramp = {"up": [["on_0"]], "ramp": [["on_1"]]}
    assert merging_lane(main_road(net(edges | ramp), {("up", "on", "down"): 10})) is not None


def test_a_lane_that_goes_on_across_a_node_and_a_zipper_and_a_joining_ramp() -> None:
    split = net(
        {
            "up": [["acc_1"], ["acc_2"]],
            "ramp": [["acc_0"]],
            "acc": [["on_0"], ["on_1"], ["on_2"]],
            "on": [["down_0"], ["down_0"], ["down_1"]],
            "down": [["end_0"], ["end_1"]],
            "late": [["end_0"]],
            "end": [[], []],
        }
    )
    zipper, joining = ending_lanes(split, ("up", "acc", "on", "down", "end"))
    assert (zipper.lane, zipper.begin, zipper.end, zipper.entries) == ("on_0", 200.0, 600.0, ("ramp",))
    assert not zipper.leads_off
    assert (joining.lane, joining.joins, joining.end) == ("late_0", True, 800.0)


def test_a_lane_that_leads_to_an_exit_comes_after_one_that_ends() -> None:
    weave = net(
        {
            "up": [["weave_1"]],
            "on": [["weave_0"]],
            "weave": [["off_0"], ["free_1"]],
            "off": [[]],
            "ramp": [["free_0"]],
            "free": [[], ["down_0"]],
            "down": [[]],
        }
    )
    found = ending_lanes(weave, ("up", "weave", "free", "down"))
    assert [(lane.lane, lane.leads_off, lane.entries) for lane in found] == [
        ("weave_0", True, ("on",)),
        ("free_0", False, ("ramp",)),
    ]
    road = main_road(weave, {("up", "weave", "free", "down"): 10})
    assert merging_lane(road) == found[1]


def test_no_traffic_is_one_clear_error() -> None:
    with pytest.raises(InputError, match="no vehicle entered the net"):
        main_road(RAMP, {})
