"""`cosim new`: from a SUMO configuration to a scenario that runs."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cosim.commands.cli import app
from cosim.spec.loading import load_scenario
from gri.errors import InputError
from gri.resources import shipped

pytestmark = pytest.mark.usefixtures("forked_workers")
ROUTES = """<routes>
  <vType id="quick" sigma="0.4"/>
  <flow id="main" type="quick" from="entry" to="downstream" begin="0" end="600" vehsPerHour="6000" departLane="random"
    departSpeed="max"/>
  <flow id="ramp" type="quick" from="on_ramp" to="downstream" begin="0" end="600" vehsPerHour="900"/>
</routes>
"""


@pytest.fixture
def configuration(tmp_path: Path) -> Path:
    """A configuration with trips of its own on a shipped net."""
    net = shipped("sumo_nets", "us101", "us101.net.xml")
    (tmp_path / "mine.rou.xml").write_text(ROUTES)
    path = tmp_path / "mine.sumocfg"
    path.write_text(
        f'<configuration><net-file value="{net}"/><route-files value="mine.rou.xml"/>'
        '<step-length value="1"/></configuration>'
    )
    return path


def test_a_picture_of_the_user_is_not_overwritten(configuration: Path) -> None:
    configuration.with_suffix(".png").write_text("a picture of mine")
    with pytest.raises(InputError, match=r"mine\.png: the file is there already"):
        CliRunner().invoke(app, ["new", str(configuration)], catch_exceptions=False)
    assert configuration.with_suffix(".png").read_text() == "a picture of mine"


def test_a_proposed_scenario_names_the_road_and_has_groups(configuration: Path) -> None:
    configuration.with_suffix(".log").write_text("what SUMO said in another run")  # users have logs of this name
    done = CliRunner().invoke(app, ["new", str(configuration), "--seconds", "60", "--rule", "car_following"])
    assert done.exit_code == 0, done.output
    path = configuration.with_suffix(".yaml")
    scenario = load_scenario(str(path))
    assert scenario.road.edges == ("entry", "weave", "exit", "downstream_free", "downstream")
    assert scenario.traffic.sumocfg == str(configuration)
    assert path.with_suffix(".png").is_file()
    assert "Your step-length = 1 is replaced by the coupling's" in done.output
    found = re.search(r"car following: (\d+) groups found", done.output)
    assert found is not None
    assert int(found[1]) >= 5
    assert max(map(len, done.output.splitlines())) <= 80 or str(path) in done.output
    assert path.with_suffix(".log").read_text() == "what SUMO said in another run"


def test_a_file_that_is_there_is_not_overwritten(configuration: Path) -> None:
    configuration.with_suffix(".yaml").write_text("mine")
    done = CliRunner().invoke(app, ["new", str(configuration)])
    assert "the file is there already" in str(done.exception)
    assert configuration.with_suffix(".yaml").read_text() == "mine"
