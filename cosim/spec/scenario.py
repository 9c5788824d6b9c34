"""Scenario: the frozen, typed specification of one closed-loop experiment.

A scenario is a YAML file. `cosim.spec.loading` checks it whole before anything runs: unknown keys, wrong types and
values out of range are errors that name the file, the line and the field. `json_schema` is the same specification for
editors.
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

from cosim.spec.demand import Count, NonNegative, Positive, Spec, Traffic
from cosim.spec.perturbations import Perturbation

Seed = Annotated[int, Meta(ge=0, lt=2**31)]


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

    What the call returns must be a `gri.core.policy.Policy`; docs/tutorial.md writes one.
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
    flows: dict[int, str] = field(default_factory=dict)


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
