"""The ranges of recorded scenes: NGSIM traffic (Sec. VI-D) and traffic in SUMO (reward of Sec. VI-C).

Scenes of these ranges are read from scene files. A range says which kinds of scenes belong to it, and with which
reward, dynamics and edge types models are trained on them.
"""

import msgspec

from gri.core.dynamics import DynamicsName
from gri.core.graph import FOLLOWING, LANE_CHANGING, YIELDING, Vocabulary
from gri.core.scale import CAR_FOLLOWING_NGSIM, LANE_CHANGING_NGSIM, Scale
from gri.data.ranges.car_following import ONE_GRAPH, US101
from gri.data.ranges.graph_shares import GraphShare
from gri.data.ranges.highway_merge import HIGHWAY_MERGE
from gri.data.ranges.merge_geometry import VEHICLE_LENGTH
from gri.networks.model import MERGE, MERGE_BEHIND, MERGE_BETWEEN
from gri.rewards.recorded_traffic_features import References
from gri.rewards.terms import AnyRewardConfig, NaturalisticConfig


class RecordedRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the scenes of one recorded range have in common."""

    name: str
    kinds: tuple[str, ...]
    """Values of `kind` in the scene file."""
    steps: int
    """T, the number of states of a scene."""
    reward: AnyRewardConfig
    scale: Scale
    dynamics: DynamicsName
    vocabulary: Vocabulary
    dt: float = 0.2
    never_reverse: bool = False
    length: float | None = None
    """Length that the models assume for every vehicle [m], as in SUMO; None: the recorded lengths."""
    seen: int | None = None
    """Number of states from which the encoder infers the graph; None: the whole scene, as in the paper."""
    one_graph: tuple[GraphShare, ...] = ONE_GRAPH

    @property
    def lanes(self) -> bool:
        """Whether the vehicles of this range change lanes."""
        return self.dynamics is not DynamicsName.POINT_MASS_1D

    @property
    def history_steps(self) -> int:
        """Number of states from which the encoder infers the graph."""
        return self.seen or self.steps

    @property
    def mixed_graphs(self) -> tuple[GraphShare, ...]:
        """The same as `one_graph`: the scene file has the labels."""
        return self.one_graph


NGSIM_CAR_FOLLOWING = RecordedRange(
    name="ngsim_car_following",
    kinds=("car_following",),
    steps=30,
    reward=NaturalisticConfig(),
    scale=CAR_FOLLOWING_NGSIM,
    dynamics=DynamicsName.POINT_MASS_1D,
    vocabulary=FOLLOWING,
    never_reverse=True,
)
NGSIM_LANE_CHANGING = RecordedRange(
    name="ngsim_lane_changing",
    kinds=("lane_changing_h1", "lane_changing_h2"),
    steps=40,
    reward=NaturalisticConfig(lanes=True, references=References(distance=25.0, time=1.8, catch_up=1.0)),
    scale=LANE_CHANGING_NGSIM,
    dynamics=DynamicsName.POINT_MASS_2D,
    vocabulary=YIELDING,
    one_graph=(GraphShare(share=0.5, edges=MERGE_BEHIND), GraphShare(share=0.5, edges=MERGE_BETWEEN)),
)
SUMO_CAR_FOLLOWING = RecordedRange(
    name="sumo_car_following",
    kinds=("car_following",),
    steps=30,
    seen=25,
    reward=US101.reward,
    scale=US101.scale,
    dynamics=DynamicsName.POINT_MASS_1D,
    vocabulary=FOLLOWING,
    never_reverse=True,
    length=VEHICLE_LENGTH,
)
SUMO_MERGE = RecordedRange(
    name="sumo_merge",
    kinds=("merge",),
    steps=40,
    reward=HIGHWAY_MERGE.reward,
    scale=HIGHWAY_MERGE.scale,
    dynamics=DynamicsName.DUBINS,
    vocabulary=LANE_CHANGING,
    never_reverse=True,
    length=VEHICLE_LENGTH,
    one_graph=(GraphShare(share=1.0, edges=MERGE),),
)
"""The encoder reads the whole scene: a cut-in shows only after it has happened."""
RECORDED = {s.name: s for s in (NGSIM_CAR_FOLLOWING, NGSIM_LANE_CHANGING, SUMO_CAR_FOLLOWING, SUMO_MERGE)}
