"""Which lanes are in the world of a road, on nets with bridges, loops and ramps."""

from dataclasses import replace
from pathlib import Path

import pytest

from cosim.world.road_frame import LanePlace
from cosim.world.road_lanes import entering_lanes
from cosim.world.road_world import Heights, lane_places
from tests.cosim.plain_nets import MERGE, MERGE_LINKS, NODES, build_net, read

# an exit that turns left in a loop over the road that it left, 150 m after it left it
LOOP = "400,0 520,-30 570,-60 560,-120 500,-130 450,-90 440,0 440,200"


def places(net: Path, edges: list[str], heights: Heights | None = None) -> dict[str, LanePlace]:
    lanes, count, road = read(net, edges)
    return lane_places(lanes, entering_lanes(lanes), count.__getitem__, edges, road, heights)


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    nodes = {"a": "0,0", "b": "400,0", "c": "900,0", "e": "440,200"}
    edges = {"up": "a b 2", "down": "b c 2", "loop": f"b e 1 {LOOP}"}
    return build_net(tmp_path_factory.mktemp("loop"), nodes, edges, ("up_0 down_0", "up_1 down_1", "up_0 loop_0"))


def test_all_lanes_around_a_merge_are_in_its_world(tmp_path: Path) -> None:
    net = build_net(tmp_path, NODES, MERGE, MERGE_LINKS)
    found = places(net, ["up", "acc", "down"])
    assert set(found) == set(read(net, ["up"])[0])
    assert all(place.is_whole for place in found.values())


def test_a_road_without_links_to_it_is_not_in_its_world(tmp_path: Path) -> None:
    nodes = NODES | {"s": "480,-300,8", "n": "480,300,8"}
    net = build_net(tmp_path, nodes, MERGE | {"over": "s n 2"}, MERGE_LINKS)
    found = places(net, ["up", "acc", "down"])
    assert {"over_0", "over_1"} & set(found) == set()
    assert "ramp_0" in found


def test_a_loop_is_in_the_world_until_it_crosses_the_road(loop: Path) -> None:
    place = places(loop, ["up", "down"])["loop_0"]
    assert 300 < place.last < 460
    assert place.low < 430 < place.high


def test_with_heights_only_another_level_is_another_world(loop: Path) -> None:
    flat = places(loop, ["up", "down"], lambda lane, position: 0.0)
    assert flat["loop_0"].is_whole
    over = places(loop, ["up", "down"], lambda lane, position: 8.0 if lane == "loop_0" and position > 300 else 0.0)
    assert over["loop_0"].last < 460


def test_what_is_far_away_along_the_links_is_not_near(tmp_path: Path) -> None:
    nodes = NODES | {"far": "-700,-75", "r": "200,-75"}
    edges = MERGE | {"feeder": "far r 1"}
    net = build_net(tmp_path, nodes | {"q": "-900,-75"}, edges | {"street": "q far 1"}, MERGE_LINKS)
    found = places(net, ["up", "acc", "down"])
    assert "feeder_0" in found
    assert "street_0" not in found


def test_a_place_is_whole_without_limits() -> None:
    assert LanePlace(0.0, 1.0).is_whole
    assert not replace(LanePlace(0.0, 1.0), last=5.0).is_whole
