"""The kinds of recorded scenes, and what their models are built from (Sec. VI-D)."""

import msgspec

from gri.data.ranges import ONE_GRAPH, GraphShare
from gri.dynamics import DynamicsName
from gri.graph import FOLLOWING, YIELDING, Vocabulary
from gri.model import MERGE_BEHIND, MERGE_BETWEEN
from gri.scale import CAR_FOLLOWING_NGSIM, LANE_CHANGING_NGSIM, Scale
from gri.terms import NaturalisticConfig


class RecordedRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All that recorded scenes of one kind have in common (Sec. VI-D)."""

    name: str
    kinds: tuple[str, ...]
    """In the scene file."""
    steps: int
    reward: NaturalisticConfig
    scale: Scale
    dynamics: DynamicsName
    vocabulary: Vocabulary
    dt: float = 0.2
    never_reverse: bool = False
    one_graph: tuple[GraphShare, ...] = ONE_GRAPH

    @property
    def history_steps(self) -> int:
        """The encoder sees the whole scene, as in the paper."""
        return self.steps

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
    reward=NaturalisticConfig(lanes=True),
    scale=LANE_CHANGING_NGSIM,
    dynamics=DynamicsName.POINT_MASS_2D,
    vocabulary=YIELDING,
    one_graph=(GraphShare(share=0.5, edges=MERGE_BEHIND), GraphShare(share=0.5, edges=MERGE_BETWEEN)),
)
RECORDED = {scenes.name: scenes for scenes in (NGSIM_CAR_FOLLOWING, NGSIM_LANE_CHANGING)}
