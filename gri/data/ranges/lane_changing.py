"""Lane-changing scenes (Sec. VI-C): vehicle 0 merges from the right between 1, who lags in the target lane, and
the leader 2.

The paper gives neither constants nor starts. The target lane has its centre at y = 0, the lane of vehicle 0
at y = −3.5 m. In the paper's one true graph 0 follows 2, cuts in front of 1, and 1 yields to 0; mixed data
adds graphs in which nobody merges, 0 merges behind 1, or 1 minds somebody else.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import DynamicsName
from gri.core.graph import LANE_CHANGING, EdgeType, Vocabulary
from gri.core.scale import LANE_CHANGING_PAPER, Scale
from gri.data.ranges.car_following import GraphShare
from gri.data.ranges.leader import uniform
from gri.networks.model import MERGE, Edge
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import LaneConstants
from gri.rewards.terms import LaneRewardConfig


class MergeStarts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distribution of initial states; every pair of numbers is a uniform range."""

    headway: tuple[float, float]
    """From vehicle 0 to the leader [m]."""
    lag: tuple[float, float]
    """x_0 − x_1 [m]; had 0 a clear lead, its cutting in would ask for nothing."""
    speed: tuple[float, float]  # [m/s]
    offset: float
    """Vehicles 0 and 1 start up to this far from the centre of their lane [m]."""


class LaneChangingRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All that a family of lane-changing scenes has in common."""

    name: str
    steps: int
    history_steps: int
    starts: MergeStarts
    reward: LaneRewardConfig
    weights: dict[str, dict[str, float]]
    """The true weights 1 + e^ψ of the reward's terms."""
    scale: Scale
    one_graph: tuple[GraphShare, ...]
    mixed_graphs: tuple[GraphShare, ...]
    dt: float = 0.2
    never_reverse: bool = False

    @property
    def dynamics(self) -> DynamicsName:
        return DynamicsName.DUBINS

    @property
    def vocabulary(self) -> Vocabulary:
        return LANE_CHANGING


def sample_merge(
    scenes: LaneChangingRange, count: int, generator: torch.Generator, steps: int | None = None
) -> tuple[Float[Tensor, "B 3 6"], Float[Tensor, "B T 6"]]:
    """Initial states of the three vehicles and the trajectory of the leader, which keeps its speed."""
    starts, width = scenes.starts, scenes.reward.constants.width
    merger = -uniform(generator, *starts.headway, count)
    lag = merger - uniform(generator, *starts.lag, count)
    zero = torch.zeros(count)
    x = torch.stack([merger, lag, zero], -1)
    offset = uniform(generator, -starts.offset, starts.offset, count, 2)
    y = torch.stack([offset[:, 0] - width, offset[:, 1], zero], -1)
    v = uniform(generator, *starts.speed, count, 3)
    start = torch.stack([x, y, v, *[torch.zeros_like(x)] * 3], -1)
    time = torch.arange(steps or scenes.steps) * scenes.dt
    leader = start[:, 2:].repeat(1, len(time), 1)
    leader[..., 0] = v[:, 2:] * time
    return start, leader


def _graph(share: float, **edges: EdgeType) -> GraphShare:
    """A graph from `_01=YIELD` for: vehicle 1 yields to vehicle 0."""
    return GraphShare(
        share=share,
        edges=tuple(Edge(sender=int(name[1]), receiver=int(name[2]), type=kind) for name, kind in edges.items()),
    )


_FOLLOW, _YIELD, _CUT_IN = EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN

LANE_CHANGING_SCENES = LaneChangingRange(
    name="lane_changing",
    steps=30,
    history_steps=30,
    starts=MergeStarts(headway=(8.0, 12.0), lag=(-2.0, 2.0), speed=(4.0, 6.0), offset=0.3),
    reward=LaneRewardConfig(
        constants=LaneConstants(following=FollowingConstants(zeta=3.0), yield_headway=7.0),
        temperature=0.1,
    ),
    weights={
        "node": {
            "speed": 1.2,
            "acceleration": 1.5,
            "heading": 2.0,
            "yaw_rate": 1.5,
            "jerk": 1.5,
            "yaw_acceleration": 1.5,
            "lane": 2.0,
        },
        "follow": {"idm": 3.0, "dist": 5.0, "lat": 2.0},
        "yield": {"yield": 3.0, "dist": 5.0},
        "cut_in": {"goal": 4.0, "dist": 5.0},
    },
    scale=LANE_CHANGING_PAPER,
    one_graph=(GraphShare(share=1.0, edges=MERGE),),
    mixed_graphs=(
        GraphShare(share=0.4, edges=MERGE),
        _graph(0.1, _20=_FOLLOW, _01=_YIELD),
        _graph(0.1, _10=_CUT_IN, _01=_YIELD),
        _graph(0.1, _10=_FOLLOW, _21=_FOLLOW),
        _graph(0.1, _10=_YIELD, _21=_FOLLOW),
        _graph(0.1, _21=_FOLLOW),
        _graph(0.1),
    ),
)
