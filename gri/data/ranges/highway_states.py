"""Random states of highway merges: take-overs, the histories before them, and what the leader does afterwards.

A scene begins at the take-over, where the policy begins to drive. In the history before it, no vehicle moves sideways:
a merging vehicle is still beside the solid line, and mostly brakes towards the slower lane. Histories obey no reward.
They are drawn: straight motion with phases of constant acceleration, in a way that depends on the graph of the scene.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from gri.data.ranges.highway_merge import HighwayMergeRange, HighwayStarts, Situation
from gri.data.ranges.leader import accelerations, uniform
from gri.data.ranges.merge_geometry import VEHICLE_LENGTH, straight_states


def sample_takeovers(
    scenes: HighwayMergeRange, situation: Situation, count: int, generator: torch.Generator
) -> Float[Tensor, "B 3 6"]:
    """States [x, y, v, θ, a, ω] of the three vehicles at the take-over; x is relative to the leader."""
    starts = scenes.starts

    def headway_beside() -> Tensor:
        low, high = starts.gap
        return VEHICLE_LENGTH + low + (high - low) * torch.rand(count, generator=generator) ** 2

    def headway_behind(v: Tensor) -> Tensor:
        constants = scenes.reward.constants.following
        return (constants.standstill + constants.time_headway * v) * uniform(generator, 0.8, 1.6, count)

    zero = torch.zeros(count)
    v_2 = uniform(generator, *starts.speed, count)
    v_1 = (v_2 + starts.lag_spread * torch.randn(count, generator=generator)).clamp(min=1.0)
    faster = uniform(generator, *starts.faster, count)
    match situation:
        case Situation.BETWEEN:
            v_0, x_0 = v_2 + faster, -headway_beside()
            x_1 = x_0 - headway_beside()
        case Situation.BEHIND:
            v_0, x_1 = v_1 + faster, -headway_behind(v_1)
            x_0 = x_1 - headway_beside()
        case Situation.PASSING:
            v_0, x_1 = v_2 + faster, -headway_behind(v_1)
            x_0 = uniform(generator, -60.0, 40.0, count)
        case Situation.MERGED:
            v_0 = (v_2 + starts.lag_spread * torch.randn(count, generator=generator)).clamp(min=1.0)
            x_0 = -headway_behind(v_0)
            x_1 = x_0 - headway_behind(v_1)
    y_right_lane = uniform(generator, *starts.lateral, count)
    y_target_lane = uniform(generator, -starts.offset, starts.offset, count, 2)
    y_0 = y_target_lane[:, 0] if situation is Situation.MERGED else y_right_lane
    a_1 = uniform(generator, *starts.acceleration, count)
    a_0 = _acceleration_at_takeover(starts, situation, count, generator)
    return straight_states(
        x=torch.stack([x_0, x_1, zero], -1),
        y=torch.stack([y_0, y_target_lane[:, 1], zero], -1),
        v=torch.stack([v_0.clamp(1.5, starts.greatest_speed), v_1, v_2], -1),
        a=torch.stack([a_0, a_1, zero], -1),
    )


def _acceleration_at_takeover(
    starts: HighwayStarts, situation: Situation, count: int, generator: torch.Generator
) -> Float[Tensor, " B"]:
    """a_0 [m/s²]: a vehicle that merges into the slower lane mostly brakes, a vehicle that passes does not."""
    free = uniform(generator, *starts.acceleration, count)
    if situation is Situation.PASSING:
        return free.abs()
    if situation is Situation.MERGED:
        return free
    braking = uniform(generator, *starts.braking, count)
    return torch.where(torch.rand(count, generator=generator) < starts.braking_share, braking, free)


def sample_leader(
    scenes: HighwayMergeRange, start: Float[Tensor, "B 6"], generator: torch.Generator
) -> Float[Tensor, "B T 6"]:
    """T states of the leader from the take-over on: phases of constant acceleration, never below its least speed."""
    config, dt = scenes.leader, scenes.dt
    drawn = accelerations(config, len(start), scenes.steps, dt, generator).clamp(*config.acceleration)
    x, v = start[:, 0], start[:, 2]
    states = []
    for a in drawn.unbind(1):
        a = a.maximum((scenes.slowest_leader - v) / dt).minimum((config.speed[1] - v) / dt)
        states.append(straight_states(x, start[:, 1], v, a))
        x, v = x + v * dt, v + a * dt
    return torch.stack(states, 1)


def sample_history(
    scenes: HighwayMergeRange,
    situation: Situation,
    takeover: Float[Tensor, "B 3 6"],
    generator: torch.Generator,
) -> Float[Tensor, "B 3 H 6"]:
    """H states up to and including the take-over: straight ahead, x' = x + v·Δt, with drawn accelerations.

    Vehicles in the target lane follow the speed of the leader. A merging vehicle drives in phases, then mostly brakes.
    """
    starts, dt, steps = scenes.starts, scenes.dt, scenes.history_steps - 1
    count = len(takeover)
    speed = takeover[..., 2]
    leader = _speeds_before(speed[:, 2], accelerations(scenes.leader, count, steps, dt, generator), dt)
    fading = torch.linspace(0.0, 1.0, steps + 1)

    def speeds_behind_leader(now: Tensor) -> Tensor:
        before = starts.lag_spread * torch.randn(count, 1, generator=generator)
        return leader + before * (1 - fading) + (now - speed[:, 2])[:, None] * fading

    if situation is Situation.MERGED:
        merging = speeds_behind_leader(speed[:, 0])
    else:
        merging = _speeds_before(speed[:, 0], _accelerations_before(scenes, takeover[:, 0, 4], generator), dt)
    v = torch.stack([merging, speeds_behind_leader(speed[:, 1]), leader], 1).clamp(0.0, starts.greatest_speed)
    history = torch.zeros(count, 3, steps + 1, 6)
    history[..., 1] = takeover[:, :, None, 1]
    history[..., 2] = v
    history[..., :-1, 4] = v.diff(dim=-1) / dt
    still_to_travel = (v[..., :-1] * dt).flip(-1).cumsum(-1).flip(-1)
    history[..., :-1, 0] = takeover[:, :, None, 0] - still_to_travel
    history[:, :, -1] = takeover
    return history


def _accelerations_before(
    scenes: HighwayMergeRange, at_takeover: Float[Tensor, " B"], generator: torch.Generator
) -> Float[Tensor, "B S"]:
    """Accelerations [m/s²] of the merging vehicle before the take-over: one phase, then that of the take-over."""
    starts, dt, steps = scenes.starts, scenes.dt, scenes.history_steps - 1
    earlier = uniform(generator, *starts.acceleration, len(at_takeover), 1)
    since = uniform(generator, *starts.braking_since, len(at_takeover), 1)
    remaining = torch.arange(steps, 0, -1)[None] * dt
    noise = 0.2 * torch.randn(len(at_takeover), steps, generator=generator)
    return torch.where(remaining <= since, at_takeover[:, None], earlier) + noise


def _speeds_before(now: Float[Tensor, " B"], acceleration: Float[Tensor, "B S"], dt: float) -> Float[Tensor, "B S+1"]:
    """Speeds [m/s] over S steps that end with the present speed."""
    gained = (acceleration * dt).flip(-1).cumsum(-1).flip(-1)
    return torch.cat([now[:, None] - gained, now[:, None]], -1)
