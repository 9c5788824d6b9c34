"""Highway merges as on SUMO's US-101 and I-80 nets: the situations, the distribution of starts, and the true reward.

A scene begins at the take-over, where the policy begins to drive. `gri.data.ranges.highway_states` draws the states at
the take-over and the history before it. `gri.data.ranges.merge_geometry` says which vehicle is which, and where the
lanes are.
"""

from enum import StrEnum

import msgspec

from gri.core.scale import Scale
from gri.data.ranges.graph_shares import GraphShare, follow_edges
from gri.data.ranges.leader import LeaderConfig
from gri.data.ranges.merge_geometry import MergeRange
from gri.networks.model import MERGE
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import LaneConstants
from gri.rewards.terms import LaneRewardConfig, LaneUnits, Units


class Situation(StrEnum):
    """Where the three vehicles are at the take-over; every true graph belongs to one situation."""

    BETWEEN = "between"
    """0 is in the right lane, beside the gap between 1 and 2."""
    BEHIND = "behind"
    """0 is in the right lane and behind 1, which is behind 2."""
    PASSING = "passing"
    """0 is in the right lane, anywhere beside 1 and 2, and stays there."""
    MERGED = "merged"
    """0 is in the target lane, between 1 and 2."""


class SituationShare(GraphShare, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A true graph, its share of the scenes, and the situation in which they begin."""

    situation: Situation


class HighwayStarts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distribution of states at the take-over; pairs of numbers are uniform ranges, unless stated otherwise."""

    speed: tuple[float, float] = (2.0, 15.0)
    """Speed of the leader [m/s]."""
    lag_spread: float = 1.0
    """Standard deviation of v_1 − v_2 [m/s]."""
    faster: tuple[float, float] = (-1.0, 10.0)
    """v_0 − v_2 of a merging vehicle [m/s]; in SUMO it reaches 9 m/s."""
    gap: tuple[float, float] = (1.0, 23.0)
    """Net gaps [m]. Small gaps are more frequent: gap = low + (high − low)·u² with u uniform in 0 to 1."""
    lateral: tuple[float, float] = (-3.95, -3.55)
    """y of a vehicle in the right lane [m]."""
    offset: float = 0.1
    """Largest |y| of a vehicle in the target lane [m]."""
    braking: tuple[float, float] = (-2.2, -1.2)
    """Acceleration of a merging vehicle at the take-over [m/s²], in `braking_share` of the scenes."""
    braking_share: float = 0.7
    """Share of the scenes in which a merging vehicle brakes at the take-over."""
    braking_since: tuple[float, float] = (0.4, 5.0)
    """Time before the take-over at which the acceleration of the take-over begins [s]."""
    acceleration: tuple[float, float] = (-1.5, 1.5)
    """All other accelerations of vehicles 0 and 1 [m/s²]."""
    greatest_speed: float = 24.0
    """Largest speed of all vehicles [m/s]."""


class HighwayMergeRange(MergeRange, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the scenes of a range of highway merges have in common."""

    name: str
    steps: int
    """T, the number of states from the take-over on."""
    history_steps: int
    """Number of states up to and including the take-over."""
    starts: HighwayStarts
    leader: LeaderConfig
    slowest_leader: float
    """Least speed of the leader [m/s]; a car that stands cannot change lanes."""
    reward: LaneRewardConfig
    weights: dict[str, dict[str, float]]
    """The true weights 1 + e^ψ of the reward's terms."""
    scale: Scale
    one_graph: tuple[SituationShare, ...]
    mixed_graphs: tuple[SituationShare, ...]
    dt: float = 0.2
    never_reverse: bool = True


HIGHWAY_MERGE = HighwayMergeRange(
    name="highway_merge",
    steps=41,
    history_steps=25,
    starts=HighwayStarts(),
    leader=LeaderConfig(
        phases=True,
        hard_share=0.2,
        jitter=0.5,
        brake=(-2.0, -0.2),
        accelerate=(0.2, 1.5),
        acceleration=(-4.0, 2.0),
        speed=(0.0, 20.0),
    ),
    slowest_leader=0.8,
    # Chosen so that the optimum crosses the line within 2 to 5 s (later at walking pace), is then mostly behind the
    # leader, and overshoots the centre of the lane by less than 0.7 m. The headway of a cut-in is large on purpose: a
    # cut-in that is mostly complete at the start would not show in the motion.
    reward=LaneRewardConfig(
        constants=LaneConstants(
            following=FollowingConstants(
                standstill=9.0, time_headway=0.7, comfort=4.0, minimum=9.0, zeta=5.0, speed_limit=20.0
            ),
            width=3.75,
            yield_headway=16.0,
            clear_headway=8.2,
        ),
        units=Units(gap=4.5, collision=0.27, speed=6.5),
        lane_units=LaneUnits(lateral=2.1, heading=0.45, yaw_rate=0.22, yaw_acceleration=0.17),
        temperature=0.5,
    ),
    weights={
        "node": {
            "speed": 1.2,
            "acceleration": 1.5,
            "heading": 1.2,
            "yaw_rate": 1.5,
            "jerk": 2.0,
            "yaw_acceleration": 1.5,
            "lane": 1.2,
        },
        "follow": {"idm": 1.5, "dist": 5.0, "lat": 3.0},
        "yield": {"yield": 2.0, "dist": 5.0},
        "cut_in": {"goal": 5.0, "dist": 3.0},
    },
    scale=Scale(offset=(0.0, -1.8, 8.0, 0.0, 0.0, 0.0), unit=(12.0, 1.8, 5.0, 0.1, 1.5, 0.1), action=(1.5, 0.1)),
    one_graph=(SituationShare(share=1.0, edges=MERGE, situation=Situation.BETWEEN),),
    mixed_graphs=(
        SituationShare(share=0.6, edges=MERGE, situation=Situation.BETWEEN),
        SituationShare(share=0.15, edges=follow_edges((1, 0), (2, 1)), situation=Situation.BEHIND),
        SituationShare(share=0.15, edges=follow_edges((2, 1)), situation=Situation.PASSING),
        SituationShare(share=0.1, edges=follow_edges((2, 0), (0, 1)), situation=Situation.MERGED),
    ),
)
