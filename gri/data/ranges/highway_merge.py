"""Merges on a highway as SUMO's US-101 and I-80 nets show them: starts, histories and what the leader does.

The target lane has its centre at y = 0, the lane that ends to its right. A scene begins where a driver takes over.
Before that, up to `history_steps` states, nobody moves sideways: whoever merges is still on the far side of a solid
line and mostly brakes towards the slower lane. What happened there follows no reward; it is drawn (kinematics with
phases of constant acceleration), in a way that depends on the relations to come.
"""

from enum import StrEnum

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import DynamicsName
from gri.core.graph import LANE_CHANGING, EdgeType, Vocabulary
from gri.core.scale import Scale
from gri.data.ranges.car_following import GraphShare
from gri.data.ranges.leader import LeaderConfig, accelerations, uniform
from gri.networks.model import MERGE, Edge
from gri.rewards.car_following_features import FollowingConstants
from gri.rewards.lane_changing_features import LaneConstants
from gri.rewards.terms import LaneRewardConfig, LaneUnits, Units

LENGTH = 5.0  # [m] that a position counts for every vehicle ahead


class Situation(StrEnum):
    """How the three begin; every true graph belongs to one."""

    BETWEEN = "between"
    """0 beside the gap between 1 and 2."""
    BEHIND = "behind"
    """0 beside and behind 1, which is behind 2."""
    PASSING = "passing"
    """0 somewhere beside the row of 1 and 2."""
    MERGED = "merged"
    """0 in the target lane between 1 and 2."""


