"""The kinds of recorded scenes, in traffic and in SUMO, and what their models are built from (Sec. VI-C, VI-D)."""

import msgspec

from gri.core.dynamics import DynamicsName
from gri.core.graph import FOLLOWING, LANE_CHANGING, YIELDING, Vocabulary
from gri.core.scale import CAR_FOLLOWING_NGSIM, LANE_CHANGING_NGSIM, Scale
from gri.data.ranges.car_following import ONE_GRAPH, US101, GraphShare
from gri.data.ranges.highway_merge import HIGHWAY_MERGE, LENGTH
from gri.networks.model import MERGE, MERGE_BEHIND, MERGE_BETWEEN
from gri.rewards.recorded_traffic_features import References
from gri.rewards.terms import AnyRewardConfig, NaturalisticConfig


class RecordedRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All that scenes of one kind, recorded in traffic or in SUMO, have in common."""

    name: str
    kinds: tuple[str, ...]
    """In the scene file."""
    steps: int
    reward: AnyRewardConfig
    scale: Scale
    dynamics: DynamicsName
    vocabulary: Vocabulary
    dt: float = 0.2
    never_reverse: bool = False
    length: float | None = None
    """Of every vehicle ahead as models of SUMO's traffic count it [m]; None: as it is."""
    seen: int | None = None
    """Steps from which the encoder infers; None: the whole scene, as in the paper."""
    one_graph: tuple[GraphShare, ...] = ONE_GRAPH

    @property
    def lanes(self) -> bool:
        """Whether vehicles change lanes."""
        return self.dynamics is not DynamicsName.POINT_MASS_1D

    @property
    def history_steps(self) -> int:
        """From how many steps the encoder infers the graph."""
        return self.seen or self.steps

    @property
    def mixed_graphs(self) -> tuple[GraphShare, ...]:
        """No labels but the file's."""
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
    length=LENGTH,
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
    length=LENGTH,
    one_graph=(GraphShare(share=1.0, edges=MERGE),),
)
"""The whole scene is seen: who cut in shows only after it has."""
RECORDED = {s.name: s for s in (NGSIM_CAR_FOLLOWING, NGSIM_LANE_CHANGING, SUMO_CAR_FOLLOWING, SUMO_MERGE)}
