"""Scenario: the frozen, typed specification of one closed-loop experiment.

A scenario is a YAML file. `cosim.loading` checks it whole before anything runs: unknown keys, wrong types and values
out of range are errors that name the file, the line and the field. `json_schema` is the same specification for editors.
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct, field

from cosim.perturb.specs import Perturbation

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1)]
Seed = Annotated[int, Meta(ge=0, lt=2**31)]
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


class Road(Spec, frozen=True, kw_only=True):
    """The main road as a chain of edges; s = 0 where the edge `origin` begins, the study area is `length` [m] long."""

    edges: Annotated[tuple[str, ...], Meta(min_length=1)]
    origin: str
    length: Positive

    def __post_init__(self) -> None:
        if self.origin not in self.edges:
            raise ValueError(f"origin {self.origin!r} is not among the road's edges, expected one of {self.edges}")


class CarFollowing(Spec, frozen=True, kw_only=True, tag_field="rule", tag="car_following"):
    """Vehicle 0 right behind 1, right behind 2, in one lane all through the history (net gaps in m, time gaps in s).

    Gaps count at the end of the history, speed differences [m/s] between neighbours all through it: a vehicle that is
    still catching up, say from a ramp, does not follow yet.
    """

    min_gap: NonNegative = 2.0
    max_gap: Positive = 45.0
    max_time_gap: Positive = 2.5
    min_speed: NonNegative = 1.0
    max_speed_difference: Positive = 4.0


class Merge(Spec, frozen=True, kw_only=True, tag_field="rule", tag="merge"):
    """Vehicle 0 on a lane that ends, between the lag vehicle 1 and the leader 2 in the lane to its left.

    `lane` is the id of 0's lane, `zone` the range of s [m] in which the group is taken, gaps are net gaps to 0 and
    speed differences [m/s] are from 0 to the others, both at the end of the history, through which 1 and 2 kept their
    lane. The merge is done when 0 was inside the target lane for `settle` [s].
    """

    lane: str
    zone: tuple[float, float]
    min_gap: NonNegative = 1.0
    max_gap: Positive = 45.0
    min_speed: NonNegative = 2.0
    max_speed_difference: Positive = 6.0
    settle: NonNegative = 2.0

    def __post_init__(self) -> None:
        if self.zone[0] >= self.zone[1]:
            raise ValueError(f"zone is {list(self.zone)}, expected a range [from, to] of s with from < to")
        if not self.lane.rpartition("_")[2].isdigit():
            raise ValueError(f"lane is {self.lane!r}, expected a lane id such as 'weave_0'")


GroupRule = CarFollowing | Merge


class Trained(Spec, frozen=True, kw_only=True, tag_field="kind", tag="gri"):
    """A trained checkpoint: the name of a released one, or a path."""

    checkpoint: str


class Idm(Spec, frozen=True, kw_only=True, tag_field="kind", tag="idm"):
    """The intelligent driver model."""


class ConstantVelocity(Spec, frozen=True, kw_only=True, tag_field="kind", tag="constant_velocity"):
    """Keeps the speed it has."""


class LeftToSumo(Spec, frozen=True, kw_only=True, tag_field="kind", tag="sumo"):
    """Nobody takes the group over: the null run."""


class Own(Spec, frozen=True, kw_only=True, tag_field="kind", tag="python"):
    """An own policy: `object` is "file.py:Name" or "package.module:Name", called with dt [s] and the `settings`.

    What the call returns must be a `gri.policy.Policy`; docs/tutorial.md writes one.
    """

    object: Annotated[str, Meta(pattern=r"^[^:]+:[A-Za-z_][A-Za-z0-9_]*$")]
    settings: dict[str, Any] = field(default_factory=dict)


class Simulated(Spec, frozen=True, kw_only=True, tag_field="kind", tag="sumo"):
    """SUMO's drivers, as `traffic` describes them."""


