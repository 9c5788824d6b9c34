"""Perturbed traffic: what changes, and that nothing else does."""

import msgspec
import pytest

from cosim.perturb.traffic_demand import driver_shares, mean_spacing, perturbed_traffic
from cosim.spec.demand import Hold
from cosim.spec.loading import load_scenario, override
from cosim.spec.perturbations import (
    KINDS,
    AggressiveDrivers,
    DenserTraffic,
    HeadwayRatio,
    LowFriction,
    MoreTrucks,
    Perturbation,
)
from cosim.spec.scenario import Scenario
from cosim.traffic.route_file import route_file, sign_file
from gri.errors import InputError


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("us101_car_following")


def under(scenario: Scenario, *perturbations: Perturbation) -> Scenario:
    return perturbed_traffic(msgspec.structs.replace(scenario, perturbations=perturbations))


def test_denser_traffic_lowers_the_limits_and_the_demand_after_the_warm_up(scenario):
    """By hand for the third interval: L = 0.9709·6.6 + 0.0281·14 = 6.81 m, v = 0.78·13.1 m/s, q = 1 + 0.2/3.5.

    The spacing L + 1.4·v = 21.1 m becomes 19.97 m, so v' = 9.40 m/s = 0.92·v, and the flow q·0.92 = 0.973 of before.
    """
    found = under(scenario, DenserTraffic(intensity=1.2)).traffic
    before, after = scenario.traffic.bottleneck, found.bottleneck
    assert before is not None
    assert after is not None
    assert after.limits[2] == pytest.approx(0.92 * before.limits[2], rel=2e-3)
    for old, new in zip(scenario.traffic.flows, found.flows, strict=True):
        assert new.per_hour[:2] == pytest.approx(old.per_hour[:2])  # the warm-up, in which the queue fills
        assert new.per_hour[2] == pytest.approx(0.973 * old.per_hour[2], rel=2e-3)
    assert found.vehicles == scenario.traffic.vehicles


def test_denser_traffic_where_the_queue_fills_the_road():
    """The spacing at the speed of the queue is smaller by 1 + 0.25/0.85; the carpool lane stays as it is."""
    traffic = load_scenario("i80_car_following").traffic
    found = under(load_scenario("i80_car_following"), DenserTraffic(intensity=1.25)).traffic
    assert traffic.bottleneck is not None
    assert found.bottleneck is not None
    v, slower = (0.78 * of.limits[0] for of in (traffic.bottleneck, found.bottleneck))
    assert mean_spacing(traffic, v) / mean_spacing(traffic, slower) == pytest.approx(1 + 0.25 / 0.85)
    rates = {
        flow.name: (flow.per_hour[-1], new.per_hour[-1]) for flow, new in zip(traffic.flows, found.flows, strict=True)
    }
    carried = mean_spacing(traffic, v) / v * slower / mean_spacing(traffic, slower)
    assert rates["through"][1] == pytest.approx(carried * rates["through"][0])
    assert rates["carpool"][1] == rates["carpool"][0]  # its lane has no bottleneck


def test_the_road_fills_with_as_many_vehicles_as_it_is_to_have():
    """I-80 at 1.25: 8,208 veh/h at 0.78·9.5 m/s are 308 veh/km, a quarter of them on 3 · 0.505 km 117."""
    scenario = load_scenario("i80_car_following")
    before, after = scenario.traffic, under(scenario, DenserTraffic(intensity=1.25)).traffic
    in_queue = [(old, new) for old, new in zip(before.flows, after.flows, strict=True) if old.name != "carpool"]
    last = in_queue[0][1].per_hour[-1] / in_queue[0][0].per_hour[-1]
    through, of_through = in_queue[0]
    factors = [of_through.per_hour[k] / through.per_hour[k] for k in (0, 1)]
    demand = [sum(flow.per_hour[min(k, len(flow.per_hour) - 1)] for flow in before.flows) for k in (0, 1)]
    more = sum((factor - last) * rate / 12 for factor, rate in zip(factors, demand, strict=True))
    assert more == pytest.approx(3 * 0.505 * 0.25 * 8208 / (3.6 * 0.78 * 9.5))
    assert last < factors[0] < 1


def test_a_held_speed_becomes_that_of_the_denser_traffic(scenario):
    """Third interval, as above: the flow is 0.973 of before and the density 1.2, so the speed is 0.973/1.2."""
    hold = Hold(edges=("entry",), mean_speed=(13.0, 13.0, 12.0))
    bottleneck = msgspec.structs.replace(scenario.traffic.bottleneck, hold=hold)
    held = msgspec.structs.replace(scenario, traffic=msgspec.structs.replace(scenario.traffic, bottleneck=bottleneck))
    found = under(held, DenserTraffic(intensity=1.2)).traffic.bottleneck
    assert found is not None
    assert found.hold is not None
    assert found.hold.mean_speed[2] == pytest.approx(0.973 / 1.2 * 12.0, rel=2e-3)
    assert len(found.hold.mean_speed) == len(found.limits)  # one per interval, as the limits differ


