"""Perturbations of the traffic itself: Scenario in, Scenario out."""

import math
from collections.abc import Sequence
from functools import partial, reduce

from msgspec.structs import replace

from cosim.spec.demand import Flow, Traffic, VehicleClass
from cosim.spec.perturbations import AggressiveDrivers, DenserTraffic, LowFriction, MoreTrucks, Perturbation
from cosim.spec.scenario import Scenario

GRAVITY = 9.81  # [m/s^2]
TRUCK = "truck"
QUEUE_SPEED = 0.78  # speed in the queue before a bottleneck, as a share of its limit (sumo_nets/us101/README.md)
MIN_SLOWER = 0.1  # least factor on the speed in the queue; beyond, the queue would stand


def perturbed_traffic(scenario: Scenario) -> Scenario:
    """The scenario with its traffic perturbed. Call it once: a second call perturbs the traffic again."""
    change = partial(_traffic, length=scenario.road.length / 1000)
    return replace(scenario, traffic=reduce(change, scenario.perturbations, scenario.traffic))


def _traffic(traffic: Traffic, perturbation: Perturbation, *, length: float) -> Traffic:
    """The perturbed traffic of a study area of `length` [km]."""
    match perturbation:
        case DenserTraffic(intensity=factor) if factor != 1:
            return _denser(traffic, factor, length)
        case MoreTrucks(intensity=share):
            trucks = {vehicles.name for vehicles in traffic.vehicles if vehicles.v_class == TRUCK}
            flows = tuple(_with_trucks(flow, trucks, share) for flow in traffic.flows)
            return traffic if flows == traffic.flows else _carried(replace(traffic, flows=flows), traffic)
        case AggressiveDrivers(intensity=share) if share > 0:
            return _carried(_aggressive(traffic, share), traffic)
        case LowFriction(intensity=friction) if friction < 1:
            vehicles = tuple(_slippery(vehicles, friction) for vehicles in traffic.vehicles)
            return replace(traffic, vehicles=vehicles, friction=friction)
        case _:
            return traffic


def mean_spacing(traffic: Traffic, v: float) -> float:
    """Mean distance [m] from front to front in a queue at the speed `v` [m/s]: length + minimum gap + tau·v."""
    classes = {vehicles.name: vehicles for vehicles in traffic.vehicles}
    parts = [
        (sum(flow.per_hour) / len(flow.per_hour) * share, classes[name])
        for flow in traffic.flows
        for name, share in flow.classes.items()
    ]
    total = sum(rate for rate, _ in parts)
    if total == 0:
        return 0.0
    return sum(rate * (kind.length + kind.min_gap + kind.tau * v) for rate, kind in parts) / total


def driver_shares(traffic: Traffic) -> dict[str, float]:
    """The share of each vehicle class in the demand of all flows together."""
    shares = dict.fromkeys((vehicles.name for vehicles in traffic.vehicles), 0.0)
    for flow in traffic.flows:
        for name, share in flow.classes.items():
            shares[name] += share * sum(flow.per_hour) / len(flow.per_hour)
    total = sum(shares.values())
    return {name: rate / total for name, rate in shares.items()} if total else shares


def _at(values: Sequence[float], interval: int) -> float:
    """The value of a demand interval; the last one continues."""
    return values[min(interval, len(values) - 1)]


def _intervals(traffic: Traffic) -> range:
    """The demand intervals that differ in any way, those of the warm-up and the one behind it."""
    limits = () if traffic.bottleneck is None else traffic.bottleneck.limits
    held = () if traffic.bottleneck is None or traffic.bottleneck.hold is None else traffic.bottleneck.hold.mean_speed
    warm_up = math.ceil(traffic.warm_up / traffic.interval) + 1
    return range(max(len(limits), len(held), warm_up, *(len(flow.per_hour) for flow in traffic.flows)))


def _carried(traffic: Traffic, before: Traffic) -> Traffic:
    """The traffic with the demand that the queue carries at the same speed as `before`.

    In a queue at the speed v a lane carries v/spacing vehicles per second. So the demand changes by the ratio of the
    mean spacings. Without a bottleneck there is no such queue, and the demand stays.
    """
    if traffic.bottleneck is None or not mean_spacing(before, 0.0):
        return traffic
    speeds = [QUEUE_SPEED * _at(traffic.bottleneck.limits, k) for k in _intervals(traffic)]
    factors = [mean_spacing(before, v) / mean_spacing(traffic, v) for v in speeds]
    return _scaled(traffic, factors)


def _scaled(traffic: Traffic, factors: Sequence[float]) -> Traffic:
    """The traffic with the demand of each interval multiplied by its factor."""
    flows = tuple(
        replace(flow, per_hour=tuple(_at(flow.per_hour, k) * factor for k, factor in enumerate(factors)))
        for flow in traffic.flows
    )
    return replace(traffic, flows=flows)