class Replay(Spec, frozen=True, kw_only=True, tag_field="kind", tag="replay"):
    """The vehicles of an NGSIM file move as they were recorded; of `traffic` only routes and drivers count.

    The road's s = 0 is at Local_Y = −`entry` [m], its reference line at Local_X = `lane_1` [m], which is the centre of
    the leftmost lane. A vehicle that is first seen in a lane (NGSIM's number) named in `flows` gets the route and class
    of that flow, any other those of the first flow; they count once a vehicle was driven and handed back.
    """

    recording: str = ""
    lane_1: float
    entry: float = 0.0
    flows: dict[int, str] = {}


Background = Simulated | Replay


class Inferred(Spec, frozen=True, kw_only=True, tag_field="source", tag="inferred"):
    """The graph the policy infers from what it saw."""


class GroundTruth(Spec, frozen=True, kw_only=True, tag_field="source", tag="ground_truth"):
    """The relations that the group rule's own definition implies, and none between all other pairs."""


class Enforced(Spec, frozen=True, kw_only=True, tag_field="source", tag="enforced"):
    """What a person says: `edges` maps "1->0" (the effect of 1 on 0) to none, follow, yield or cut_in.

    All other pairs are as the policy infers them, or none.
    """

    edges: dict[Annotated[str, Meta(pattern=r"^[012]->[012]$")], Literal["none", "follow", "yield", "cut_in"]]
    others: Literal["inferred", "none"] = "inferred"

    def __post_init__(self) -> None:
        if selfish := [pair for pair in self.edges if pair[0] == pair[-1]]:
            raise ValueError(f"edges has {selfish[0]!r}, expected two different vehicles, such as '1->0'")


GraphSource = Inferred | GroundTruth | Enforced
Driver = Trained | Idm | ConstantVelocity | LeftToSumo | Own


def tag_of(choice: GroupRule | Driver) -> str:
    """The word that stands for a group rule or a driver in YAML, tables and file names."""
    return str(choice.__struct_config__.tag)


class Scenario(Spec, frozen=True, kw_only=True):
    """One closed-loop experiment. Durations in s; `traffic` may be the name or path of a traffic file.

    `driven` are the roles that the policy drives, the others stay SUMO's; `graph` says under which graph, inferred
    once at the take-over, and again every `reinfer_s` from the latest states where that is not 0.
    """

    description: str = ""
    net: str
    road: Road
    traffic: Traffic
    background: Background = field(default_factory=Simulated)
    group: GroupRule
    policy: Driver
    graph: GraphSource = field(default_factory=Inferred)
    reinfer_s: NonNegative = 0.0
    driven: Annotated[tuple[Literal[0, 1], ...], Meta(min_length=1, max_length=2)] = (0, 1)
    perturbations: tuple[Perturbation, ...] = ()
    seed: Seed = 1
    step: Positive = 0.2
    history: Positive = 5.0
    horizon: Positive = 8.0
    watch: NonNegative = 3.0
    rest: NonNegative = 2.0
    episodes: Count = 30
    groups_at_once: Count = 6
    time_limit: Positive = 3600.0

    def __post_init__(self) -> None:
        if len(set(self.driven)) < len(self.driven):
            raise ValueError(f"driven is {list(self.driven)}, expected each role once")
        for name in ("history", "horizon", "watch", "rest", "reinfer_s"):
            steps = getattr(self, name) / self.step
            if abs(steps - round(steps)) > 1e-6:
                raise ValueError(f"{name} is {getattr(self, name):g} s, expected a multiple of step = {self.step:g} s")

    def steps(self, duration: float) -> int:
        """A duration [s] in simulation steps."""
        return round(duration / self.step)


def json_schema() -> dict[str, Any]:
    """JSON Schema of a scenario file, for editors and for people."""
    schema = msgspec.json.schema(Scenario)
    properties = schema["$defs"]["Scenario"]["properties"]
    properties["traffic"] = {
        "description": "a traffic description, or the name or path of a file that holds one",
        "anyOf": [properties["traffic"], {"type": "string"}],
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "cosim scenario", **schema}
