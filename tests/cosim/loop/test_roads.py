"""Driving on roads as they are: on nets of every form, what a policy does is what its dynamics say."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from cosim.loop.closed_loop import Outcome, run
from cosim.runs.policy_loading import driver_of
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.traffic.simulation_input import SumoFiles
from cosim.world.episode import Ending, Episode, EventKind
from tests.cosim.conftest import quiet
from tests.cosim.plain_nets import MERGE, MERGE_LINKS, NODES, build_net

IN_LANE = {"rule": "car_following", "max_gap": 70, "max_time_gap": 4}


def spiral(first: float, pitch: float) -> str:
    """World points of two turns inwards, `pitch` [m] apart."""
    turns = np.linspace(0, 4 * np.pi, 120)
    radius = first - pitch * turns / (2 * np.pi)
    return " ".join(f"{r * np.cos(t):.2f},{r * np.sin(t):.2f}" for r, t in zip(radius, turns, strict=True))


def scenario(
    net: Path, edges: list[str], flows: Mapping[str, tuple[list[str], int, list[int]]], **changes: Any
) -> Path:
    """A scenario file for a net; a flow is its edges, vehicles per hour and lanes."""
    content = {
        "net": str(net),
        "road": {"edges": edges, "origin": edges[0], "length": 1100},
        "traffic": {
            "warm_up": 60,
            "vehicles": [{"name": "car", "variants": 10, "speed_factor_sd": 0.1}],
            "flows": [
                {"name": name, "edges": of, "per_hour": [rate], "classes": {"car": 1}, "lanes": lanes}
                for name, (of, rate, lanes) in flows.items()
            ],
        },
        "group": IN_LANE,
        "policy": {"kind": "idm"},
        **{"history": 2.0, "horizon": 6.0, "watch": 2.0, "episodes": 3, "time_limit": 200, "surroundings": False},
    } | changes
    path = net.with_name("scenario.yaml")
    path.write_text(yaml.safe_dump(content))
    return path


def driven(path: Path) -> Outcome:
    """Run a scenario in this process."""
    loaded = load_scenario(str(path))
    files = SumoFiles(find_net(loaded.net), path.with_name("routes.rou.xml"), path.with_name("sumo.log"))
    return run(loaded, files, driver_of(loaded), quiet)


def endings(episodes: tuple[Episode, ...]) -> Counter[Ending]:
    return Counter(episode.ending for episode in episodes)


def misplaced(outcome: Outcome) -> list[str]:
    """Driven vehicles that were not where they were commanded to be."""
    events = (event for episode in outcome.episodes for event in episode.events)
    return [str(event) for event in events if event.kind in (EventKind.MISPLACED, EventKind.VANISHED)]


def merge_on(net: Path, edges: list[str], ramp: list[str], lane: str, **changes: Any) -> Path:
    zone = {"rule": "merge", "lane": lane, "zone": [395, 600]} | changes.pop("group", {})
    rates = changes.pop("rates", (3200, 700))
    flows = {"main": (edges, rates[0], [0, 1]), "ramp": ([*ramp, *edges[1:]], rates[1], [0])}
    return scenario(net, edges, flows, group=zone, **({"horizon": 10.0} | changes))


def test_on_a_road_that_passes_near_itself_everybody_is_where_it_is(tmp_path: Path) -> None:
    """Two turns 16 m apart with three lanes; the distance driven along the lane is that of speed and time."""
    line = spiral(140, 16)
    ends = line.split()
    net = build_net(tmp_path, {"a": ends[0], "b": ends[-1]}, {"coil": f"a b 3 {line}"}, ())
    outcome = driven(scenario(net, ["coil"], {"all": (["coil"], 4000, [0, 1, 2])}))
    assert len(outcome.episodes) == 3
    assert not misplaced(outcome)
    for episode in outcome.episodes:
        assert not episode.contacts
        for role in (0, 1):
            rows = episode.driven[:, role]
            x, y, v = (episode.feature(name)[rows, role] for name in ("x", "y", "v"))
            way = np.hypot(np.diff(x), np.diff(y)).sum()
            assert way == pytest.approx((0.5 * (v[1:] + v[:-1]) * np.diff(episode.time[rows])).sum(), rel=0.01)


@pytest.mark.slow
def test_a_bridge_is_in_another_world(tmp_path: Path) -> None:
    nodes = {"a": "0,0", "b": "600,0", "d": "1200,0", "s": "480,-300,8", "n": "480,300,8"}
    edges = {"up": "a b 2", "down": "b d 2", "over": "s n 2"}
    net, road = build_net(tmp_path, nodes, edges, ()), ["up", "down"]
    flows = {"main": (road, 2400, [0, 1]), "over": (["over"], 1800, [0, 1])}
    with_bridge = driven(scenario(net, road, flows, episodes=4, horizon=8.0))
    without = driven(scenario(net, road, {"main": flows["main"]}, episodes=4, horizon=8.0))
    assert [e.group.ids for e in with_bridge.episodes] == [e.group.ids for e in without.episodes]
    assert not any(episode.contacts for episode in with_bridge.episodes + with_bridge.left_to_sumo)
    assert endings(with_bridge.episodes) == endings(without.episodes)


def test_left_hand_traffic_gives_the_numbers_of_its_mirror_image(tmp_path: Path) -> None:
    mirror = {name: f"{x},{-float(y)}" for name, (x, y) in ((n, at.split(",")) for n, at in NODES.items())}
    nets = {
        "right": build_net(tmp_path / "right", NODES, MERGE, MERGE_LINKS),
        "left": build_net(tmp_path / "left", mirror, MERGE, MERGE_LINKS, ["--lefthand"]),
    }
    outcomes = {name: driven(merge_on(net, ["up", "acc", "down"], ["ramp"], "acc_0")) for name, net in nets.items()}
    right, left = outcomes["right"], outcomes["left"]
    assert len(right.episodes) == 3
    assert not misplaced(left)
    for one, other in zip(right.episodes + right.left_to_sumo, left.episodes + left.left_to_sumo, strict=True):
        assert (one.group.ids, one.ending, one.contacts) == (other.group.ids, other.ending, other.contacts)
        for name in ("s", "d", "v", "a"):
            np.testing.assert_allclose(one.feature(name), other.feature(name), atol=0.02)


def test_a_lane_on_the_left_ends_and_its_vehicles_merge_to_the_right(tmp_path: Path) -> None:
    links = ("up_0 acc_0", "up_1 acc_1", "ramp_0 acc_2", "acc_0 down_0", "acc_1 down_1")
    net = build_net(tmp_path, NODES | {"r": "200,75"}, MERGE, links)
    outcome = driven(merge_on(net, ["up", "acc", "down"], ["ramp"], "acc_2"))
    assert endings(outcome.episodes)[Ending.MERGED] >= 2
    assert not misplaced(outcome)
    merged = next(episode for episode in outcome.episodes if episode.ending is Ending.MERGED)
    d = merged.feature("d")[merged.driven[:, 0], 0]
    assert d[0] > 2
    assert abs(d[-1]) < 1


@pytest.mark.slow
def test_a_lane_that_goes_on_across_a_node_is_one_lane(tmp_path: Path) -> None:
    nodes = NODES | {"m": "500,0"}
    edges = {"up": "a b 2", "acc": "b m 3", "acc2": "m c 3", "down": "c d 2", "ramp0": "q r 1", "ramp": "r b 1"}
    links = ("up_0 acc_1", "up_1 acc_2", "ramp_0 acc_0", "acc2_1 down_0", "acc2_2 down_1")
    net = build_net(tmp_path, nodes | {"q": "0,-150"}, edges, links)
    outcome = driven(merge_on(net, ["up", "acc", "acc2", "down"], ["ramp0", "ramp"], "acc_0"))
    assert endings(outcome.episodes)[Ending.MERGED] >= 2
    assert endings(outcome.episodes + outcome.left_to_sumo)[Ending.LANE_END] == 0
    assert not misplaced(outcome)


@pytest.mark.slow
def test_a_shift_at_a_node_is_no_lane_change(tmp_path: Path) -> None:
    links = ("up_0 acc_0", "up_1 acc_1", "ramp_0 acc_2", "acc_0 down_0", "acc_1 down_1")
    net, road = build_net(tmp_path, NODES | {"r": "200,75"}, MERGE, links), ["up", "acc", "down"]
    outcome = driven(scenario(net, road, {"main": (road, 2400, [0, 1])}, episodes=4, horizon=8.0))
    assert any((e.feature("s")[e.driven[:, 0], 0] < 390).any() for e in outcome.episodes)
    assert endings(outcome.episodes)[Ending.LANE_LEFT] == 0
    assert not misplaced(outcome)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "period"), [(0.1, 0.2), (0.5, 0.0), (1.0, 0.0)])
def test_steps_from_a_tenth_to_one_second(tmp_path: Path, step: float, period: float) -> None:
    net = build_net(tmp_path, NODES, MERGE, MERGE_LINKS)
    path = merge_on(net, ["up", "acc", "down"], ["ramp"], "acc_0", step=step, policy_period=period, horizon=14.0)
    outcome = driven(path)
    assert endings(outcome.episodes)[Ending.OFF_ROAD] == 0
    assert endings(outcome.episodes)[Ending.MERGED] >= 2
    assert not misplaced(outcome)


def test_a_ramp_without_a_lane_of_its_own_joins_at_a_node(tmp_path: Path) -> None:
    """The merger follows its ramp, lag vehicle and leader are on other edges; the lane behind the node is shared."""
    nodes = {"a": "0,0", "b": "600,0,0,zipper", "d": "1200,0", "q": "150,-160", "r": "330,-110"}
    edges = {"up": "a b 2", "down": "b d 2", "ramp0": "q r 1", "ramp": "r b 1"}
    links = ("up_0 down_0", "up_1 down_1", "ramp_0 down_0")
    net = build_net(tmp_path, nodes, edges, links)
    group = {"lane": "ramp_0", "zone": [380, 560], "max_speed_difference": 12, "max_gap": 90}
    changes = {"rates": (1500, 250), "episodes": 3, "horizon": 16.0, "time_limit": 400}
    path = merge_on(net, ["up", "down"], ["ramp0", "ramp"], "ramp_0", group=group, **changes)
    outcome = driven(path)
    assert len(outcome.episodes) >= 2
    assert not misplaced(outcome)
    assert endings(outcome.episodes)[Ending.MERGED] >= 2
    assert endings(outcome.episodes)[Ending.OFF_ROAD] == endings(outcome.episodes)[Ending.LANE_END] == 0
    for episode in outcome.episodes:
        d = episode.feature("d")[episode.driven[:, 0], 0]
        assert d[0] < -12  # on the ramp, far beside the road


@pytest.mark.slow
def test_a_zipper_is_passed_and_no_end_of_a_lane(tmp_path: Path) -> None:
    links = ("up_0 acc_1", "up_1 acc_2", "ramp_0 acc_0", "acc_0 down_0", "acc_1 down_0", "acc_2 down_1")
    net = build_net(tmp_path, NODES, MERGE, links)
    path = merge_on(net, ["up", "acc", "down"], ["ramp"], "acc_0", horizon=16.0)
    outcome = driven(path)
    assert endings(outcome.episodes)[Ending.MERGED] >= 2
    assert endings(outcome.left_to_sumo)[Ending.LANE_END] == 0
    assert not misplaced(outcome)
