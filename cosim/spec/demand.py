"""The traffic of a scenario: vehicle classes, flows, and a downstream bottleneck. Read from YAML."""

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_.\-]*$")]
CarFollowingModel = Literal["Krauss", "IDM", "EIDM"]


class Spec(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of all types that are read from YAML; unknown fields are errors."""


class LaneChanging(Spec, frozen=True, kw_only=True):
    """Parameters of SUMO's lane-change model LC2013 (SUMO doc: Definition of Vehicles, Lane-Changing Models)."""

    strategic: NonNegative = 1.0
    cooperative: Share = 1.0
    speed_gain: NonNegative = 1.0
    keep_right: NonNegative = 1.0
    assertive: Positive = 1.0


class VehicleClass(Spec, frozen=True, kw_only=True):
    """A population of vehicles and drivers, from which `variants` vehicle types are drawn (SUMO doc: Vehicle Types).

    Lengths and gaps in m, accelerations in m/s²; `tau` is the desired time headway [s]. `tau_cv` is the coefficient of
    variation of its log-normal distribution. Each `_sd` is the standard deviation of a normal distribution that is cut
    off at two standard deviations. `imperfection` is the sigma of Krauss's model, 0.5 unless given. IDM and EIDM have
    none; EIDM errs in what it perceives, with SUMO's default parameters.
    """

    name: Name
    v_class: Literal["passenger", "hov", "truck", "motorcycle"] = "passenger"
    variants: Count = 1
    length: Positive = 4.6
    length_sd: NonNegative = 0.0
    width: Positive = 1.8
    car_following: CarFollowingModel = "Krauss"
    acceleration: Positive = 2.0
    deceleration: Positive = 3.5
    emergency_deceleration: Positive = 9.0
    imperfection: Share | None = None
    tau: Positive = 1.2
    tau_cv: NonNegative = 0.0
    min_gap: NonNegative = 2.0
    min_gap_sd: NonNegative = 0.0
    speed_factor: Positive = 1.0
    speed_factor_sd: NonNegative = 0.0
    lane_changing: LaneChanging = field(default_factory=LaneChanging)

    def __post_init__(self) -> None:
        if self.car_following != "Krauss" and self.imperfection:
            raise ValueError(
                f"vehicle class {self.name!r} has imperfection {self.imperfection:g}, but {self.car_following} has no"
                " such parameter; expected imperfection: 0, or car_following: Krauss"
            )


class Flow(Spec, frozen=True, kw_only=True):
    """Vehicles on one route of `edges`.

    `per_hour` [veh/h] has one rate per demand interval; the last one continues. `classes` has the share of each vehicle
    class; vehicles enter on `lanes`, counted from 0 on the right.
    """

    name: Name
    edges: Annotated[tuple[str, ...], Meta(min_length=1)]
    per_hour: Annotated[tuple[NonNegative, ...], Meta(min_length=1)]
    classes: dict[str, Share]
    lanes: Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(min_length=1)]


class Bottleneck(Spec, frozen=True, kw_only=True):
    """The downstream cause of congestion: speed limits [m/s] of some lanes, one per demand interval.

    The last limit continues.
    """

    lanes: Annotated[tuple[str, ...], Meta(min_length=1)]
    limits: Annotated[tuple[Positive, ...], Meta(min_length=1)]


class Targets(Spec, frozen=True, kw_only=True):
    """Recorded statistics of the study area, to compare simulated traffic with. Tolerances are relative.

    `mean_speed` [m/s] is the mean over vehicles and time. `mainline` [veh/h] is the flow that enters on the main road,
    one rate per demand interval after the warm-up; the last one continues. `ramp_share` is the share of all vehicles
    that enter elsewhere.
    """

    mean_speed: Positive
    speed_tolerance: Share = 0.1
    mainline: Annotated[tuple[Positive, ...], Meta(min_length=1)]
    ramp_share: Share
    flow_tolerance: Share = 0.05


class Traffic(Spec, frozen=True, kw_only=True):
    """The traffic: either demand, drivers and bottleneck as described here, or SUMO files of your own.

    `warm_up` [s] comes first; a demand interval lasts `interval` [s]. Your own files are a configuration (`sumocfg`),
    or `routes` and `additional` files; where both are given, the lists replace those of the configuration. `options`
    are further options of SUMO, by their long names. Paths are relative to the file that names them. The options that
    the coupling needs stay as they are (docs/own-scenarios.md).
    """

    warm_up: NonNegative = 300.0
    interval: Positive = 300.0
    vehicles: tuple[VehicleClass, ...] = ()
    flows: tuple[Flow, ...] = ()
    bottleneck: Bottleneck | None = None
    targets: Targets | None = None
    sumocfg: str = ""
    routes: tuple[str, ...] = ()
    additional: tuple[str, ...] = ()
    options: dict[str, str | int | float | bool] = field(default_factory=dict)

    @property
    def has_own_files(self) -> bool:
        """Whether vehicles and drivers come from SUMO files of the user."""
        return bool(self.sumocfg or self.routes)

    def __post_init__(self) -> None:
        if self.has_own_files:
            if described := [name for name in ("vehicles", "flows", "bottleneck") if getattr(self, name)]:
                raise ValueError(
                    f"it has SUMO files of its own and {described[0]}, expected one of both; remove {described[0]}"
                )
            return
        if own := [name for name in ("additional", "options") if getattr(self, name)]:
            raise ValueError(f"it has {own[0]} but no sumocfg and no routes, expected one of these two beside {own[0]}")
        if missing := [name for name in ("vehicles", "flows") if not getattr(self, name)]:
            raise ValueError(
                f"it has no {missing[0]}, expected vehicles and flows, or SUMO files of your own (sumocfg, or routes)"
            )
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
