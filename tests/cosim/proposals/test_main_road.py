"""Which road and which lanes are proposed, on nets drawn by hand."""

from collections.abc import Mapping, Sequence

import pytest
import yaml

from cosim.proposals.main_road import ending_lanes, main_road
from cosim.proposals.net_file import NetLane, NetLanes
from cosim.proposals.scenario_file import choices, merging_lanes, scenario_text, warm_up
from cosim.sumo.net_use import NetUse
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
    assert merging_lanes(road) == [lane]


def test_a_road_is_cut_at_traffic_lights() -> None:
    lit = net({"a": [["b_0"], ["b_1"]], "b": [["c_0"], ["c_1"]], "c": [[], []]}, lights=["b"])
    assert main_road(lit, {("a", "b", "c"): 10}).edges == ("a", "b")


def test_a_lane_that_ends_is_used_after_one_that_a_ramp_feeds_on_either_side() -> None:
    edges = {"up": [["on_0"], ["on_1"]], "on": [["down_0"], []], "down": [[]]}
    road = main_road(net(edges), {("up", "on", "down"): 10})
    assert [(lane.lane, lane.side) for lane in road.ending] == [("on_1", "left")]
    assert [(lane.lane, lane.entries) for lane in merging_lanes(road)] == [("on_1", ())]
    both = {"up": [["on_1"], ["on_2"]], "ramp": [["on_0"]], "on": [[], ["down_0"], []], "down": [[]]}
    fed, dropped = merging_lanes(main_road(net(both), {("up", "on", "down"): 10}))
    assert ((fed.lane, fed.entries), (dropped.lane, dropped.entries)) == (("on_0", ("ramp",)), ("on_2", ()))


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
    assert merging_lanes(road) == [found[1], found[0]]


def use(speed: float, vehicles: Sequence[int] = (1, 5, 9, 10, 10, 10)) -> NetUse:
    """What vehicles of one speed [m/s] did on all edges."""
    edges = ("up", "acc", "down", "ramp")
    return NetUse({}, tuple(vehicles), 0, dict.fromkeys(edges, speed))


ROAD = main_road(RAMP, {("up", "acc", "down"): 100, ("ramp", "acc", "down"): 30})


@pytest.mark.parametrize("speed", [8.0, 15.0, 36.0])
def test_zone_and_horizon_fit_the_speed_and_the_road(speed: float) -> None:
    merge, following = choices(ROAD, use(speed))
    (lane,) = ROAD.ending
    begin, end = merge.zone
    assert lane.begin < begin < end <= lane.end - 20
    assert end - begin >= speed, "vehicles are in the zone for a second, once a second groups are looked for"
    assert end + speed * merge.horizon <= ROAD.length, "nobody leaves the study area within the horizon"
    assert 2 <= following.horizon <= 8
    assert following.horizon * speed <= 0.5 * ROAD.length
    assert merge.horizon == int(merge.horizon), "a multiple of every usual step"
    assert merge.max_gap == max(45, round(1.5 * speed))


def test_at_usual_speeds_the_zone_is_that_of_the_lane() -> None:
    (merge, _), (lane,) = choices(ROAD, use(15.0)), ROAD.ending
    assert merge.zone == lane.zone


def test_the_warm_up_leaves_most_of_the_demand_to_groups() -> None:
    assert warm_up(use(15.0)) == 30
    assert warm_up(use(15.0), 400.0) == 30
    assert warm_up(use(15.0), 60.0) == 15


def test_a_scenario_has_at_most_ten_lines_and_names_that_look_like_numbers_stay_names() -> None:
    lane_road = main_road(
        net({"1": [["2_1"], ["2_2"]], "ramp": [["2_0"]], "2": [[], ["a,b_0"], ["a,b_1"]], "a,b": [[], []]}),
        {("1", "2", "a,b"): 5},
    )
    for choice in choices(lane_road, use(15.0)):
        text = scenario_text("my: file.sumocfg", lane_road, use(15.0), choice, None)
        content = [line for line in text.splitlines() if not line.startswith("#")]
        assert len(content) <= 10
        read = yaml.safe_load(text)
        assert (read["road"]["edges"], read["road"]["origin"]) == (["1", "2", "a,b"], "1")
        assert read["traffic"]["sumocfg"] == "my: file.sumocfg"
        assert read["group"]["rule"] == choice.rule


def test_no_traffic_is_one_clear_error() -> None:
    with pytest.raises(InputError, match="no vehicle entered the net"):
        main_road(RAMP, {})
