"""Perturbed traffic: what changes, and that nothing else does."""

import msgspec
import pytest

from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.spec.loading import load_scenario, override
from cosim.spec.perturbations import (
    KINDS,
    AggressiveDrivers,
    DenserDemand,
    HeadwayRatio,
    LowFriction,
    MoreTrucks,
    Perturbation,
)
from cosim.spec.scenario import Scenario
from cosim.traffic.route_file import route_file
from gri.errors import InputError


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("us101_car_following")


def under(scenario: Scenario, *perturbations: Perturbation) -> Scenario:
    return perturbed_traffic(msgspec.structs.replace(scenario, perturbations=perturbations))


def test_denser_demand_multiplies_every_rate(scenario):
    found = under(scenario, DenserDemand(intensity=1.2)).traffic
    for before, after in zip(scenario.traffic.flows, found.flows, strict=True):
        assert after.per_hour == pytest.approx([1.2 * rate for rate in before.per_hour])
    assert found.vehicles == scenario.traffic.vehicles


def test_more_trucks_where_there_are_any(scenario):
    found = under(scenario, MoreTrucks(intensity=0.4)).traffic
    shares = {flow.name: flow.classes for flow in found.flows}
    assert shares["through"] == pytest.approx({"car": 0.6, "truck": 0.4})
    assert shares["entering"] == {"car": 1.0}


def test_aggressive_drivers_are_a_share_of_the_cars(scenario):
    found = under(scenario, AggressiveDrivers(intensity=0.25)).traffic
    shares = {flow.name: flow.classes for flow in found.flows}
    assert shares["through"] == pytest.approx({"car": 0.97 * 0.75, "truck": 0.03, "aggressive_car": 0.97 * 0.25})
    classes = {vehicles.name: vehicles for vehicles in found.vehicles}
    calm, hurried = classes["car"], classes["aggressive_car"]
    assert hurried.tau == pytest.approx(0.6 * calm.tau)
    assert hurried.lane_changing.assertive == 2 * calm.lane_changing.assertive
    assert "aggressive_truck" not in classes


def test_low_friction_binds_everybody(scenario):
    """0.2 · 9.81 = 1.962 m/s²; trucks accelerate with 1.2 anyway."""
    found = under(scenario, LowFriction(intensity=0.2)).traffic
    car, truck = found.vehicles
    assert car.acceleration == car.deceleration == car.emergency_deceleration == pytest.approx(1.962)
    assert truck.acceleration == 1.2
    assert under(scenario, LowFriction(intensity=1.0)).traffic == scenario.traffic


def test_what_happens_at_the_take_over_leaves_the_traffic_alone(scenario):
    assert under(scenario, HeadwayRatio(intensity=0.5)).traffic == scenario.traffic
    assert under(scenario).traffic == scenario.traffic


@pytest.mark.parametrize("kind", ["denser_demand", "more_trucks", "aggressive_drivers", "low_friction"])
def test_perturbed_traffic_is_a_valid_scenario_and_makes_routes(scenario, kind):
    for intensity in KINDS[kind].default_intensities:
        block = {"kind": kind, "intensity": intensity}
        changed = perturbed_traffic(override(scenario, {"perturbations": [block]}))
        checked = msgspec.convert(msgspec.to_builtins(changed), Scenario)
        assert route_file(checked.traffic, 1, 60.0) != route_file(scenario.traffic, 1, 60.0)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read_from_its_block(scenario, kind):
    for intensity in KINDS[kind].default_intensities:
        found = override(scenario, {"perturbations": [{"kind": kind, "intensity": intensity}]}).perturbations
        assert found == (KINDS[kind](intensity=intensity),)
        assert found[0].kind == kind


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ({"kind": "headway_ration", "intensity": 1}, "headway_ration"),
        ({"kind": "dropout", "intensity": 1.5}, "<= 1"),
        ({"kind": "dropout"}, "intensity"),
        ({"kind": "latency", "intensity": 1, "seconds": 2}, "seconds"),
    ],
)
def test_bad_blocks_are_refused(scenario, block, message):
    with pytest.raises(InputError, match=message):
        override(scenario, {"perturbations": [block]})
