"""Road frames of nets that netconvert built: bends, shifts at nodes, roads near themselves, left-hand traffic."""

from pathlib import Path

import numpy as np
import pytest

from cosim.world.polyline import length_of
from cosim.world.road_frame import RoadFrame
from tests.cosim.plain_nets import MERGE, MERGE_LINKS, NODES, build_net, read

LEFT_RAMP = NODES | {"r": "200,75"}
LEFT_LINKS = ("up_0 acc_0", "up_1 acc_1", "ramp_0 acc_2", "acc_0 down_0", "acc_1 down_1")
COIL = " ".join(
    f"{(120 - 6 * t) * np.cos(t):.2f},{(120 - 6 * t) * np.sin(t):.2f}" for t in np.linspace(0, 4 * np.pi, 90)
)


@pytest.fixture(scope="module")
def coil(tmp_path_factory: pytest.TempPathFactory) -> RoadFrame:
    """A road that passes 38 m beside itself, of two turns."""
    ends = COIL.split()
    nodes = {"a": ends[0], "b": ends[-1]}
    return read(build_net(tmp_path_factory.mktemp("coil"), nodes, {"coil": f"a b 3 {COIL}"}, ()), ["coil"])[2]


def test_a_road_near_itself_round_trip(coil: RoadFrame) -> None:
    rng = np.random.default_rng(1)
    s, d = rng.uniform(5, coil.end - 5, 2000), rng.uniform(-30, 30, 2000)
    xy, _ = coil.to_world(s, d)
    back = coil.to_road(xy, (s - 60, s + 60))
    np.testing.assert_allclose(back, [s, d], atol=1e-9)
    nearest = coil.to_road(xy)[0]
    assert np.abs(nearest - s).max() > 300  # without the lane, the neighbouring turn would be taken


def test_a_lane_keeps_its_d_in_a_bend_and_its_length_is_known(tmp_path: Path) -> None:
    ends = COIL.split()
    lanes, _, road = read(build_net(tmp_path, {"a": ends[0], "b": ends[-1]}, {"coil": f"a b 3 {COIL}"}, ()), ["coil"])
    for index in range(3):
        lane = lanes[f"coil_{index}"]
        place = np.linspace(0, road.end, len(lane.shape))
        s, d = road.to_road(lane.shape, (place - 80, place + 80))
        np.testing.assert_allclose(d, 3.2 * (index - 2), atol=0.05)
        line = road.line_at(float(np.mean(d)))
        assert line is not None
        assert line.driven(s[[-1]])[0] - line.driven(s[[0]])[0] == pytest.approx(length_of(lane.shape), rel=1e-3)
    assert length_of(lanes["coil_0"].shape) / length_of(lanes["coil_2"].shape) > 1.05


@pytest.mark.parametrize("options", [(), ("--no-internal-links",)])
def test_a_shift_of_all_lanes_at_a_node_is_no_change_of_d(tmp_path: Path, options: tuple[str, ...]) -> None:
    lanes, _, road = read(build_net(tmp_path, LEFT_RAMP, MERGE, LEFT_LINKS, options), ["up", "acc", "down"])
    y = [lanes[name].shape[-1, 1] for name in ("up_1", "acc_1", "down_1")]
    assert y[1] - y[0] == pytest.approx(-3.2)  # the world shifts, the road does not
    begin = -road.origin
    for edge, offset in (("up", 0), ("acc", 0), ("down", 0)):
        for index in range(2):
            shape = lanes[f"{edge}_{index}"].shape
            s, d = road.to_road(shape, (np.full(len(shape), begin - 20), np.full(len(shape), begin + 600)))
            np.testing.assert_allclose(d, 3.2 * (index - 1) + offset, atol=0.02)
        begin = float(s[-1])
    rng = np.random.default_rng(2)
    s, d = rng.uniform(0, road.end, 2000), rng.uniform(-6, 3, 2000)
    np.testing.assert_allclose(road.to_road(road.to_world(s, d)[0], (s - 20, s + 20)), [s, d], atol=1e-9)
    assert np.abs(road.heading_at(s)).max() < 1e-9


def test_across_a_shift_a_vehicle_that_keeps_its_d_follows_the_lane(tmp_path: Path) -> None:
    lanes, _, road = read(build_net(tmp_path, LEFT_RAMP, MERGE, LEFT_LINKS), ["up", "acc", "down"])
    (link,) = [link for link in lanes["up_0"].links if link.to == "acc_0"]
    (via,) = link.via
    _, d = road.to_road(lanes[via].shape, (np.full(5, 380.0), np.full(5, 420.0)))
    np.testing.assert_allclose(d, -3.2, atol=0.25)
    assert np.ptp(lanes[via].shape[:, 1]) > 3


def test_a_lane_that_does_not_go_on_breaks_no_frame(tmp_path: Path) -> None:
    # lane 1 of "up" ends on the left, lane 0 becomes the left one of two
    links = ("up_0 acc_1",)
    lanes, _, road = read(
        build_net(tmp_path, {"a": "0,0", "b": "400,0", "c": "700,0"}, {"up": "a b 2", "acc": "b c 2"}, links),
        ["up", "acc"],
    )
    assert road.to_road(lanes["up_0"].shape[-1:])[1] == pytest.approx(
        road.to_road(lanes["acc_1"].shape[:1])[1], abs=0.1
    )


def test_left_hand_traffic_is_the_mirror_image(tmp_path: Path) -> None:
    bend = "0,0 150,0 250,20 330,60 400,120"
    nodes = {"a": "0,0", "b": "400,120", "c": "700,400"}
    mirrored = {name: f"{x},{-float(y)}" for name, (x, y) in ((n, at.split(",")) for n, at in nodes.items())}
    turned = " ".join(f"{x},{-float(y)}" for x, y in (point.split(",") for point in bend.split()))
    edges = {"one": f"a b 2 {bend}", "two": "b c 2"}
    right = read(build_net(tmp_path / "right", nodes, edges, ()), ["one", "two"])
    left = read(
        build_net(tmp_path / "left", mirrored, edges | {"one": f"a b 2 {turned}"}, (), ["--lefthand"]), ["one", "two"]
    )
    assert left[2].mirrored
    for name in ("one_0", "one_1", "two_0"):
        of_right, of_left = (road.to_road(lanes[name].shape) for lanes, _, road in (right, left))
        np.testing.assert_allclose(of_left, of_right, atol=0.02)
        assert (of_left[1] < 0.1).all()
    s, d = np.linspace(0, 700, 50), np.linspace(-8, 2, 50)
    (xy, heading), (xy_m, heading_m) = (road.to_world(s, d) for _, _, road in (right, left))
    offset = xy[0] * [1, -1] - xy_m[0]
    np.testing.assert_allclose(xy * [1, -1] - offset, xy_m, atol=0.05)
    np.testing.assert_allclose(-heading, heading_m, atol=0.01)
    np.testing.assert_allclose(right[2].curvature_at(s, d), left[2].curvature_at(s, d), atol=1e-4)


def test_the_ordinary_merge_is_straight(tmp_path: Path) -> None:
    assert read(build_net(tmp_path, NODES, MERGE, MERGE_LINKS), ["up", "acc", "down"])[2].is_straight
