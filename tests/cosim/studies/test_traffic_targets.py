"""Statistics of hand-made surveys, and their comparison with targets."""

import msgspec
import pandas as pd
import pytest
from msgspec.structs import replace

from cosim.runs.traffic_survey import Survey
from cosim.spec.demand import Targets
from cosim.spec.loading import load_scenario
from cosim.studies.traffic_targets import (
    statistics_frame,
    statistics_table,
    target_checks,
    targets_reached,
    traffic_statistics,
)


@pytest.fixture(scope="module")
def scenario():
    scenario = load_scenario("us101_car_following")
    targets = Targets(mean_speed=6.0, mainline=(24.0, 12.0), ramp_share=0.25)
    return replace(scenario, traffic=replace(scenario.traffic, warm_up=600.0, interval=300.0, targets=targets))


@pytest.fixture(scope="module")
def figures(scenario):
    """From 600 s on; `through.0` is there already, two enter on the main road, in 900 s one more, one from the ramp.

    At 601 s two vehicles drive at 10 m/s and one stands, at 1,200 s two drive at 5 m/s: 30/5 = 6 m/s on average.
    """
    rows = [
        (600.0, "through.0", 5.0, 1, 10.0),
        (601.0, "through.1", 5.0, 1, 10.0),
        (601.0, "leaving.0", 12.0, 2, 10.0),
        (601.0, "through.0", 5.0, 2, 0.0),
        (1200.0, "entering.0", 5.0, 1, 5.0),
        (1200.0, "through.2", 5.0, 1, 5.0),
    ]
    names = ["time", "vehicle", "length", "lane", "v"]
    return traffic_statistics(scenario, Survey(pd.DataFrame(rows, columns=names), -3.25, 7, 0, 0))


def test_figures_by_hand(figures):
    assert figures.mean_speed == pytest.approx(6.0)
    assert figures.speed == pytest.approx((20 / 3, 5.0))
    assert figures.lanes == (pytest.approx((20 / 3, 0.6)), pytest.approx((5.0, 0.4)))
    assert figures.mainline == pytest.approx((24.0, 12.0))  # 2 and 1 vehicles in 300 s each
    assert figures.flow == pytest.approx(24.0)  # 4 vehicles in 600 s
    assert figures.ramp_share == figures.long_share == 0.25
    assert figures.standing_share == pytest.approx(0.2)


def test_targets_are_met_within_their_tolerance(scenario, figures):
    targets = scenario.traffic.targets
    assert targets_reached(targets, figures)
    assert [check.label for check in target_checks(targets, figures)] == [
        "mean speed", "main road, interval 1", "main road, interval 2", "share from the ramps",
    ]  # fmt: skip
    assert targets_reached(replace(targets, mean_speed=6.6), figures)  # 9.1 % off
    assert not targets_reached(replace(targets, mean_speed=6.7), figures)  # 10.4 % off
    assert not targets_reached(replace(targets, mainline=(24.0, 12.7)), figures)
    assert targets_reached(replace(targets, mainline=(24.0, 12.6)), figures)
    assert not targets_reached(targets, msgspec.convert({**frame(figures), "collisions": 1}, type(figures)))


def frame(figures):
    return msgspec.to_builtins(figures)


def test_the_last_rate_lasts(scenario, figures):
    found = [check.target for check in target_checks(replace(scenario.traffic.targets, mainline=(24.0,)), figures)]
    assert found[1:3] == [24.0, 24.0]


def test_the_table_says_what_was_missed(scenario, figures):
    targets = replace(scenario.traffic.targets, mainline=(24.0, 12.0), mean_speed=5.0)
    with_targets = replace(scenario, traffic=replace(scenario.traffic, targets=targets))
    rows = {label: rest for label, *rest in statistics_table("x", with_targets, [figures, figures]).lines}
    assert rows["mean speed [km/h]"] == ["18.0 ± 10 %"] + ["21.6 (+20.0 %) !"] * 2
    assert rows["  main road, interval 1 [veh/h]"][1] == "24 (+0.0 %)"
    assert rows["all targets reached"][1:] == ["no", "no"]
    without = replace(scenario, traffic=replace(scenario.traffic, targets=None))
    rows = {label: rest for label, *rest in statistics_table("x", without, [figures]).lines}
    assert rows["mean speed [km/h]"] == ["21.6"]
    assert "all targets reached" not in rows


def test_a_row_per_seed(figures):
    table = statistics_frame([figures])
    assert table.loc[0, ["mean_speed", "mainline_2", "lane_1_share", "waiting"]].tolist() == [6.0, 12.0, 0.6, 7]


@pytest.mark.parametrize("name", ["us101_car_following", "i80_car_following"])
def test_shipped_traffic_has_targets(name):
    assert load_scenario(name).traffic.targets