class SituationShare(GraphShare, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A true graph, how often it occurs, and how its scenes begin."""

    situation: Situation


class HighwayStarts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Distribution of states at the take-over; pairs of numbers are uniform ranges."""

    speed: tuple[float, float] = (2.0, 15.0)
    """Of the leader [m/s]."""
    lag_spread: float = 1.0
    """Standard deviation of v_1 − v_2 [m/s]."""
    faster: tuple[float, float] = (-1.0, 10.0)
    """v_0 − v_2 of a merger [m/s]; that of SUMO's mergers reaches 9."""
    gap: tuple[float, float] = (1.0, 23.0)
    """Net gaps [m], small ones more often: the square root of where they lie in the range is uniform."""
    lateral: tuple[float, float] = (-3.95, -3.55)
    """y of who is not in the target lane [m]."""
    offset: float = 0.1
    """Farthest from the centre in the target lane [m]."""
    braking: tuple[float, float] = (-2.2, -1.2)
    """Of a merger at the take-over [m/s²], in `braking_share` of the scenes."""
    braking_share: float = 0.7
    braking_since: tuple[float, float] = (0.4, 5.0)  # [s]
    acceleration: tuple[float, float] = (-1.5, 1.5)
    """Otherwise [m/s²]."""
    greatest_speed: float = 24.0  # [m/s]


class HighwayMergeRange(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All that a family of highway merges has in common."""

    name: str
    steps: int
    """T, from the take-over on."""
    history_steps: int
    """The take-over included."""
    starts: HighwayStarts
    leader: LeaderConfig
    slowest_leader: float
    """No leader slower than this [m/s]; a car cannot change lanes standing."""
    reward: LaneRewardConfig
    weights: dict[str, dict[str, float]]
    """The true weights 1 + e^ψ of the reward's terms."""
    scale: Scale
    one_graph: tuple[SituationShare, ...]
    mixed_graphs: tuple[SituationShare, ...]
    dt: float = 0.2
    never_reverse: bool = True

    @property
    def dynamics(self) -> DynamicsName:
        return DynamicsName.DUBINS

    @property
    def vocabulary(self) -> Vocabulary:
        return LANE_CHANGING


def sample_takeovers(
    scenes: HighwayMergeRange, situation: Situation, count: int, generator: torch.Generator
) -> Float[Tensor, "B 3 6"]:
    """States [x, y, v, θ, a, ω] of the three vehicles where a driver takes over; x counts from the leader."""
    starts = scenes.starts

    def gap(size: int) -> Tensor:
        low, high = starts.gap
        return LENGTH + low + (high - low) * torch.rand(size, generator=generator) ** 2

    def followed(v: Tensor) -> Tensor:
        constants = scenes.reward.constants.following
        return (constants.standstill + constants.time_headway * v) * uniform(generator, 0.8, 1.6, count)

    zero = torch.zeros(count)
    v_2 = uniform(generator, *starts.speed, count)
    v_1 = (v_2 + starts.lag_spread * torch.randn(count, generator=generator)).clamp(min=1.0)
    faster = uniform(generator, *starts.faster, count)
    match situation:
        case Situation.BETWEEN:
            v_0, x_0 = v_2 + faster, -gap(count)
            x_1 = x_0 - gap(count)
        case Situation.BEHIND:
            v_0, x_1 = v_1 + faster, -followed(v_1)
            x_0 = x_1 - gap(count)
        case Situation.PASSING:
            v_0, x_1 = v_2 + faster, -followed(v_1)
            x_0 = uniform(generator, -60.0, 40.0, count)
        case Situation.MERGED:
            v_0 = (v_2 + starts.lag_spread * torch.randn(count, generator=generator)).clamp(min=1.0)
            x_0 = -followed(v_0)
            x_1 = x_0 - followed(v_1)
    beside = uniform(generator, *starts.lateral, count)
    inside = uniform(generator, -starts.offset, starts.offset, count, 2)
    y_0 = inside[:, 0] if situation is Situation.MERGED else beside
    a_1 = uniform(generator, *starts.acceleration, count)
    state = [
        torch.stack([x_0, x_1, zero], -1),
        torch.stack([y_0, inside[:, 1], zero], -1),
        torch.stack([v_0.clamp(1.5, starts.greatest_speed), v_1, v_2], -1),
        torch.zeros(count, 3),
        torch.stack([_merger_acceleration(starts, situation, count, generator), a_1, zero], -1),
        torch.zeros(count, 3),
    ]
    return torch.stack(state, -1)


def _merger_acceleration(
    starts: HighwayStarts, situation: Situation, count: int, generator: torch.Generator
) -> Float[Tensor, " B"]:
    """Who wants into the slower lane brakes, who passes it does not."""
    free = uniform(generator, *starts.acceleration, count)
    if situation is Situation.PASSING:
        return free.abs()
    if situation is Situation.MERGED:
        return free
    braking = uniform(generator, *starts.braking, count)
    return torch.where(torch.rand(count, generator=generator) < starts.braking_share, braking, free)


def leader_drive(
    scenes: HighwayMergeRange, start: Float[Tensor, "B 6"], generator: torch.Generator
) -> Float[Tensor, "B T 6"]:
    """What the leader does from the take-over on: phases, above its least speed."""
    config, dt = scenes.leader, scenes.dt
    wanted = accelerations(config, len(start), scenes.steps, dt, generator).clamp(*config.acceleration)
    x, v = start[:, 0], start[:, 2]
    states = []
    for a in wanted.unbind(1):
        a = a.maximum((scenes.slowest_leader - v) / dt).minimum((config.speed[1] - v) / dt)
        states.append(torch.stack([x, start[:, 1], v, *[torch.zeros_like(x)] * 3], -1))
        states[-1][:, 4] = a
        x, v = x + v * dt, v + a * dt
    return torch.stack(states, 1)


def sample_history(
    scenes: HighwayMergeRange,
    situation: Situation,
    takeover: Float[Tensor, "B 3 6"],
    generator: torch.Generator,
) -> Float[Tensor, "B 3 H 6"]:
    """States up to the take-over, which is the last one: straight ahead, x' = x + v·Δt, by drawn accelerations.

    Who drives in the target lane follows the leader's speed; a merger drives on in phases, then brakes.
    """
    starts, dt, steps = scenes.starts, scenes.dt, scenes.history_steps - 1
    count = len(takeover)
    speed = takeover[..., 2]
    leader = _speeds_before(speed[:, 2], accelerations(scenes.leader, count, steps, dt, generator), dt)
    fading = torch.linspace(0.0, 1.0, steps + 1)

    def following(now: Tensor) -> Tensor:
        before = starts.lag_spread * torch.randn(count, 1, generator=generator)
        return leader + before * (1 - fading) + (now - speed[:, 2])[:, None] * fading

    if situation is Situation.MERGED:
        merger = following(speed[:, 0])
    else:
        merger = _speeds_before(speed[:, 0], _approach(scenes, takeover[:, 0, 4], generator), dt)
    v = torch.stack([merger, following(speed[:, 1]), leader], 1).clamp(0.0, starts.greatest_speed)
    history = torch.zeros(count, 3, steps + 1, 6)
    history[..., 1] = takeover[:, :, None, 1]
    history[..., 2] = v
    history[..., :-1, 4] = v.diff(dim=-1) / dt
    ahead = (v[..., :-1] * dt).flip(-1).cumsum(-1).flip(-1)
    history[..., :-1, 0] = takeover[:, :, None, 0] - ahead
    history[:, :, -1] = takeover
    return history


def _approach(scenes: HighwayMergeRange, last: Float[Tensor, " B"], generator: torch.Generator) -> Float[Tensor, "B S"]:
    """Accelerations of a merger before the take-over: what it does then, it has done for a while."""
    starts, dt, steps = scenes.starts, scenes.dt, scenes.history_steps - 1
    earlier = uniform(generator, *starts.acceleration, len(last), 1)
    since = uniform(generator, *starts.braking_since, len(last), 1)
    remaining = torch.arange(steps, 0, -1)[None] * dt
    noise = 0.2 * torch.randn(len(last), steps, generator=generator)
    return torch.where(remaining <= since, last[:, None], earlier) + noise


def _speeds_before(now: Float[Tensor, " B"], acceleration: Float[Tensor, "B S"], dt: float) -> Float[Tensor, "B S+1"]:
    """Speeds that end with the present one."""
    gained = (acceleration * dt).flip(-1).cumsum(-1).flip(-1)
    return torch.cat([now[:, None] - gained, now[:, None]], -1)


def _follow(*pairs: tuple[int, int]) -> tuple[Edge, ...]:
    return tuple(Edge(sender=i, receiver=j, type=EdgeType.FOLLOW) for i, j in pairs)


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
    # Chosen so that the optimum is across the line within 2 to 5 s, slower at walking pace, has mostly fallen behind
    # the leader when it gets there, and overshoots the centre of the lane by less than 0.7 m. Who cuts in wants to be
    # well ahead of whom it cuts in on: a wish that is mostly fulfilled at the start would not show in what it does.
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
        SituationShare(share=0.15, edges=_follow((1, 0), (2, 1)), situation=Situation.BEHIND),
        SituationShare(share=0.15, edges=_follow((2, 1)), situation=Situation.PASSING),
        SituationShare(share=0.1, edges=_follow((2, 0), (0, 1)), situation=Situation.MERGED),
    ),
)