def test_after_the_warm_up_the_demand_is_lower_however_short_the_lists_are(scenario):
    """One rate that continues must not continue with the vehicles that fill the road."""
    flows = tuple(msgspec.structs.replace(flow, per_hour=flow.per_hour[:1]) for flow in scenario.traffic.flows)
    bottleneck = msgspec.structs.replace(scenario.traffic.bottleneck, limits=(13.0,))
    traffic = msgspec.structs.replace(scenario.traffic, flows=flows, bottleneck=bottleneck)
    found = under(msgspec.structs.replace(scenario, traffic=traffic), DenserTraffic(intensity=1.2)).traffic
    rates = found.flows[0].per_hour
    assert len(rates) == 3
    assert rates[0] == rates[1] > rates[2]


def test_denser_traffic_without_a_bottleneck_is_more_demand(scenario):
    free = msgspec.structs.replace(scenario, traffic=msgspec.structs.replace(scenario.traffic, bottleneck=None))
    found = under(free, DenserTraffic(intensity=1.2)).traffic
    for before, after in zip(free.traffic.flows, found.flows, strict=True):
        assert after.per_hour[: len(before.per_hour)] == pytest.approx([1.2 * rate for rate in before.per_hour])


@pytest.mark.parametrize(
    "spec",
    [
        DenserTraffic(intensity=1.0),
        MoreTrucks(intensity=0.0),
        AggressiveDrivers(intensity=0.0),
        LowFriction(intensity=1.0),
    ],
    ids=lambda spec: spec.kind,
)
def test_the_neutral_intensity_leaves_the_traffic_as_it_is(scenario, spec):
    assert spec.neutral == spec.intensity
    assert under(scenario, spec).traffic == scenario.traffic


@pytest.mark.parametrize("spec", [MoreTrucks(intensity=0.5), AggressiveDrivers(intensity=1.0)])
def test_other_drivers_get_the_demand_that_the_queue_carries_at_the_same_speed(scenario, spec):
    before, after = scenario.traffic, under(scenario, spec).traffic
    assert after.bottleneck == before.bottleneck
    for k, limit in enumerate(before.bottleneck.limits):
        flow = [v / mean_spacing(of, v) for of in (before, after) for v in (0.78 * limit,)]
        assert after.flows[0].per_hour[k] / before.flows[0].per_hour[k] == pytest.approx(flow[1] / flow[0], rel=1e-4)


def test_shares_of_the_drivers_in_the_demand(scenario):
    found = driver_shares(under(scenario, AggressiveDrivers(intensity=0.25)).traffic)
    assert sum(found.values()) == pytest.approx(1)
    assert found["aggressive_car"] == pytest.approx(0.25 * driver_shares(scenario.traffic)["car"], rel=1e-3)


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
    assert found.friction == 0.2  # for which SUMO's drivers slow down before bends
    assert under(scenario, LowFriction(intensity=1.0)).traffic == scenario.traffic


def test_what_happens_at_the_take_over_leaves_the_traffic_alone(scenario):
    assert under(scenario, HeadwayRatio(intensity=0.5)).traffic == scenario.traffic
    assert under(scenario).traffic == scenario.traffic


@pytest.mark.parametrize("kind", ["denser_traffic", "more_trucks", "aggressive_drivers", "low_friction"])
def test_perturbed_traffic_is_a_valid_scenario_and_makes_routes(scenario, kind):
    for intensity in KINDS[kind].default_intensities:
        block = {"kind": kind, "intensity": intensity}
        changed = perturbed_traffic(override(scenario, {"perturbations": [block]}))
        checked = msgspec.convert(msgspec.to_builtins(changed), Scenario)
        files = [(route_file(of.traffic, 1, 60.0), sign_file(of.traffic)) for of in (checked, scenario)]
        assert files[0] != files[1]


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
        ({"kind": "action_delay", "intensity": 1, "seconds": 2}, "seconds"),
        ({"kind": "latency", "intensity": 1}, "'latency', which has been replaced by perception_latency .* and loc"),
        ({"kind": "denser_demand", "intensity": 1.1}, "replaced by denser_traffic"),
    ],
)
def test_bad_blocks_are_refused(scenario, block, message):
    with pytest.raises(InputError, match=message):
        override(scenario, {"perturbations": [block]})
