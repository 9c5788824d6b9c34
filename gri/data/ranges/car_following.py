"""The two ranges of car-following scenes: the paper's, and congested traffic on US-101 as SUMO drives it."""

import msgspec

from gri.core.dynamics import DynamicsName
from gri.core.graph import FOLLOWING, EdgeType, Vocabulary
from gri.core.scale import CAR_FOLLOWING_PAPER, CAR_FOLLOWING_US101, Scale
from gri.data.ranges.leader import LeaderConfig
from gri.networks.model import CHAIN, Edge
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.structured import RewardConfig, Units


class Starts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distribution of initial states; every pair of numbers is a uniform range."""

    headway: tuple[float, float]  # [m], front to front
    speed: tuple[float, float]  # [m/s]
    speed_difference: float | None = None
    """Followers differ from the vehicle ahead by up to this [m/s]; None: every speed is drawn by itself."""
    acceleration: tuple[float, float] = (0.0, 0.0)  # [m/s^2]
    settled: float = 0.0
    """Share of the scenes with a headway of (s0 + T_h·v)·(1 ± spread) instead."""
    spread: float = 0.4


class GraphShare(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A true graph and how often it occurs."""

    share: float
    edges: tuple[Edge, ...]


class SceneRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All that a family of scenes has in common."""

    name: str
    steps: int
    starts: Starts
    leader: LeaderConfig
    reward: RewardConfig
    weights: dict[str, dict[str, float]]
    """The true weights 1 + e^ψ of the reward's terms."""
    scale: Scale
    dt: float = 0.2
    history_steps: int = 20
    never_reverse: bool = False

    @property
    def dynamics(self) -> DynamicsName:
        return DynamicsName.POINT_MASS_1D

    @property
    def vocabulary(self) -> Vocabulary:
        return FOLLOWING

    @property
    def one_graph(self) -> tuple[GraphShare, ...]:
        return ONE_GRAPH

    @property
    def mixed_graphs(self) -> tuple[GraphShare, ...]:
        return MIXED_GRAPHS


def _follow(*pairs: tuple[int, int]) -> tuple[Edge, ...]:
    return tuple(Edge(sender=i, receiver=j, type=EdgeType.FOLLOW) for i, j in pairs)


ONE_GRAPH = (GraphShare(share=1.0, edges=CHAIN),)
MIXED_GRAPHS = (
    GraphShare(share=0.5, edges=CHAIN),
    GraphShare(share=0.1, edges=_follow((2, 0), (2, 1))),
    GraphShare(share=0.1, edges=_follow((2, 1))),
    GraphShare(share=0.1, edges=_follow((1, 0))),
    GraphShare(share=0.1, edges=_follow((2, 0))),
    GraphShare(share=0.1, edges=()),
)

PAPER = SceneRange(
    name="paper",
    steps=20,
    starts=Starts(headway=(4.0, 8.0), speed=(4.0, 6.0)),
    leader=LeaderConfig(),
    # Constants and weights by which the reward itself asks for what Sec. VI-E tests: from 8 m ahead of the vehicle it
    # is to follow, the optimum is 2 m behind it within 4 s (docs/decisions/009-car-following-constants.md).
    reward=RewardConfig(
        constants=FollowingConstants(
            standstill=2.0, time_headway=0.8, comfort=2.45, minimum=2.0, zeta=2.0, speed_limit=6.0
        ),
        units=Units(gap=0.5, collision=0.3),
        temperature=0.04,
    ),
    weights={
        "node": {"speed": 1.2, "acceleration": 1.5, "jerk": 1.5},
        "follow": {"idm": 2.5, "dist": 2.0},
    },
    scale=CAR_FOLLOWING_PAPER,
)

US101 = SceneRange(
    name="us101",
    steps=45,
    history_steps=25,
    never_reverse=True,
    starts=Starts(headway=(7.0, 50.0), speed=(0.0, 22.0), speed_difference=4.0, acceleration=(-3.5, 2.0), settled=0.6),
    leader=LeaderConfig(phases=True),
    reward=RewardConfig(
        constants=FollowingConstants(
            standstill=7.0, time_headway=1.42, comfort=2.0, minimum=7.0, zeta=5.0, speed_limit=29.0
        ),
        units=Units(gap=5.0, collision=0.2, speed=6.5, acceleration=1.0, jerk=1.0),
        temperature=0.5,
    ),
    weights={
        "node": {"speed": 1.5, "acceleration": 1.5, "jerk": 3.0},
        "follow": {"idm": 1.5, "dist": 5.0},
    },
    scale=CAR_FOLLOWING_US101,
)

RANGES = {scenes.name: scenes for scenes in (PAPER, US101)}
