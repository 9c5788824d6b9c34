"""The two ranges of car-following scenes: `PAPER` (Sec. VI-C), and `US101`, congested traffic as SUMO drives it.

Three vehicles drive in a row: 0 follows 1, and 1 follows the leader 2, unless the graph says otherwise. Headways are
from front to front.
"""

import msgspec

from gri.core.dynamics import DynamicsName
from gri.core.graph import FOLLOWING, Vocabulary
from gri.core.scale import CAR_FOLLOWING_PAPER, CAR_FOLLOWING_US101, Scale
from gri.data.ranges.graph_shares import GraphShare, follow_edges
from gri.data.ranges.leader import LeaderConfig
from gri.networks.model import CHAIN
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.structured import RewardConfig, Units


class Starts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distribution of initial states; every pair of numbers is a uniform range."""

    headway: tuple[float, float]
    """Headway of each follower [m]."""
    speed: tuple[float, float]
    """[m/s]."""
    speed_difference: float | None = None
    """Largest difference in speed between a follower and its leader [m/s]; None: every speed is drawn from `speed`."""
    acceleration: tuple[float, float] = (0.0, 0.0)
    """Accelerations of the followers [m/s²]."""
    settled: float = 0.0
    """Share of the scenes in which headways are (s0 + T_h·v)·(1 ± `spread`) instead, cut to the range of `headway`."""
    spread: float = 0.4


class SceneRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the scenes of a range of car following have in common."""

    name: str
    steps: int
    """T, the number of states of a scene."""
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


ONE_GRAPH = (GraphShare(share=1.0, edges=CHAIN),)
MIXED_GRAPHS = (
    GraphShare(share=0.5, edges=CHAIN),
    GraphShare(share=0.1, edges=follow_edges((2, 0), (2, 1))),
    GraphShare(share=0.1, edges=follow_edges((2, 1))),
    GraphShare(share=0.1, edges=follow_edges((1, 0))),
    GraphShare(share=0.1, edges=follow_edges((2, 0))),
    GraphShare(share=0.1, edges=()),
)

PAPER = SceneRange(
    name="paper",
    steps=20,
    starts=Starts(headway=(4.0, 8.0), speed=(4.0, 6.0)),
    leader=LeaderConfig(),
    # Constants and weights under which the optimum does what Sec. VI-E tests: a follower that starts 8 m ahead of its
    # leader is 2 m behind it within 4 s (docs/decisions/009-car-following-constants.md).
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
