"""Scenario: what a scenario file (YAML) may contain, as frozen types.

A scenario specifies one closed-loop experiment. `cosim.spec.loading` checks the whole file before anything runs:
unknown keys, wrong types and values out of range are errors that name the file, the line and the field. `json_schema`
is the same specification for editors.
"""

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, field

from cosim.spec.demand import Count, NonNegative, Positive, Spec, Traffic
from cosim.spec.perturbations import CHANGES_DEMAND, Perturbation

AFTERMATH = 10.0  # [s] after the hand-back of a group in which its contacts still count
Seed = Annotated[int, Meta(ge=0, lt=2**31)]


class Road(Spec, frozen=True, kw_only=True):
    """The main road as a chain of edges. s = 0 is where edge `origin` begins; the study area is `length` [m] long."""

    edges: Annotated[tuple[str, ...], Meta(min_length=1)]
    origin: str
    length: Positive

    def __post_init__(self) -> None:
        if self.origin not in self.edges:
            raise ValueError(f"origin {self.origin!r} is not among the road's edges, expected one of {self.edges}")


class CarFollowing(Spec, frozen=True, kw_only=True, tag_field="rule", tag="car_following"):
    """Vehicle 0 directly behind 1, and 1 directly behind 2, in one lane during the whole history.

    Net gaps [m], time gaps [s] and speeds [m/s] are limited at the end of the history. Speed differences [m/s] between
    follower and leader are limited during the whole history, because a vehicle that still catches up, for example from
    a ramp, does not follow yet.
    """

    min_gap: NonNegative = 2.0
    max_gap: Positive = 45.0
    max_time_gap: Positive = 2.5
    min_speed: NonNegative = 1.0
    max_speed_difference: Positive = 4.0


