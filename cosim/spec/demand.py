"""The traffic of a scenario: vehicle classes, flows, and a downstream bottleneck. Read from YAML."""

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

# Ranges: wide enough for any road traffic, and so narrow that no value makes a run endless. Work that grows with the
# product of several values is limited in `cosim.spec.work`.
Share = Annotated[float, Meta(ge=0, le=1)]
Speed = Annotated[float, Meta(ge=0, le=150)]  # [m/s]: 540 km/h
SpeedLimit = Annotated[float, Meta(ge=0.1, le=150)]  # [m/s]
Acceleration = Annotated[float, Meta(ge=0.01, le=50)]  # [m/s²]: 50 is what a racing car reaches when it brakes
Gap = Annotated[float, Meta(ge=0, le=1000)]  # [m]: farther away nobody reacts
PositiveGap = Annotated[float, Meta(gt=0, le=1000)]  # [m]
TimeGap = Annotated[float, Meta(gt=0, le=60)]  # [s]
Distance = Annotated[float, Meta(gt=0, le=1e6)]  # [m]: 1000 km of road
Position = Annotated[float, Meta(ge=-1e6, le=1e6)]  # [m]
Duration = Annotated[float, Meta(ge=0, le=3600)]  # [s] of a part of an episode: an hour
PositiveDuration = Annotated[float, Meta(gt=0, le=3600)]  # [s]
Period = Annotated[float, Meta(ge=0, le=7 * 86400)]  # [s] of simulated or real time: a week
PositivePeriod = Annotated[float, Meta(ge=1, le=7 * 86400)]  # [s]
VehicleLength = Annotated[float, Meta(ge=0.1, le=100)]  # [m]: a road train has 53
VehicleWidth = Annotated[float, Meta(ge=0.1, le=10)]  # [m]
Rate = Annotated[float, Meta(ge=0, le=100_000)]  # [veh/h] of one flow: 40 full lanes
LaneChangeEagerness = Annotated[float, Meta(ge=0, le=1000)]
Multiple = Annotated[float, Meta(gt=0, le=10)]
Lane = Annotated[int, Meta(ge=0, le=99)]
Text = Annotated[str, Meta(max_length=10_000)]
Place = Annotated[str, Meta(min_length=1, max_length=1000)]  # a path or an id
Name = Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_.\-]*$", max_length=100)]
VehicleKind = Literal[
    "passenger", "hov", "taxi", "delivery", "truck", "trailer", "bus", "coach", "motorcycle", "emergency", "authority"
]  # SUMO's vehicle classes of motor vehicles on roads (SUMO doc: Abstract Vehicle Class)
CarFollowingModel = Literal["Krauss", "IDM", "EIDM"]


