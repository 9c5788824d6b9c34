"""Scenario: what a scenario file (YAML) may contain, as frozen types.

A scenario specifies one closed-loop experiment. `cosim.spec.loading` checks the whole file before anything runs:
unknown keys, wrong types and values out of range are errors that name the file, the line and the field. `json_schema`
is the same specification for editors.
"""

import math
from typing import Annotated, Literal

from msgspec import Meta, field

from cosim.spec.demand import (
    Distance,
    Duration,
    Gap,
    Name,
    Place,
    Position,
    PositiveDuration,
    PositiveGap,
    PositivePeriod,
    Share,
    Spec,
    Speed,
    SpeedLimit,
    Text,
    TimeGap,
    Traffic,
)
from cosim.spec.group_roles import USUAL_SIZE, check_roles
from cosim.spec.perturbations import CHANGES_DEMAND, Perturbation
from cosim.spec.policies import R157 as R157
from cosim.spec.policies import CarefulHuman as CarefulHuman
from cosim.spec.policies import ConstantVelocity as ConstantVelocity
from cosim.spec.policies import Driver, RssFilter, UserPolicy
from cosim.spec.policies import Fsm as Fsm
from cosim.spec.policies import Idm as Idm
from cosim.spec.policies import LeftToSumo as LeftToSumo
from cosim.spec.policies import ReferencePolicy as ReferencePolicy
from cosim.spec.policies import Rss as Rss
from cosim.spec.policies import SumoDriver as SumoDriver
from cosim.spec.policies import TrainedPolicy as TrainedPolicy
from cosim.spec.shares import check_shares
from cosim.spec.sumo_models import SumoModel as SumoModel
from cosim.spec.work import Work, entering, refuse_too_much

AFTERMATH = 10.0  # [s] after the hand-back of a group in which its contacts still count
MAX_WORK = 1.0  # times the usual limits
MOST_AT_ONCE = 5_000  # vehicles in the study area whose history is kept, at most
Seed = Annotated[int, Meta(ge=0, lt=2**31)]  # SUMO's seeds have 31 bits
Role = Annotated[int, Meta(ge=0, le=6)]
Step = Annotated[float, Meta(ge=0.001, le=10)]  # [s]; SUMO counts in milliseconds


class Road(Spec, frozen=True, kw_only=True):
    """The main road as a chain of edges. s = 0 is where edge `origin` begins; the study area is `length` [m] long."""

    edges: Annotated[tuple[Place, ...], Meta(min_length=1)]
    origin: Place
    length: Distance

    def __post_init__(self) -> None:
        if self.origin not in self.edges:
            raise ValueError(f"origin {self.origin!r} is not among the road's edges, expected one of {self.edges}")


Newcomers = Literal["end", "join"]


class CarFollowing(Spec, frozen=True, kw_only=True, tag_field="rule", tag="car_following"):
    """`size` vehicles in one lane during the whole history: 0 directly behind 1, 1 directly behind 2, and so on.

    The foremost is the leader, which SUMO drives. Net gaps [m], time gaps [s] and speeds [m/s] are limited at the end
    of the history. Speed differences [m/s] between follower and leader are limited during the whole history, because a
    vehicle that still catches up, for example from a ramp, does not follow yet. `newcomers` says what happens where
    another vehicle comes between two of the group, or one of them leaves the lane: the drive ends, or whoever is next
    ahead joins the group (docs/groups-that-change.md).
    """

    min_gap: Gap = 2.0
    max_gap: PositiveGap = 45.0
    max_time_gap: TimeGap = 2.5
    min_speed: Speed = 1.0
    max_speed_difference: SpeedLimit = 4.0
    size: Annotated[int, Meta(ge=2, le=8)] = USUAL_SIZE
    newcomers: Newcomers = "end"


