"""The survey of undisturbed traffic."""

import msgspec
import pandas as pd
import pytest
from rich.markup import escape

from cosim.closed_loop import Files
from cosim.loading import load_scenario
from cosim.survey import Survey, survey, table_of
from gri.resources import shipped


def cells(table):
    return dict(zip(*(list(column.cells) for column in table.columns), strict=True))


def test_figures_by_hand():
    """Two vehicles for 3 s: one in lane 1 at 10 m/s from the start, one that enters lane 2 at second 602, standing."""
    scenario = load_scenario("us101_car_following")
    samples = pd.DataFrame(
        [(601.0, "through.0", 5.0, 1, 10.0)]
        + [(t, v, size, lane, speed) for t in (602.0, 603.0) for v, size, lane, speed in
           (("through.0", 5.0, 1, 10.0), ("entering.1", 12.0, 2, 0.0))],
        columns=["time", "vehicle", "length", "lane", "v"],
    )  # fmt: skip
    rows = cells(table_of(scenario, Survey(samples, -3.25, 7, 1, 2)))
    assert rows[escape("mean speed [km/h]")] == "21.6"  # (3·10 + 2·0) / 5 = 6 m/s
    assert rows["  by lane, from the left"] == "36, 0"
    assert rows[escape("flow into the study area [veh/h]")].startswith("1800 ")  # one vehicle in 2 s
    assert rows[escape("  from the ramp [%]")] == "100.0"
    assert rows[escape("vehicles longer than 7 m [%]")] == "100.0"
    assert rows[escape("standing (< 0.5 m/s) [% of time]")] == "40.0"
    assert rows["steps with a collision / teleports"] == "1 / 2"


@pytest.mark.parametrize("name", ["us101_car_following", "i80_car_following"])
def test_null_run_has_no_collision_and_no_teleport(name, tmp_path):
    scenario = load_scenario(name)
    scenario = msgspec.structs.replace(scenario, traffic=msgspec.structs.replace(scenario.traffic, warm_up=90.0))
    net = shipped("sumo_nets", scenario.net, f"{scenario.net}.net.xml")
    result = survey(scenario, Files(net, tmp_path / "r.rou.xml", tmp_path / "log"), 30.0, lambda *_: None)
    assert result.collisions == result.teleports == 0
    assert set(result.samples["lane"]) >= {1, 2, 3, 4, 5}
    assert result.samples["v"].mean() > 5
    assert result.samples["time"].nunique() == 30