class Merge(Spec, frozen=True, kw_only=True, tag_field="rule", tag="merge"):
    """Vehicle 0 on a lane that ends, between the lag vehicle 1 and the leader 2 in the lane to its left.

    `lane` is the id of the lane that ends, and `zone` is the range of s [m] in which the group is taken over. Net gaps
    [m], speeds [m/s] and speed differences [m/s] of vehicles 1 and 2 to vehicle 0 are limited at the end of the
    history, during which 1 and 2 keep their lane. The merge is complete once vehicle 0 was in the target lane for
    `settle` [s].
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


class TrainedPolicy(Spec, frozen=True, kw_only=True, tag_field="kind", tag="gri"):
    """A trained policy: the name of a released checkpoint, or the path of one."""

    checkpoint: str


class Idm(Spec, frozen=True, kw_only=True, tag_field="kind", tag="idm"):
    """The intelligent driver model."""


class ConstantVelocity(Spec, frozen=True, kw_only=True, tag_field="kind", tag="constant_velocity"):
    """Drives on with the speed at the take-over."""


class LeftToSumo(Spec, frozen=True, kw_only=True, tag_field="kind", tag="sumo"):
    """No take-over: SUMO drives the group (null run)."""


class UserPolicy(Spec, frozen=True, kw_only=True, tag_field="kind", tag="python"):
    """A policy of the user: `object` is "file.py:Name" or "package.module:Name".

    It is called with the time step dt [s] and the `settings`, and must return a `gri.core.policy.Policy`.
    docs/tutorial.md has an example.
    """

    object: Annotated[str, Meta(pattern=r"^[^:]+:[A-Za-z_][A-Za-z0-9_]*$")]
    settings: dict[str, Any] = field(default_factory=dict)


class SimulatedTraffic(Spec, frozen=True, kw_only=True, tag_field="kind", tag="sumo"):
    """SUMO simulates all other vehicles, as `traffic` describes them."""


class Replay(Spec, frozen=True, kw_only=True, tag_field="kind", tag="replay"):
    """The vehicles of an NGSIM file move as recorded; only routes and drivers of `traffic` are used.

    s = 0 of the road is at Local_Y = −`entry` [m]. Its reference line is at Local_X = `lane_1` [m], the centre of the
    leftmost lane. `flows` maps a lane (NGSIM's number) to a flow: a vehicle that is first recorded in this lane gets
    the route and class of the flow, any other vehicle those of the first flow. SUMO uses them after the hand-back.
    """

    recording: str = ""
    lane_1: float
    entry: float = 0.0
    flows: dict[int, str] = field(default_factory=dict)


Background = SimulatedTraffic | Replay


class Inferred(Spec, frozen=True, kw_only=True, tag_field="source", tag="inferred"):
    """The graph that the policy infers from its observations.

    `when_unknown` applies to later inferences (`reinfer_s`) from scenes that the model does not know: `use` the graph
    all the same, or `keep` the last one.
    """

    when_unknown: Literal["use", "keep"] = "use"


class GroundTruth(Spec, frozen=True, kw_only=True, tag_field="source", tag="ground_truth"):
    """The relations that the definition of the group rule implies; all other pairs have none."""


class Enforced(Spec, frozen=True, kw_only=True, tag_field="source", tag="enforced"):
    """A given graph: `edges` maps a pair such as "1->0" (the effect of 1 on 0) to none, follow, yield or cut_in.

    `others` says whether all other pairs are inferred by the policy, or none.
    """

    edges: dict[Annotated[str, Meta(pattern=r"^[012]->[012]$")], Literal["none", "follow", "yield", "cut_in"]]
    others: Literal["inferred", "none"] = "inferred"

    def __post_init__(self) -> None:
        if loops := [pair for pair in self.edges if pair[0] == pair[-1]]:
            raise ValueError(f"edges has {loops[0]!r}, expected two different vehicles, such as '1->0'")


GraphSource = Inferred | GroundTruth | Enforced
Driver = TrainedPolicy | Idm | ConstantVelocity | LeftToSumo | UserPolicy


def tag_of(choice: GroupRule | Driver | Perturbation) -> str:
    """The name of a group rule, a policy or a perturbation in YAML, tables and file names."""
    return str(choice.__struct_config__.tag)


class Scenario(Spec, frozen=True, kw_only=True):
    """One closed-loop experiment. Durations in s; `traffic` may be the name or path of a traffic file.

    The policy drives the roles in `driven`; SUMO drives the others. `graph` is the source of the graph. It is inferred
    at the take-over, and again every `reinfer_s` from the latest states if this is not 0. A simulation step lasts
    `step`, and the history before the take-over `history`. The policy drives for up to `horizon`; then the group is
    observed for `watch`, and the next groups are taken over after a further `rest`. A run ends after `episodes` groups,
    of which at most `groups_at_once` are driven at the same time, or `time_limit` after the warm-up. With
    `surroundings` the run has a table of the vehicles around the groups. A batch leaves it out unless its `overrides`
    say true.
    """

    description: str = ""
    net: str
    road: Road
    traffic: Traffic
    background: Background = field(default_factory=SimulatedTraffic)
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
    watch: NonNegative = AFTERMATH
    rest: NonNegative = 2.0
    episodes: Count = 30
    groups_at_once: Count = 6
    time_limit: Positive = 3600.0
    surroundings: bool = True

    def __post_init__(self) -> None:
        if len(set(self.driven)) < len(self.driven):
            raise ValueError(f"driven is {list(self.driven)}, expected each role once")
        if self.traffic.has_own_files:
            self._check_own_files()
        for name in ("history", "horizon", "watch", "rest", "reinfer_s"):
            steps = getattr(self, name) / self.step
            if abs(steps - round(steps)) > 1e-6:
                raise ValueError(f"{name} is {getattr(self, name):g} s, expected a multiple of step = {self.step:g} s")

    def _check_own_files(self) -> None:
        """Whatever changes the demand needs traffic that is described in the scenario."""
        if isinstance(self.background, Replay):
            raise ValueError(
                "background replays a recording and traffic has SUMO files of its own, expected one of both"
            )
        if kinds := [tag_of(change) for change in self.perturbations if isinstance(change, CHANGES_DEMAND)]:
            raise ValueError(
                f"perturbations has {kinds[0]}, which changes the demand, and traffic has SUMO files of its own;"
                " expected traffic with vehicles and flows, or other perturbations"
            )

    def steps(self, duration: float) -> int:
        """A duration [s] in simulation steps."""
        return round(duration / self.step)


def json_schema() -> dict[str, Any]:
    """JSON Schema of a scenario file, for editors."""
    schema = msgspec.json.schema(Scenario)
    properties = schema["$defs"]["Scenario"]["properties"]
    properties["traffic"] = {
        "description": "a traffic description, or the name or path of a file that holds one",
        "anyOf": [properties["traffic"], {"type": "string"}],
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "cosim scenario", **schema}
