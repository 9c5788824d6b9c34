"""Route files and argument lists: pure text, so they are tested without running SUMO."""

from collections import Counter
from xml.etree import ElementTree

import msgspec
import pytest

from cosim.spec.loading import load_scenario
from cosim.traffic.route_file import arguments, route_file


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("us101_car_following")


@pytest.fixture(scope="module")
def routes(scenario):
    return ElementTree.fromstring(route_file(scenario.traffic, seed=1, end=900.0))


def test_every_interval_has_its_exact_count(scenario, routes):
    for flow in scenario.traffic.flows:
        departures = [float(v.get("depart")) for v in routes.iter("vehicle") if v.get("route") == flow.name]
        per_interval = Counter(int(time // 300) for time in departures)
        wanted = [flow.per_hour[min(k, len(flow.per_hour) - 1)] / 12 for k in range(3)]
        assert [per_interval[k] for k in range(3)] == pytest.approx(wanted, abs=1)
        assert len(departures) == pytest.approx(sum(wanted), abs=1)


def test_vehicles_are_sorted_and_use_what_is_defined(routes):
    times = [float(vehicle.get("depart")) for vehicle in routes.iter("vehicle")]
    assert times == sorted(times)
    types = {vtype.get("id") for vtype in routes.iter("vType")}
    assert {vehicle.get("type") for vehicle in routes.iter("vehicle")} <= types
    assert len({vehicle.get("id") for vehicle in routes.iter("vehicle")}) == len(times)


def test_shares_and_drivers_are_as_described(routes):
    kinds = Counter(v.get("type").split(".")[0] for v in routes.iter("vehicle") if v.get("route") == "through")
    assert kinds["truck"] / kinds.total() == pytest.approx(0.03, abs=0.01)
    taus = [float(t.get("tau")) for t in routes.iter("vType") if t.get("id").startswith("car")]
    assert sum(taus) / len(taus) == pytest.approx(1.4, abs=0.02)
    assert all(t.get("sigma") == "0.3" for t in routes.iter("vType"))


def test_drivers_may_be_careless_for_longer_and_follow_no_closer_than_a_least_headway(scenario):
    (car, *_) = scenario.traffic.vehicles
    lively = msgspec.structs.replace(car, imperfection_step=1.0, tau_cv=1.0, tau_min=0.5)
    traffic = msgspec.structs.replace(scenario.traffic, vehicles=(lively, *scenario.traffic.vehicles[1:]))
    types = [*ElementTree.fromstring(route_file(traffic, seed=1, end=1.0)).iter("vType")]
    assert {t.get("sigmaStep") for t in types if t.get("id").startswith("car")} == {"1"}
    assert {t.get("sigmaStep") for t in types if t.get("id").startswith("truck")} == {None}
    assert min(float(t.get("tau")) for t in types) == 0.5


def test_same_seed_same_text_other_seed_other_text(scenario):
    text = route_file(scenario.traffic, seed=1, end=100.0)
    assert route_file(scenario.traffic, seed=1, end=100.0) == text
    assert route_file(scenario.traffic, seed=2, end=100.0) != text


def test_a_longer_demand_begins_with_the_shorter_one(scenario):
    """Whole intervals do not depend on how long the demand goes on."""
    short = ElementTree.fromstring(route_file(scenario.traffic, seed=1, end=300.0))
    long = ElementTree.fromstring(route_file(scenario.traffic, seed=1, end=600.0))
    first = [vehicle.attrib for vehicle in long.iter("vehicle") if float(vehicle.get("depart")) < 300]
    assert [vehicle.attrib for vehicle in short.iter("vehicle")] == first


def test_arguments_are_plain_tokens(scenario):
    tokens = arguments(scenario, "a.net.xml", "b.rou.xml", "b.signs.xml", "c.log")
    options = dict(zip(tokens[::2], tokens[1::2], strict=True))
    assert options["--collision.action"] == "warn"
    assert options["--time-to-teleport"] == "-1"
    assert options["--seed"] == "1"
    assert options["--step-length"] == "0.2"
    changed = msgspec.structs.replace(scenario, seed=9)
    assert "9" in arguments(changed, "a", "b", "s", "c")
