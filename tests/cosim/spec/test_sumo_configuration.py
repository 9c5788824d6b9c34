"""SUMO files of the user: what is read, what stays, what is refused."""

from pathlib import Path

import pytest

from cosim.spec.demand import Traffic
from cosim.spec.loading import load_scenario
from cosim.spec.sumo_configuration import configuration, read_configuration
from gri.errors import InputError
from gri.resources import shipped

CONFIGURATION = """<configuration>
  <input>
    <net-file value="road.net.xml"/><route-files value="a.rou.xml, b.rou.xml"/><a v="more.add.xml"/>
  </input>
  <time><begin value="0:10:00"/><end value="3600"/><step-length value="0.5"/></time>
  <processing><time-to-teleport value="120"/><lateral-resolution value="0.8"/></processing>
  <output><fcd-output value="positions.xml"/></output>
  <gui_only><start value="true"/><gui-settings-file value="view.xml"/></gui_only>
</configuration>
"""
SCENARIO = """road: {edges: [entry], origin: entry, length: 100}
traffic: {sumocfg: mine.sumocfg}
group: {rule: car_following}
policy: {kind: idm}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a configuration and the files it names."""
    (tmp_path / "mine.sumocfg").write_text(CONFIGURATION)
    for name in ("road.net.xml", "a.rou.xml", "b.rou.xml", "more.add.xml"):
        (tmp_path / name).write_text("<routes/>")
    return tmp_path


def test_files_are_looked_for_beside_the_configuration_and_times_are_read(folder: Path) -> None:
    found = configuration(Traffic(sumocfg=str(folder / "mine.sumocfg")))
    assert found.net == folder / "road.net.xml"
    assert [path.name for path in found.routes] == ["a.rou.xml", "b.rou.xml"]
    assert found.additional == (folder / "more.add.xml",)
    assert (found.begin, found.end) == (600.0, 3600.0)
    assert set(found.files) == {"net", "routes.0", "routes.1", "additional.0"}


def test_all_but_the_options_of_the_coupling_windows_and_output_stay_the_users(folder: Path) -> None:
    found = configuration(Traffic(sumocfg=str(folder / "mine.sumocfg"), options={"scale": 1.5, "sloppy-insert": True}))
    assert found.options == {
        "begin": "0:10:00",
        "time-to-teleport": "120",
        "lateral-resolution": "0.8",
        "scale": "1.5",
        "sloppy-insert": "true",
    }
    assert found.replaced == {"step-length": "0.5"}


def test_lists_of_files_replace_those_of_the_configuration(folder: Path) -> None:
    own = folder / "own.rou.xml"
    own.write_text("<routes/>")
    found = configuration(Traffic(sumocfg=str(folder / "mine.sumocfg"), routes=(str(own),)))
    assert found.routes == (own,)
    assert found.additional == (folder / "more.add.xml",)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("mesosim", "true", "option mesosim, which cannot be used here: the mesoscopic model has no positions"),
        ("load-state", "x.xml", "option load-state"),
        ("begin", "noon", "begin is 'noon', expected seconds or hours:minutes:seconds"),
        ("route-files", "x.xml", "got route-files; name files in net, traffic.routes and traffic.additional"),
    ],
)
def test_options_that_cannot_work_are_refused_by_name(folder: Path, name: str, value: str, message: str) -> None:
    with pytest.raises(InputError, match=message.replace("(", r"\(")):
        configuration(Traffic(sumocfg=str(folder / "mine.sumocfg"), options={name: value}))


def test_a_missing_file_is_named(folder: Path) -> None:
    (folder / "b.rou.xml").unlink()
    with pytest.raises(InputError, match=r"mine.sumocfg: route-files names .*b.rou.xml, but there is no such file"):
        configuration(Traffic(sumocfg=str(folder / "mine.sumocfg")))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<configuration>", r":1: not well-formed XML"),
        ("<net/>", r"got a <net> file, expected a SUMO <configuration>"),
        ('<?xml version="1.0" encoding="nowhere"?><configuration/>', "cannot be read"),
    ],
)
def test_what_is_no_configuration_is_one_clear_error(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "mine.sumocfg"
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        read_configuration(path)


def test_a_scenario_takes_the_net_of_its_configuration_from_any_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "scenario.yaml").write_text(SCENARIO)
    monkeypatch.chdir(shipped("scenarios"))
    scenario = load_scenario(str(folder / "scenario.yaml"))
    assert scenario.net == str(folder / "road.net.xml")
    assert scenario.traffic.sumocfg == str(folder / "mine.sumocfg")
    assert scenario.traffic.has_own_files


@pytest.mark.parametrize(
    ("traffic", "message"),
    [
        ("{sumocfg: mine.sumocfg, flows: [{name: a, edges: [x], per_hour: [1], classes: {}, lanes: [0]}]}", "flows"),
        ("{options: {scale: 2}}", "it has options but no sumocfg and no routes"),
        ("{warm_up: 5}", "it has no vehicles, expected vehicles and flows, or SUMO files of your own"),
    ],
)
def test_traffic_is_described_in_one_way(folder: Path, traffic: str, message: str) -> None:
    (folder / "scenario.yaml").write_text(SCENARIO.replace("{sumocfg: mine.sumocfg}", traffic))
    with pytest.raises(InputError, match=message):
        load_scenario(str(folder / "scenario.yaml"))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("perturbations: [{kind: more_trucks, intensity: 0.5}]", "more_trucks, which changes the demand"),
        ("background: {kind: replay, lane_1: 2.0}", "expected one of both"),
    ],
)
def test_what_changes_the_demand_needs_traffic_that_is_described(folder: Path, line: str, message: str) -> None:
    (folder / "scenario.yaml").write_text(SCENARIO + line + "\n")
    with pytest.raises(InputError, match=message):
        load_scenario(str(folder / "scenario.yaml"))
