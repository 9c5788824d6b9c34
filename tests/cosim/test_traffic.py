"""Route files and argument lists: pure text, so they are tested without running SUMO."""

from collections import Counter
from xml.etree import ElementTree

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from cosim.demand import Bottleneck, Waves
from cosim.loading import load_scenario
from cosim.traffic import arguments, route_file, sign_file


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


def limits_of(traffic, seed, end):
    """Lanes of each sign → its limits, and the times of the last sign."""
    signs = ElementTree.fromstring(sign_file(traffic, seed, end)).findall("variableSpeedSign")
    found = {sign.get("lanes"): [float(step.get("speed")) for step in sign] for sign in signs}
    return found, [float(step.get("time")) for step in signs[-1]]


def test_a_steady_bottleneck_has_one_sign_with_a_limit_per_interval(scenario):
    limits, times = limits_of(scenario.traffic, seed=1, end=900.0)
    bottleneck = scenario.traffic.bottleneck
    assert limits == {" ".join(bottleneck.lanes): list(bottleneck.limits)}
    assert times == [0, 300, 600, 900, 1200, 1500]


def test_waves_have_the_spread_and_the_memory_they_should(scenario):
    """Standard deviation and autocorrelation exp(-lag / time) of each lane; the lanes do not know of each other."""
    bottleneck = Bottleneck(lanes=("a", "b"), limits=(20.0,), waves=Waves(sd=(1.0, 3.0), time=30.0, every=5.0))
    limits, times = limits_of(replace(scenario.traffic, bottleneck=bottleneck), seed=1, end=200_000.0)
    assert times[:3] == [0, 5, 10]
    a, b = np.array(limits["a"]), np.array(limits["b"])
    assert (a.std(), b.std()) == (pytest.approx(1, rel=0.05), pytest.approx(3, rel=0.05))
    assert (a.mean(), b.mean()) == (pytest.approx(20, abs=0.1), pytest.approx(20, abs=0.2))
    assert np.corrcoef(b[6:], b[:-6])[0, 1] == pytest.approx(np.exp(-1), abs=0.05)
    assert abs(np.corrcoef(a, b)[0, 1]) < 0.05


def test_waves_follow_the_intervals_and_stay_above_the_least_limit(scenario):
    bottleneck = Bottleneck(lanes=("a",), limits=(5.0, 25.0), waves=Waves(sd=(4.0,), least=1.0))
    limits, _ = limits_of(replace(scenario.traffic, bottleneck=bottleneck), seed=2, end=600.0)
    first, second = np.split(np.array(limits["a"]), 2)
    assert first.min() == 1.0
    assert second.mean() - first.mean() > 10


def test_waves_depend_on_the_seed_and_begin_alike_however_long(scenario):
    waving = replace(scenario.traffic, bottleneck=replace(scenario.traffic.bottleneck, waves=Waves(sd=(2.0,))))
    long, _ = limits_of(waving, seed=1, end=600.0)
    short, times = limits_of(waving, seed=1, end=300.0)
    other, _ = limits_of(waving, seed=2, end=300.0)
    assert {lane: values[: len(times)] for lane, values in long.items()} == short
    assert other != short


def test_waves_want_one_number_or_one_per_lane():
    with pytest.raises(ValueError, match=r"waves\.sd has 2 numbers, expected 1 or one per lane, 3"):
        Bottleneck(lanes=("a", "b", "c"), limits=(10.0,), waves=Waves(sd=(1.0, 2.0)))