class Merge(Spec, frozen=True, kw_only=True, tag_field="rule", tag="merge"):
    """Vehicle 0 on a lane that ends, between the lag vehicle 1 and the leader 2 in the lane beside it.

    `lane` is the id of the lane that ends, on either side of the road; it may go on across nodes before it ends. `zone`
    is the range of s [m] in which the group is taken over. With `across_edges` vehicles 1 and 2 may be on the edges
    before and after that lane, too. Net gaps [m], speeds [m/s] and speed differences [m/s] of vehicles 1 and 2 to
    vehicle 0 are limited at the end of the history, during which 1 and 2 keep their lane. The merge is complete once
    vehicle 0 was in the target lane for `settle` [s]. `newcomers` says what happens where another vehicle comes between
    vehicles 1 and 2, or one of them leaves the lane: the drive ends, or whoever is next to vehicle 0 joins the group
    (docs/groups-that-change.md). Its `size` is always 3.
    """

    lane: Place
    zone: tuple[Position, Position]
    across_edges: bool = True
    min_gap: Gap = 1.0
    max_gap: PositiveGap = 45.0
    min_speed: Speed = 2.0
    max_speed_difference: SpeedLimit = 6.0
    settle: Duration = 2.0
    newcomers: Newcomers = "end"
    size: int = USUAL_SIZE

    def __post_init__(self) -> None:
        if self.size != USUAL_SIZE:
            raise ValueError(
                f"size is {self.size}, expected 3: a merge has a merging vehicle, a lag vehicle and a leader; groups of"
                " other sizes need rule: car_following"
            )
        if self.zone[0] >= self.zone[1]:
            raise ValueError(f"zone is {list(self.zone)}, expected a range [from, to] of s with from < to")
        if not self.lane.rpartition("_")[2].isdigit():
            raise ValueError(f"lane is {self.lane!r}, expected a lane id such as 'weave_0'")


GroupRule = CarFollowing | Merge


class SimulatedTraffic(Spec, frozen=True, kw_only=True, tag_field="kind", tag="sumo"):
    """SUMO simulates all other vehicles, as `traffic` describes them."""


class Replay(Spec, frozen=True, kw_only=True, tag_field="kind", tag="replay"):
    """The vehicles of a recording move as recorded; only routes and drivers of `traffic` are used.

    Any layout of docs/recordings.md will do. s = 0 of the road is at s_m = −`entry` [m] (NGSIM: Local_Y). Its reference
    line is at d_m = −`lane_1` [m] (NGSIM: Local_X), the centre of the leftmost lane. `flows` maps a lane's number to a
    flow: a vehicle that is first recorded in this lane gets the route and class of the flow, any other vehicle those of
    the first flow. SUMO uses them after the hand-back.

    Where a recording has no lateral positions, vehicles are put on the centres of their lanes, `lane_width` [m] apart,
    and change lanes gradually; where it has no lengths, all have `vehicle_length` [m]. Without these two such a
    recording is refused.

    With `react`, a recorded vehicle behind a driven one is released to SUMO's car following, on its recorded path,
    where it would otherwise have to brake with 2 m/s² or more to stay behind (docs/replay.md). With `overlap`, a
    round begins every second, whether or not earlier ones go on: each is driven in a branch of its own, and the
    recording is the same in all. So a short recording gives more groups.
    """

    recording: Annotated[str, Meta(max_length=1000)] = ""
    lane_1: Position
    entry: Position = 0.0
    flows: dict[int, str] = field(default_factory=dict)
    lane_width: Annotated[float, Meta(ge=2, le=6)] | None = None
    vehicle_length: Annotated[float, Meta(ge=1, le=30)] | None = None
    react: bool = False
    overlap: bool = False


Background = SimulatedTraffic | Replay