def _denser(traffic: Traffic, factor: float, length: float) -> Traffic:
    """The traffic with a density in the study area that is higher by the factor.

    The queue must become denser by the factor q = 1 + (factor − 1)/`density_response`. In a queue at the speed v,
    density is 1/spacing(v). So the bottleneck's limits become those at which the spacing is smaller by q. The demand is
    what the queue carries then, that is q·v'/v of what it was. Only during the warm-up it is higher, until the vehicles
    that make the road denser are there (`_filling`). Flows beside the bottleneck's lanes keep their demand. Without a
    bottleneck all flows get the factor. A held mean speed becomes that of this flow at this density.
    """
    bottleneck = traffic.bottleneck
    if bottleneck is None or not mean_spacing(traffic, 0.0):
        return _scaled(traffic, [factor] * len(_intervals(traffic)))
    denser = 1 + (factor - 1) / bottleneck.density_response
    standing, per_speed = mean_spacing(traffic, 0.0), mean_spacing(traffic, 1.0) - mean_spacing(traffic, 0.0)
    slower = []
    for k in _intervals(traffic):
        v = QUEUE_SPEED * _at(bottleneck.limits, k)
        slower.append(max(((standing + per_speed * v) / denser - standing) / (per_speed * v), MIN_SLOWER))
    carried = _filling(traffic, factor, [denser * part for part in slower], length)
    limits = tuple(_at(bottleneck.limits, k) * part for k, part in enumerate(slower))
    numbers = {lane.rpartition("_")[2] for lane in bottleneck.lanes}
    flows = tuple(
        replace(
            flow,
            per_hour=tuple(
                _at(flow.per_hour, k) * (part if any(str(lane) in numbers for lane in flow.lanes) else 1.0)
                for k, part in enumerate(carried)
            ),
        )
        for flow in traffic.flows
    )
    hold = bottleneck.hold
    if hold is not None:  # flow = density · speed in the study area
        ratios = [denser * part / factor for part in slower]
        hold = replace(hold, mean_speed=tuple(_at(hold.mean_speed, k) * ratio for k, ratio in enumerate(ratios)))
    return replace(traffic, flows=flows, bottleneck=replace(bottleneck, limits=limits, hold=hold))


def _filling(traffic: Traffic, factor: float, carried: Sequence[float], length: float) -> list[float]:
    """The factors on the demand of each interval: those that are `carried`, and more during the warm-up.

    The vehicles that come in addition are as many as make three times the length of the study area denser by the
    factor: the queue reaches beyond it on both sides, and some pass before it has formed. At most the demand of the
    warm-up stays as it was.
    """
    assert traffic.bottleneck is not None, "checked by `_denser`"
    flow = [sum(_at(flow.per_hour, k) for flow in traffic.flows) for k in range(len(carried))]
    filling = [k for k in range(len(carried)) if k * traffic.interval < traffic.warm_up]
    first = min(len(filling), len(carried) - 1)
    density = flow[first] / (3.6 * QUEUE_SPEED * _at(traffic.bottleneck.limits, first))  # [veh/km]
    possible = sum((1 - carried[k]) * flow[k] for k in filling) * traffic.interval / 3600
    share = min(3 * length * (factor - 1) * density / possible, 1.0) if possible else 0.0
    return [part + (1 - part) * share if k in filling else part for k, part in enumerate(carried)]


def _with_trucks(flow: Flow, trucks: set[str], share: float) -> Flow:
    before = sum(part for name, part in flow.classes.items() if name in trucks)
    if not 0 < before < 1 or share <= before:
        return flow
    scale = {True: share / before, False: (1 - share) / (1 - before)}
    return replace(flow, classes={name: part * scale[name in trucks] for name, part in flow.classes.items()})


def _aggressive(traffic: Traffic, share: float) -> Traffic:
    """The traffic with an aggressive variant of every vehicle class but trucks, at the given share."""
    names = {vehicles.name: f"aggressive_{vehicles.name}" for vehicles in traffic.vehicles if vehicles.v_class != TRUCK}
    variants = tuple(
        _aggressive_class(vehicles, names[vehicles.name]) for vehicles in traffic.vehicles if vehicles.name in names
    )
    flows = []
    for flow in traffic.flows:
        calm = {name: part * (1 - share) if name in names else part for name, part in flow.classes.items()}
        aggressive = {names[name]: part * share for name, part in flow.classes.items() if name in names}
        flows.append(replace(flow, classes=calm | aggressive))
    return replace(traffic, vehicles=traffic.vehicles + variants, flows=tuple(flows))


def _aggressive_class(vehicles: VehicleClass, name: str) -> VehicleClass:
    kind, lane = AggressiveDrivers, vehicles.lane_changing
    return replace(
        vehicles,
        name=name,
        tau=vehicles.tau * kind.time_headway,
        min_gap=vehicles.min_gap * kind.gap,
        acceleration=vehicles.acceleration * kind.acceleration,
        deceleration=max(vehicles.deceleration, kind.deceleration),
        lane_changing=replace(
            lane,
            speed_gain=lane.speed_gain * kind.lane_changing,
            assertive=lane.assertive * kind.lane_changing,
        ),
    )


def _slippery(vehicles: VehicleClass, friction: float) -> VehicleClass:
    """The vehicle class with accelerations that a slippery road allows, which its drivers know."""
    limit = friction * GRAVITY
    return replace(
        vehicles,
        acceleration=min(vehicles.acceleration, limit),
        deceleration=min(vehicles.deceleration, limit),
        emergency_deceleration=min(vehicles.emergency_deceleration, limit),
    )
