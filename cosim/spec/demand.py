"""The traffic of a scenario: who drives, how many, and what slows them down downstream. Read from YAML."""

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_.\-]*$")]


class Spec(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of everything that is read from YAML."""


class LaneChanging(Spec, frozen=True, kw_only=True):
    """SUMO's lane-change model LC2013 (SUMO doc: Definition of Vehicles, Lane-Changing Models)."""

    strategic: NonNegative = 1.0
    cooperative: Share = 1.0
    speed_gain: NonNegative = 1.0
    keep_right: NonNegative = 1.0
    assertive: Positive = 1.0


class VehicleClass(Spec, frozen=True, kw_only=True):
    """A population of drivers and vehicles; `variants` types are drawn from it (SUMO doc: Vehicle Types).

    Lengths in m, accelerations in m/s², `tau` the desired time headway in s. `tau_cv` is the coefficient of variation
    of a log-normal, the other `_sd` are standard deviations of normals cut off at two of them.
    """

    name: Name
    v_class: Literal["passenger", "hov", "truck", "motorcycle"] = "passenger"
    variants: Count = 1
    length: Positive = 4.6
    length_sd: NonNegative = 0.0
    width: Positive = 1.8
    car_following: Literal["Krauss", "IDM", "EIDM"] = "Krauss"
    acceleration: Positive = 2.0
    deceleration: Positive = 3.5
    emergency_deceleration: Positive = 9.0
    imperfection: Share = 0.5
    tau: Positive = 1.2
    tau_cv: NonNegative = 0.0
    min_gap: NonNegative = 2.0
    min_gap_sd: NonNegative = 0.0
    speed_factor: Positive = 1.0
    speed_factor_sd: NonNegative = 0.0
    lane_changing: LaneChanging = field(default_factory=LaneChanging)


class Flow(Spec, frozen=True, kw_only=True):
    """Vehicles on one route. `per_hour` holds one rate per demand interval; the last one lasts for ever."""

    name: Name
    edges: Annotated[tuple[str, ...], Meta(min_length=1)]
    per_hour: Annotated[tuple[NonNegative, ...], Meta(min_length=1)]
    classes: dict[str, Share]
    lanes: Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(min_length=1)]


class Bottleneck(Spec, frozen=True, kw_only=True):
    """The downstream cause of congestion: speed limits [m/s] of some lanes, one per demand interval; the last lasts."""

    lanes: Annotated[tuple[str, ...], Meta(min_length=1)]
    limits: Annotated[tuple[Positive, ...], Meta(min_length=1)]


class Targets(Spec, frozen=True, kw_only=True):
    """What was recorded in the study area, to compare simulated traffic with. Tolerances are relative.

    `mean_speed` [m/s] is a mean over vehicles and time. `mainline` [veh/h] enter on the main road, one rate per demand
    interval after the warm-up, the last one lasts; `ramp_share` is the share of all vehicles that enter elsewhere.
    """

    mean_speed: Positive
    speed_tolerance: Share = 0.1
    mainline: Annotated[tuple[Positive, ...], Meta(min_length=1)]
    ramp_share: Share
    flow_tolerance: Share = 0.05


class Traffic(Spec, frozen=True, kw_only=True):
    """Demand, drivers, and the downstream cause of congestion."""

    warm_up: NonNegative
    interval: Positive = 300.0
    vehicles: Annotated[tuple[VehicleClass, ...], Meta(min_length=1)]
    flows: Annotated[tuple[Flow, ...], Meta(min_length=1)]
    bottleneck: Bottleneck | None = None
    targets: Targets | None = None

    def __post_init__(self) -> None:
        known = {vehicle.name for vehicle in self.vehicles}
        for flow in self.flows:
            if unknown := set(flow.classes) - known:
                raise ValueError(
                    f"flow {flow.name!r} names the vehicle class {min(unknown)!r}, expected one of {sorted(known)}"
                )
            if abs(sum(flow.classes.values()) - 1) > 1e-6:
                raise ValueError(
                    f"the class shares of flow {flow.name!r} add up to {sum(flow.classes.values()):g}, expected 1"
                )
        if len({flow.name for flow in self.flows}) < len(self.flows):
            raise ValueError("two flows have the same name, expected one name each")
