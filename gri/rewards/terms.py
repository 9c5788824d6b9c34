"""The list of reward terms: every named term of every scenario, with its feature and its unit (Sec. VI-C, VI-D).

Where to find a term: `car_following_terms` (synthetic car following), `lane_changing_terms` (synthetic lane changing;
the term for yielding is "yield", `lane_changing_features.g_yield`), `naturalistic_terms` (recorded traffic; yielding is
"spatial" and "time", `recorded_traffic_features.g_spatial` and `g_time`). A term is a feature divided by its unit
(squared for squares). `structured.StructuredReward` weighs and sums the terms.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import msgspec
from torch import Tensor

from gri.core.graph import FOLLOWING, LANE_CHANGING, YIELDING, EdgeType, Vocabulary
from gri.rewards import car_following_features
from gri.rewards import lane_changing_features as lane
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import LaneConstants
from gri.rewards.learned_constants import LearnedConstants
from gri.rewards.recorded_traffic_features import ReferenceNetworks, References, collision_point, g_spatial, g_time

NodeTerm = Callable[[Tensor, Tensor], Tensor]
"""(state [*batch, D], action [*batch, A]) of one vehicle -> term [*batch]."""
EdgeTerm = Callable[[Tensor, Tensor], Tensor]
"""States [*batch, D] of sender and receiver -> term [*batch]."""


@dataclass(frozen=True)
class Terms:
    """The named terms of a scenario: of a vehicle alone (r^n), and of each edge type (r^{e,k})."""

    node: Mapping[str, NodeTerm]
    edge: Mapping[EdgeType, Mapping[str, EdgeTerm]]


class Units(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Units of the terms. A squared feature has the value 1 (before its weight) at one unit."""

    gap: float = 1.0
    """Of headways [m]."""
    collision: float = 1.0
    """Of g_dist [-]."""
    speed: float = 1.0
    """[m/s]."""
    acceleration: float = 1.0
    """[m/s²]."""
    jerk: float = 1.0
    """[m/s³]."""


class RewardConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Constants, units and temperature of the car-following reward; the temperature multiplies all weights."""

    constants: FollowingConstants = FollowingConstants()
    units: Units = Units()
    temperature: float = 1.0


class AssumedReward(RewardConfig, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="assumed"):
    """What a learner assumes of car-following drivers, independently of the drivers that made its scenes.

    The constants are first values. With `learn`, they are parameters of the reward (`LearnedConstants`).
    """

    learn: bool = True


class LaneUnits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Units of the lateral terms."""

    lateral: float = 1.0
    """[m]."""
    heading: float = 0.1
    """[rad]."""
    yaw_rate: float = 0.1
    """[rad/s]."""
    yaw_acceleration: float = 0.1
    """[rad/s²]."""
    lane: float = 1.0
    """Of f_lane [-]."""


class LaneRewardConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Constants, units and temperature of the lane-changing reward; the temperature multiplies all weights."""

    constants: LaneConstants = LaneConstants()
    units: Units = Units()
    lane_units: LaneUnits = LaneUnits()
    temperature: float = 1.0


def car_following_terms(config: RewardConfig, learned: LearnedConstants | None = None) -> Terms:
    """Terms of synthetic car following (Sec. VI-C, without the lateral terms).

    Vehicle alone: f_v, a², δa². Follow: g_IDM, g_dist. `learned` takes the place of the configuration's constants.
    """
    constants, units = learned or config.constants, config.units
    return Terms(
        node={
            "speed": lambda state, action: car_following_features.f_speed(state, constants) / units.speed**2,
            "acceleration": lambda state, action: car_following_features.f_acceleration(state) / units.acceleration**2,
            "jerk": lambda state, action: car_following_features.f_jerk(action) / units.jerk**2,
        },
        edge={
            EdgeType.FOLLOW: {
                "idm": lambda sender, receiver: (
                    car_following_features.g_idm(sender, receiver, constants) / units.gap**2
                ),
                "dist": lambda sender, receiver: (
                    car_following_features.g_dist(sender, receiver, constants) / units.collision**2
                ),
            }
        },
    )


def lane_changing_terms(config: LaneRewardConfig) -> Terms:
    """Terms of synthetic lane changing (Sec. VI-C).

    Vehicle alone: f_v, a², θ², ω², δa², δω², f_lane. Follow: g_IDM, g_dist, g_lat. Yield: g_yield, g_dist. Cut-in:
    g_goal and g_dist with the arguments switched.
    """
    c, units, lateral = config.constants, config.units, config.lane_units
    gap, collision = units.gap**2, units.collision**2
    return Terms(
        node={
            "speed": lambda state, action: lane.f_speed(state, c) / units.speed**2,
            "acceleration": lambda state, action: (state[..., 4] / units.acceleration) ** 2,
            "heading": lambda state, action: (state[..., 3] / lateral.heading) ** 2,
            "yaw_rate": lambda state, action: (state[..., 5] / lateral.yaw_rate) ** 2,
            "jerk": lambda state, action: (action[..., 0] / units.jerk) ** 2,
            "yaw_acceleration": lambda state, action: (action[..., 1] / lateral.yaw_acceleration) ** 2,
            "lane": lambda state, action: lane.f_lane(state, c) / lateral.lane**2,
        },
        edge={
            EdgeType.FOLLOW: {
                "idm": lambda sender, receiver: lane.g_idm(sender, receiver, c) / gap,
                "dist": lambda sender, receiver: lane.g_dist(sender, receiver, c) / collision,
                "lat": lambda sender, receiver: lane.g_lat(sender, receiver, c) / lateral.lateral**2,
            },
            EdgeType.YIELD: {
                "yield": lambda sender, receiver: lane.g_yield(sender, receiver, c) / gap,
                "dist": lambda sender, receiver: lane.g_dist(sender, receiver, c) / collision,
            },
            EdgeType.CUT_IN: {
                "goal": lambda sender, receiver: lane.g_goal_cut_in(sender, receiver, c) / gap,
                "dist": lambda sender, receiver: lane.g_dist_cut_in(sender, receiver, c) / collision,
            },
        },
    )


class NaturalisticConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="naturalistic"):
    """The reward of recorded traffic, with learned reference networks (Sec. VI-D)."""

    lanes: bool = False
    """True: lane changing of 2-D point masses, with yielding. False: car following of 1-D point masses."""
    references: References = References()
    units: Units = Units(gap=5.0, speed=2.0)
    lateral: float = 1.0
    """Unit of the distance to the centre of the target lane [m]."""
    lateral_speed: float = 0.5
    """Unit of the lateral speed [m/s]."""
    time: float = 1.0
    """Unit of g_time [s]."""
    temperature: float = 1.0
    """Multiplies all weights."""


AnyRewardConfig = RewardConfig | LaneRewardConfig | NaturalisticConfig


def naturalistic_terms(config: NaturalisticConfig, h: ReferenceNetworks) -> Terms:
    """Terms of recorded traffic (Sec. VI-D), with the reference networks `h`.

    Vehicle alone: f_v, a², jerk². Follow: g_v, g_s. With lanes also, for the vehicle alone, the squares of y (the
    target lane is at y = 0), of lateral speed, lateral acceleration and lateral jerk; and yield: g_spatial, g_time.
    """
    units = config.units
    v, a = (2, 4) if config.lanes else (1, 2)  # in the states of the 2-D and the 1-D point mass

    def g_v(sender: Tensor, receiver: Tensor) -> Tensor:
        desired = h.speed(sender[..., 0] - receiver[..., 0], sender[..., v])
        return ((receiver[..., v] - desired) / units.speed) ** 2

    def g_s(sender: Tensor, receiver: Tensor) -> Tensor:
        desired = h.headway(sender[..., v], receiver[..., v])
        return ((desired - sender[..., 0] + receiver[..., 0]).clamp(min=0) / units.gap) ** 2

    node: dict[str, NodeTerm] = {
        "speed": lambda state, action: ((state[..., v] - h.own_speed()) / units.speed) ** 2,
        "acceleration": lambda state, action: (state[..., a] / units.acceleration) ** 2,
        "jerk": lambda state, action: (action[..., 0] / units.jerk) ** 2,
    }
    edge: dict[EdgeType, dict[str, EdgeTerm]] = {EdgeType.FOLLOW: {"speed": g_v, "headway": g_s}}
    if config.lanes:
        node |= {
            "lane": lambda state, action: (state[..., 1] / config.lateral) ** 2,
            "lateral_speed": lambda state, action: (state[..., 3] / config.lateral_speed) ** 2,
            "lateral_acceleration": lambda state, action: (state[..., 5] / units.acceleration) ** 2,
            "lateral_jerk": lambda state, action: (action[..., 1] / units.jerk) ** 2,
        }
        edge[EdgeType.YIELD] = _yield_terms(config, h)
    return Terms(node=node, edge=edge)


def _yield_terms(config: NaturalisticConfig, h: ReferenceNetworks) -> dict[str, EdgeTerm]:
    """Yielding in recorded lane changes: g_spatial and g_time."""
    c = config.references

    def point_of_collision(sender: Tensor, receiver: Tensor) -> tuple[Tensor, Tensor]:
        return collision_point(sender[..., :4], receiver[..., :4], c.collision_range, c.overlap)

    def spatial(sender: Tensor, receiver: Tensor) -> Tensor:
        point, counts = point_of_collision(sender, receiver)
        desired = h.distance(sender[..., 2], receiver[..., 2])
        return g_spatial(point, counts, receiver[..., :4], desired, c.printed_yield) / config.units.gap**2

    def time(sender: Tensor, receiver: Tensor) -> Tensor:
        point, counts = point_of_collision(sender, receiver)
        desired = h.time(sender[..., 2], receiver[..., 2])
        return g_time(point, counts, sender[..., :4], receiver[..., :4], desired, c) / config.time**2

    return {"spatial": spatial, "time": time}


def references_of(config: AnyRewardConfig) -> ReferenceNetworks | None:
    """The reference networks of a reward for recorded traffic; None for the other rewards."""
    return ReferenceNetworks(config.references, config.lanes) if isinstance(config, NaturalisticConfig) else None


def constants_of(config: AnyRewardConfig) -> LearnedConstants | None:
    """The constants of a reward that learns them; None for the other rewards."""
    return LearnedConstants(config.constants) if isinstance(config, AssumedReward) and config.learn else None


def terms_of(
    config: AnyRewardConfig, references: ReferenceNetworks | None = None, constants: LearnedConstants | None = None
) -> tuple[Terms, Vocabulary]:
    """The terms of a scenario, and its edge types. Rewards of recorded traffic need their `references`.

    `constants` are those of a reward that learns them.
    """
    match config:
        case NaturalisticConfig():
            assert references is not None, "learned terms need their networks"
            return naturalistic_terms(config, references), YIELDING if config.lanes else FOLLOWING
        case RewardConfig():
            return car_following_terms(config, constants), FOLLOWING
        case LaneRewardConfig():
            return lane_changing_terms(config), LANE_CHANGING