class Inferred(Spec, frozen=True, kw_only=True, tag_field="source", tag="inferred"):
    """The graph that the policy infers from its observations.

    Later inferences (`reinfer_s`) are combined with the last graph by a hidden Markov chain, in which a relation
    changes `switching_rate` times per second: a relation that is not visible for a while is not over. `smoothing:
    false` takes every inference for itself. A vehicle that the policy drives keeps its relations, as its motion is what
    the policy wants; `own_motion: true` takes it for evidence all the same. `when_unknown` applies to later inferences
    from scenes that the model does not know: `use` the graph all the same, or `keep` the last one.

    A vehicle of a driven group that would react to nobody follows (or yields to) whom it does most probably, if that
    has a probability of 5 % or more, or of 0.1 % where the model does not know the scene; `in_doubt: ignore` takes the
    most probable relations as they are. Shares of the traffic do that always.
    """

    smoothing: bool = True
    switching_rate: Annotated[float, Meta(ge=0, le=100)] = 0.02
    own_motion: bool = False
    when_unknown: Literal["use", "keep"] = "use"
    in_doubt: Literal["react", "ignore"] = "react"


class GroundTruth(Spec, frozen=True, kw_only=True, tag_field="source", tag="ground_truth"):
    """The relations that the definition of the group rule implies; all other pairs have none."""


class Enforced(Spec, frozen=True, kw_only=True, tag_field="source", tag="enforced"):
    """A given graph: `edges` maps a pair such as "1->0" (the effect of 1 on 0) to none, follow, yield or cut_in.

    `others` says whether all other pairs are inferred by the policy, or none.
    """

    edges: dict[Annotated[str, Meta(pattern=r"^[0-7]->[0-7]$")], Literal["none", "follow", "yield", "cut_in"]]
    others: Literal["inferred", "none"] = "inferred"

    def __post_init__(self) -> None:
        if loops := [pair for pair in self.edges if pair[0] == pair[-1]]:
            raise ValueError(f"edges has {loops[0]!r}, expected two different vehicles, such as '1->0'")


GraphSource = Inferred | GroundTruth | Enforced


class PolicyShare(Spec, frozen=True, kw_only=True):
    """A policy and the share of the entering vehicles that it drives."""

    policy: Driver
    share: Share


def tag_of(choice: GroupRule | Driver | Perturbation) -> str:
    """The name of a group rule, a policy or a perturbation in YAML, tables and file names."""
    return str(choice.__struct_config__.tag)


def policy_name(choice: Driver) -> str:
    """The name of a policy before it is loaded: its kind; for an own policy, the class or function in its file."""
    return choice.object.rpartition(":")[2] if isinstance(choice, UserPolicy) else tag_of(choice)


