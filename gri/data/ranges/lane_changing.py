"""Lane changes of the paper's synthetic data (Sec. VI-C): vehicle 0 merges from the right between 1 and the leader 2.

The paper gives neither constants nor starts. `gri.data.ranges.merge_geometry` says which vehicle is which, and where
the lanes are; a lane is 3.5 m wide. In the paper's one true graph, 0 follows 2 and cuts in front of 1, and 1 yields to
0. Mixed data adds graphs in which no vehicle merges, 0 merges behind 1, or 1 reacts to another vehicle.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.graph import EdgeType
from gri.core.scale import LANE_CHANGING_PAPER, Scale
from gri.data.ranges.graph_shares import GraphShare, edges, follow_edges
from gri.data.ranges.leader import uniform
from gri.data.ranges.merge_geometry import MergeRange, straight_states
from gri.networks.model import MERGE
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import LaneConstants
from gri.rewards.terms import LaneRewardConfig

FOLLOW, YIELD, CUT_IN = EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN


class MergeStarts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distribution of initial states; every pair of numbers is a uniform range."""

    headway: tuple[float, float]
    """x_2 − x_0, from vehicle 0 to the leader [m]."""
    lag: tuple[float, float]
    """x_0 − x_1 [m]. It is small: with 0 far ahead of 1, the reward of cutting in would be complete at the start."""
    speed: tuple[float, float]
    """Speed of each vehicle [m/s]."""
    offset: float
    """Largest distance of vehicles 0 and 1 from the centre of their lane [m]."""


class LaneChangingRange(MergeRange, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the scenes of a range of lane changes have in common."""

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


def sample_merge(
    scenes: LaneChangingRange, count: int, generator: torch.Generator, steps: int | None = None
) -> tuple[Float[Tensor, "B 3 6"], Float[Tensor, "B T 6"]]:
    """Initial states [x, y, v, θ, a, ω] of the three vehicles, and the states of the leader, which keeps its speed.

    T is `steps`, or the number of steps of the range.
    """
    starts, width = scenes.starts, scenes.reward.constants.width
    x_0 = -uniform(generator, *starts.headway, count)
    x_1 = x_0 - uniform(generator, *starts.lag, count)
    zero = torch.zeros(count)
    offset = uniform(generator, -starts.offset, starts.offset, count, 2)
    y = torch.stack([offset[:, 0] - width, offset[:, 1], zero], -1)
    v = uniform(generator, *starts.speed, count, 3)
    start = straight_states(torch.stack([x_0, x_1, zero], -1), y, v)
    time = torch.arange(steps or scenes.steps) * scenes.dt
    leader = start[:, 2:].repeat(1, len(time), 1)
    leader[..., 0] = v[:, 2:] * time
    return start, leader


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
        GraphShare(share=0.1, edges=edges({(2, 0): FOLLOW, (0, 1): YIELD})),
        GraphShare(share=0.1, edges=edges({(1, 0): CUT_IN, (0, 1): YIELD})),
        GraphShare(share=0.1, edges=follow_edges((1, 0), (2, 1))),
        GraphShare(share=0.1, edges=edges({(1, 0): YIELD, (2, 1): FOLLOW})),
        GraphShare(share=0.1, edges=follow_edges((2, 1))),
        GraphShare(share=0.1, edges=()),
    ),
)
