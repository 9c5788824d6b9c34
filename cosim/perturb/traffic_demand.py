"""Perturbations of the traffic itself: Scenario in, Scenario out."""

from functools import reduce

from msgspec.structs import replace

from cosim.spec.demand import Flow, Traffic, VehicleClass
from cosim.spec.perturbations import AggressiveDrivers, DenserDemand, LowFriction, MoreTrucks, Perturbation
from cosim.spec.scenario import Scenario

GRAVITY = 9.81  # [m/s^2]
TRUCK = "truck"


def perturbed_traffic(scenario: Scenario) -> Scenario:
    """The scenario with its traffic perturbed. Call it once: a second call perturbs the traffic again."""
    return replace(scenario, traffic=reduce(_traffic, scenario.perturbations, scenario.traffic))


def _traffic(traffic: Traffic, perturbation: Perturbation) -> Traffic:
    match perturbation:
        case DenserDemand(intensity=factor):
            return replace(traffic, flows=tuple(_denser(flow, factor) for flow in traffic.flows))
        case MoreTrucks(intensity=share):
            trucks = {vehicles.name for vehicles in traffic.vehicles if vehicles.v_class == TRUCK}
            return replace(traffic, flows=tuple(_with_trucks(flow, trucks, share) for flow in traffic.flows))
        case AggressiveDrivers(intensity=share):
            return _aggressive(traffic, share)
        case LowFriction(intensity=friction):
            return replace(traffic, vehicles=tuple(_slippery(vehicles, friction) for vehicles in traffic.vehicles))
        case _:
            return traffic


def _denser(flow: Flow, factor: float) -> Flow:
    return replace(flow, per_hour=tuple(rate * factor for rate in flow.per_hour))


def _with_trucks(flow: Flow, trucks: set[str], share: float) -> Flow:
    before = sum(part for name, part in flow.classes.items() if name in trucks)
    if not 0 < before < 1:
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
