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
    variation of its log-normal distribution, `tau_min` [s] its least value. Each `_sd` is the standard deviation of a
    normal distribution that is cut off at two standard deviations. `imperfection` is the sigma of Krauss's model, 0.5
    unless given, and `imperfection_step` [s] how long each of its random decelerations lasts (SUMO's sigmaStep), by
    default one step. IDM and EIDM have none; EIDM errs in what it perceives, with SUMO's default parameters.
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
    imperfection_step: Annotated[float, Meta(ge=0.01, le=60)] | None = None
    tau: Annotated[float, Meta(ge=0.01, le=60)] = 1.2
    tau_cv: Annotated[float, Meta(ge=0, le=2)] = 0.0
    tau_min: Annotated[float, Meta(ge=0, le=60)] = 0.0
    min_gap: Annotated[float, Meta(ge=0, le=100)] = 2.0
    min_gap_sd: Annotated[float, Meta(ge=0, le=50)] = 0.0
    speed_factor: Multiple = 1.0
    speed_factor_sd: Annotated[float, Meta(ge=0, le=5)] = 0.0
    lane_changing: LaneChanging = field(default_factory=LaneChanging)

    def __post_init__(self) -> None:
        for name in ("imperfection", "imperfection_step"):
            if self.car_following == "Krauss" or not (value := getattr(self, name)):
                continue
            raise ValueError(
                f"vehicle class {self.name!r} has {name} {value:g}, but {self.car_following} has no"
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


class Fluctuation(Spec, frozen=True, kw_only=True):
    """Random changes of a bottleneck's limits, which send waves upstream: a log-normal process per lane.

    `sd` is the standard deviation of the logarithm (`lane_sd`: that of single lanes), `correlation_time` [s] how long
    a change lasts, `lane_correlation` the correlation between two lanes at one time. With a `period` [s] the limits
    swing: changes then recur about every period, for about the correlation time.
    """

    sd: Annotated[float, Meta(ge=0, le=2)]
    correlation_time: PositivePeriod = 20.0
    lane_correlation: Share = 0.0
    period: PositivePeriod | None = None
    lane_sd: dict[Place, Annotated[float, Meta(ge=0, le=2)]] = field(default_factory=dict)


class Pulses(Spec, frozen=True, kw_only=True):
    """Times at which traffic all but stands at the bottleneck, which send stop waves upstream.

    On each of `lanes` the limit falls to `limit` [m/s] for `duration` [s], the first time at `first` [s], and again
    every `period` [s]; `period_cv` is the spread of the periods (that of their logarithm). The limit falls and rises at
    the rates `falling` and `rising` [m/s²]: abrupt changes make SUMO's drivers brake as in an emergency.
    """

    lanes: Annotated[tuple[Place, ...], Meta(min_length=1)]
    limit: SpeedLimit = 0.6
    duration: PositivePeriod = 45.0
    period: PositivePeriod = 180.0
    period_cv: Annotated[float, Meta(ge=0, le=1)] = 0.0
    first: Period = 60.0
    falling: Acceleration = 1.5
    rising: Acceleration = 2.0


class Hold(Spec, frozen=True, kw_only=True):
    """Feedback that holds the mean speed on `edges` (the study area) by a factor on the bottleneck's limits.

    `mean_speed` [m/s] is the target, one per demand interval; the last one continues. The feedback is
    proportional-integral in the relative error of the mean over `window` [s]: `gain`, and `integral_time` [s]. It
    begins at `start` [s]. Errors count up to `largest_error`, and the factor stays
    between 1/`largest_factor` and `largest_factor`.
    What happens within the last `delay` [s] has no effect, so that drives that are no longer change no limits.
    """

    edges: Annotated[tuple[Place, ...], Meta(min_length=1)]
    mean_speed: Annotated[tuple[SpeedLimit, ...], Meta(min_length=1)]
    gain: Annotated[float, Meta(ge=0, le=10)] = 0.5
    integral_time: PositivePeriod = 300.0
    window: PositivePeriod = 60.0
    delay: PositivePeriod = 30.0
    start: Period = 200.0
    largest_error: Annotated[float, Meta(gt=0, le=10)] = 0.5
    largest_factor: Annotated[float, Meta(gt=1, le=10)] = 1.6


class Bottleneck(Spec, frozen=True, kw_only=True):
    """The downstream cause of congestion: speed limits [m/s] of some lanes, one per demand interval.

    The last limit continues. `density_response` is by how much per cent the density in the study area rises where that
    in the queue rises by one; above 1 where the queue covers only a part of the study area, because a denser queue is
    longer, too. `denser_traffic` uses it. With `fluctuation`, `pulses` or `hold` the limits change every second, at
    once; with `changes: gradual` they move from one value to the next in every step of that second, so that no vehicle
    meets in one step what its limit fell in a second.
    """

    lanes: Annotated[tuple[Place, ...], Meta(min_length=1)]
    limits: Annotated[tuple[SpeedLimit, ...], Meta(min_length=1)]
    density_response: Annotated[float, Meta(ge=0.1, le=10)] = 1.0
    fluctuation: Fluctuation | None = None
    pulses: Pulses | None = None
    hold: Hold | None = None
    changes: Literal["at_once", "gradual"] = "at_once"

    @property
    def moves(self) -> bool:
        """Whether the limits change within a demand interval."""
        return any(part is not None for part in (self.fluctuation, self.pulses, self.hold))

    def __post_init__(self) -> None:
        named = (
            ("pulses.lanes", self.pulses.lanes if self.pulses else ()),
            ("fluctuation.lane_sd", self.fluctuation.lane_sd if self.fluctuation else ()),
        )
        for name, lanes in named:
            if unknown := [lane for lane in lanes if lane not in self.lanes]:
                raise ValueError(f"{name} has {unknown[0]!r}, expected lanes of the bottleneck: {list(self.lanes)}")


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