class Scenario(Spec, frozen=True, kw_only=True):
    """One closed-loop experiment. Durations in s; `traffic` may be the name or path of a traffic file.

    The policy drives the roles in `driven`, by default all but the leader, within what the filter `safety` allows (by
    default there is none); SUMO drives the others. Under a latency, a `predictor` shows it what the late states are
    probably now. `graph` is the source of the graph. It is inferred at the take-over, and again every `reinfer_s` from
    the latest states if this is not 0. A simulation step lasts `step`; the policy decides every `policy_period`, a
    multiple of it (0: in every step, or as often as it was trained to). The history before the take-over lasts
    `history`. The policy drives for up to `horizon`; then the group is observed for `watch`, and the next groups are
    taken over after a further `rest`. A run ends after `episodes` groups, however their drives end, or `time_limit`
    after the warm-up; at most `groups_at_once` are driven at the same time. With `surroundings` the run has a table of
    the vehicles around the groups. A batch leaves it out unless its `overrides` say true. A run is refused if it may
    need more than `max_work` times the usual limits of steps, vehicles and memory.

    With `share` or `shares` there are no groups: `policy` drives this share of all entering vehicles, from entry to
    exit, and each of the named `shares` another one, for `time_limit` after the warm-up (docs/penetration.md).
    """

    description: Text = ""
    net: Place
    road: Road
    traffic: Traffic
    background: Background = field(default_factory=SimulatedTraffic)
    group: GroupRule = field(default_factory=CarFollowing)
    policy: Driver
    graph: GraphSource = field(default_factory=Inferred)
    reinfer_s: Duration = 0.0
    safety: RssFilter | None = None
    predictor: Literal["none", "constant_acceleration"] = "none"
    driven: Annotated[tuple[Role, ...], Meta(min_length=1, max_length=7)] | None = None
    perturbations: Annotated[tuple[Perturbation, ...], Meta(max_length=20)] = ()
    seed: Seed = 1
    step: Step = 0.2
    policy_period: Duration = 0.0
    history: PositiveDuration = 5.0
    horizon: PositiveDuration = 8.0
    watch: Duration = AFTERMATH
    rest: Duration = 2.0
    episodes: Annotated[int, Meta(ge=1, le=1_000_000)] = 30
    groups_at_once: Annotated[int, Meta(ge=1, le=1000)] = 6
    time_limit: PositivePeriod = 3600.0
    surroundings: bool = True
    share: Share | None = None
    shares: Annotated[dict[Name, PolicyShare], Meta(max_length=20)] = field(default_factory=dict)
    max_work: Annotated[float, Meta(gt=0, le=10_000)] = MAX_WORK

    def __post_init__(self) -> None:
        edges = self.graph.edges if isinstance(self.graph, Enforced) else {}
        check_roles(self.group.size, self.driven_roles, edges, self.perturbations)
        if self.traffic.has_own_files:
            self._check_own_files()
        if isinstance(self.policy, SumoDriver) and not (
            isinstance(self.background, Replay) and isinstance(self.group, CarFollowing)
        ):
            raise ValueError(
                "policy is sumo_driver, which takes the place of recorded drivers in one lane; expected a background of"
                " kind replay and a group of rule car_following, or policy: {kind: sumo}"
            )
        check_shares(self, isinstance(self.background, Replay))
        self._check_held_speed()
        for name in ("policy_period", "history", "horizon", "watch", "rest", "reinfer_s"):
            steps = getattr(self, name) / self.step
            if abs(steps - round(steps)) > 1e-6:
                raise ValueError(f"{name} is {getattr(self, name):g} s, expected a multiple of step = {self.step:g} s")
        refuse_too_much(self.work(self.time_limit), self.max_work)

    def work(self, duration: float) -> Work:
        """What a simulation needs at most that lasts the warm-up and `duration` [s] more."""
        end = self.traffic.warm_up + duration
        vehicles = entering(self.traffic, end) if isinstance(self.background, SimulatedTraffic) else 0.0
        episodes = min(self.episodes, self.groups_at_once * math.ceil(duration / self.step))
        episode = self.history + self.horizon + self.watch
        kept = min(vehicles, MOST_AT_ONCE) * self.history  # [s] of vehicles
        kept += 2 * self.group.size * episodes * episode
        return Work(math.ceil(end / self.step), math.ceil(vehicles), math.ceil(kept / self.step))

    @property
    def driven_roles(self) -> tuple[int, ...]:
        """The roles that the policy drives."""
        return tuple(range(self.group.size - 1)) if self.driven is None else self.driven

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

    def _check_held_speed(self) -> None:
        """What policies do must not move the limits of the bottleneck, or its feedback would hide their effect."""
        hold = self.traffic.bottleneck.hold if self.traffic.bottleneck is not None else None
        if hold is None or isinstance(self.background, Replay):
            return
        if self.has_shares:
            raise ValueError(
                "traffic holds the mean speed by feedback (bottleneck.hold), which would undo what a share changes;"
                " expected traffic without bottleneck.hold"
            )
        if self.horizon + self.watch > hold.delay:
            raise ValueError(
                f"horizon and watch last {self.horizon + self.watch:g} s together, expected at most the delay of the"
                f" feedback on the bottleneck ({hold.delay:g} s), so that no drive moves its limits; raise"
                " traffic.bottleneck.hold.delay"
            )

    @property
    def has_shares(self) -> bool:
        """Whether policies drive shares of the traffic instead of groups."""
        return self.share is not None or bool(self.shares)

    def steps(self, duration: float) -> int:
        """A duration [s] in simulation steps."""
        return round(duration / self.step)