class Spec(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of all types that are read from YAML; unknown fields are errors."""


class LaneChanging(Spec, frozen=True, kw_only=True):
    """Parameters of SUMO's lane-change model LC2013 (SUMO doc: Definition of Vehicles, Lane-Changing Models)."""

    strategic: LaneChangeEagerness = 1.0
    cooperative: Share = 1.0
    speed_gain: LaneChangeEagerness = 1.0
    keep_right: LaneChangeEagerness = 1.0
    assertive: Annotated[float, Meta(ge=0.01, le=1000)] = 1.0


class VehicleClass(Spec, frozen=True, kw_only=True):
    """A population of vehicles and drivers, from which `variants` vehicle types are drawn (SUMO doc: Vehicle Types).

    Lengths and gaps in m, accelerations in m/s²; `tau` is the desired time headway [s]. `tau_cv` is the coefficient of
    variation of its log-normal distribution. Each `_sd` is the standard deviation of a normal distribution that is cut
    off at two standard deviations. `imperfection` is the sigma of Krauss's model, 0.5 unless given. IDM and EIDM have
    none; EIDM errs in what it perceives, with SUMO's default parameters.
    """

    name: Name
    v_class: VehicleKind = "passenger"
    variants: Annotated[int, Meta(ge=1, le=1000)] = 1
    length: VehicleLength = 4.6
    length_sd: Annotated[float, Meta(ge=0, le=50)] = 0.0
    width: VehicleWidth = 1.8
    car_following: CarFollowingModel = "Krauss"
    acceleration: Acceleration = 2.0
    deceleration: Acceleration = 3.5
    emergency_deceleration: Acceleration = 9.0
    imperfection: Share | None = None
    tau: Annotated[float, Meta(ge=0.01, le=60)] = 1.2
    tau_cv: Annotated[float, Meta(ge=0, le=2)] = 0.0
    min_gap: Annotated[float, Meta(ge=0, le=100)] = 2.0
    min_gap_sd: Annotated[float, Meta(ge=0, le=50)] = 0.0
    speed_factor: Multiple = 1.0
    speed_factor_sd: Annotated[float, Meta(ge=0, le=5)] = 0.0
    lane_changing: LaneChanging = field(default_factory=LaneChanging)

    def __post_init__(self) -> None:
        if self.car_following != "Krauss" and self.imperfection:
            raise ValueError(
                f"vehicle class {self.name!r} has imperfection {self.imperfection:g}, but {self.car_following} has no"
                " such parameter; expected imperfection: 0, or car_following: Krauss"
            )
        for name in ("length", "speed_factor"):
            mean, sd = getattr(self, name), getattr(self, f"{name}_sd")
            if mean <= 2 * sd:  # distributions are cut off at two standard deviations
                raise ValueError(
                    f"vehicle class {self.name!r} has {name} {mean:g} and {name}_sd {sd:g}, so some vehicles would have"
                    f" none; expected {name}_sd below {mean / 2:g}"
                )


class Flow(Spec, frozen=True, kw_only=True):
    """Vehicles on one route of `edges`.

    `per_hour` [veh/h] has one rate per demand interval; the last one continues. `classes` has the share of each vehicle
    class; vehicles enter on `lanes`, counted from 0 on the right.
    """

    name: Name
    edges: Annotated[tuple[Place, ...], Meta(min_length=1)]
    per_hour: Annotated[tuple[Rate, ...], Meta(min_length=1)]
    classes: dict[str, Share]
    lanes: Annotated[tuple[Lane, ...], Meta(min_length=1)]


class Bottleneck(Spec, frozen=True, kw_only=True):
    """The downstream cause of congestion: speed limits [m/s] of some lanes, one per demand interval.

    The last limit continues. `density_response` is by how much per cent the density in the study area rises where that
    in the queue rises by one; above 1 where the queue covers only a part of the study area, because a denser queue is
    longer, too. `denser_traffic` uses it.
    """

    lanes: Annotated[tuple[Place, ...], Meta(min_length=1)]
    limits: Annotated[tuple[SpeedLimit, ...], Meta(min_length=1)]
    density_response: Annotated[float, Meta(ge=0.1, le=10)] = 1.0


class Targets(Spec, frozen=True, kw_only=True):
    """Recorded statistics of the study area, to compare simulated traffic with. Tolerances are relative.

    `mean_speed` [m/s] is the mean over vehicles and time. `mainline` [veh/h] is the flow that enters on the main road,
    one rate per demand interval after the warm-up; the last one continues. `ramp_share` is the share of all vehicles
    that enter elsewhere.
    """

    mean_speed: SpeedLimit
    speed_tolerance: Share = 0.1
    mainline: Annotated[tuple[Annotated[float, Meta(gt=0, le=1_000_000)], ...], Meta(min_length=1)]
    ramp_share: Share
    flow_tolerance: Share = 0.05


class Traffic(Spec, frozen=True, kw_only=True):
    """The traffic: either demand, drivers and bottleneck as described here, or SUMO files of your own.

    `warm_up` [s] comes first; a demand interval lasts `interval` [s]. Your own files are a configuration (`sumocfg`),
    or `routes` and `additional` files; where both are given, the lists replace those of the configuration. `options`
    are further options of SUMO, by their long names. Paths are relative to the file that names them. The options that
    the coupling needs stay as they are (docs/own-scenarios.md). With the coefficient of `friction` of the road, SUMO's
    drivers slow down before bends (`low_friction` sets it).
    """

    warm_up: Period = 300.0
    interval: PositivePeriod = 300.0
    vehicles: tuple[VehicleClass, ...] = ()
    flows: tuple[Flow, ...] = ()
    bottleneck: Bottleneck | None = None
    targets: Targets | None = None
    friction: Annotated[float, Meta(ge=0.01, le=10)] | None = None
    sumocfg: Annotated[str, Meta(max_length=1000)] = ""
    routes: tuple[Place, ...] = ()
    additional: tuple[Place, ...] = ()
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
        if len(known) < len(self.vehicles):
            raise ValueError("two vehicle classes have the same name, expected one name each")
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
