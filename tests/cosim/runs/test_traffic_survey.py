"""The survey of undisturbed traffic."""

import msgspec
import pytest

from cosim.runs.traffic_survey import survey
from cosim.spec.loading import load_scenario
from cosim.traffic.simulation_input import SumoFiles
from gri.resources import shipped


@pytest.mark.parametrize("name", ["us101_car_following", "i80_car_following"])
def test_null_run_has_no_collision_and_no_teleport(name, tmp_path):
    scenario = load_scenario(name)
    scenario = msgspec.structs.replace(scenario, traffic=msgspec.structs.replace(scenario.traffic, warm_up=90.0))
    net = shipped("sumo_nets", scenario.net, f"{scenario.net}.net.xml")
    result = survey(scenario, SumoFiles(net, tmp_path / "r.rou.xml", tmp_path / "log"), 30.0, lambda *_: None)
    assert result.collisions == result.teleports == 0
    assert set(result.samples["lane"]) >= {1, 2, 3, 4, 5}
    assert result.samples["v"].mean() > 5
    assert result.samples["time"].unique().tolist() == [90.0 + k for k in range(31)]
    ahead = result.samples.sort_values(["time", "lane", "x"])
    same = (ahead["time"].diff() == 0) & (ahead["lane"].diff() == 0)
    assert (ahead["x"].diff()[same] > ahead["length"][same]).all()  # nobody stands in the one behind


def test_the_plain_freeway_flows_freely_without_collision_and_teleport(tmp_path):
    scenario = load_scenario("highway")
    scenario = msgspec.structs.replace(scenario, traffic=msgspec.structs.replace(scenario.traffic, warm_up=120.0))
    net = shipped("sumo_nets", "highway", "highway.net.xml")
    result = survey(scenario, SumoFiles(net, tmp_path / "r.rou.xml", tmp_path / "log"), 60.0, lambda *_: None)
    assert result.collisions == result.teleports == 0
    assert set(result.samples["lane"]) == {1, 2, 3, 4}
    assert 22 < result.samples["v"].mean() < 25  # the limit is 25 m/s
    assert result.samples["v"].min() > 8
    assert result.samples["vehicle"].nunique() > 80
