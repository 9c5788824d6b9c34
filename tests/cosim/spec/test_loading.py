"""Scenario files: what is accepted, and what a person is told about what is not."""

import json
import re

import msgspec
import pytest
import yaml

from cosim.spec.loading import json_schema, load_scenario, override, shipped_names
from cosim.spec.scenario import CarFollowing, Scenario
from gri.errors import InputError
from gri.resources import shipped


@pytest.fixture
def scenario_file(tmp_path):
    """Write a variant of the shipped scenario: a function of (old, new) text replacements."""

    def write(*replacements: tuple[str, str]):
        text = shipped("scenarios", "us101_car_following.yaml").read_text()
        for old, new in replacements:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return str(path)

    return write


@pytest.mark.parametrize("name", shipped_names("scenarios"))
def test_every_shipped_scenario_loads(name):
    assert isinstance(load_scenario(name), Scenario)


def test_values_arrive_typed():
    scenario = load_scenario("us101_car_following")
    assert isinstance(scenario.group, CarFollowing)
    assert scenario.group.max_time_gap == 2.5
    assert scenario.steps(scenario.horizon) == 40
    assert {vehicle.name for vehicle in scenario.traffic.vehicles} == {"car", "truck"}


def test_a_scenario_survives_its_own_serialisation():
    scenario = load_scenario("us101_car_following")
    assert msgspec.json.decode(msgspec.json.encode(scenario), type=Scenario) == scenario


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("horizon: 8.0", "horizn: 8.0", r"mine.yaml:\d+: field horizn: unknown field; did you mean 'horizon'\?"),
        (
            "  max_gap: 45",
            "  max_gpa: 45",
            r"mine.yaml:\d+: field group.max_gpa: unknown field; did you mean 'max_gap'\?",
        ),
        ("horizon: 8.0", "horizon: -8.0", r"mine.yaml:\d+: field horizon: expected `float` > 0"),
        ("horizon: 8.0", "horizon: long", r"mine.yaml:\d+: field horizon: expected `float`, got `str`"),
        ("horizon: 8.0", "horizon: 8.1", r"horizon is 8.1 s, expected a multiple of step = 0.2 s"),
        ("seed: 1", "seed: 1.5", r"mine.yaml:\d+: field seed: expected `int`"),
        ("episodes: 30", "episodes: 0", r"mine.yaml:\d+: field episodes: expected `int` >= 1"),
        ("rule: car_following", "rule: car_folowing", r"group.rule: invalid value 'car_folowing'"),
        ("net: us101\n", "", r"missing required field `net`"),
        ("origin: entry", "origin: entrance", r"origin 'entrance' is not among the road's edges"),
        ("seed: 1\n", "seed: 1\nseed: 2\n", r"mine.yaml:\d+: field seed is given twice"),
        ("seed: 1\n", "seed: [1\n", r"mine.yaml:\d+: not valid YAML"),
        ("traffic: us101_congested", "traffic: us101_congestd", r"did you mean 'us101_congested'\?"),
    ],
)
def test_bad_input_is_told_with_file_line_and_field(scenario_file, old, new, message):
    with pytest.raises(InputError) as error:
        load_scenario(scenario_file((old, new)))
    assert re.search(message, str(error.value)), str(error.value)
    assert "\n" not in str(error.value)


def test_the_line_is_the_right_one(scenario_file):
    path = scenario_file(("horizon: 8.0", "horizon: -8.0"))
    with open(path) as file:
        line = next(k for k, text in enumerate(file, 1) if text.startswith("horizon"))
    with pytest.raises(InputError, match=f"mine.yaml:{line}: field horizon"):
        load_scenario(path)


def test_unknown_scenario_names_the_closest():
    with pytest.raises(InputError, match="did you mean 'us101_car_following'"):
        load_scenario("us101_car_folowing")


def test_binary_and_empty_files_are_refused(tmp_path):
    (tmp_path / "a.yaml").write_bytes(b"\xff\xfe\x00junk")
    (tmp_path / "b.yaml").write_text("")
    with pytest.raises(InputError, match="not a text file"):
        load_scenario(str(tmp_path / "a.yaml"))
    with pytest.raises(InputError, match="expected `object`, got `null`"):
        load_scenario(str(tmp_path / "b.yaml"))


def test_shares_and_classes_of_flows_are_checked(tmp_path, scenario_file):
    traffic = yaml.safe_load(shipped("scenarios/traffic", "us101_congested.yaml").read_text())
    traffic["flows"][0]["classes"] = {"car": 0.5, "lorry": 0.5}
    (tmp_path / "traffic.yaml").write_text(yaml.safe_dump(traffic))
    with pytest.raises(InputError, match=r"traffic.yaml.*names the vehicle class 'lorry', expected one of"):
        load_scenario(scenario_file(("traffic: us101_congested", "traffic: traffic.yaml")))


def test_overrides_are_checked_like_files():
    scenario = load_scenario("us101_car_following")
    assert override(scenario, {"seed": 7}).seed == 7
    with pytest.raises(InputError, match="episodes: Expected `int` >= 1, got 0"):
        override(scenario, {"episodes": 0})


def test_schema_describes_every_field_of_a_shipped_file():
    schema = json_schema()
    json.dumps(schema)
    properties = schema["$defs"]["Scenario"]["properties"]
    content = yaml.safe_load(shipped("scenarios", "us101_car_following.yaml").read_text())
    assert set(content) <= set(properties)
    assert {"type": "string"} in properties["traffic"]["anyOf"]


def test_models_without_an_imperfection_refuse_one():
    drivers = load_scenario("us101_car_following").traffic.vehicles[0]
    assert drivers.imperfection == 0.3
    with pytest.raises(ValueError, match="EIDM has no such parameter; expected imperfection: 0"):
        msgspec.structs.replace(drivers, car_following="EIDM")
    assert msgspec.structs.replace(drivers, car_following="IDM", imperfection=0.0).imperfection == 0
