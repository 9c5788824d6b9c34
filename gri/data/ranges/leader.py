"""The motion of the leader in synthetic car-following scenes; the leader's trajectory is given (Sec. VI-C)."""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import POINT_MASS_1D, stop_at_standstill


class LeaderConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Phases of constant acceleration, or constant speed throughout; pairs of numbers are ranges.

    Every phase draws its length, and whether the leader accelerates, brakes or keeps its speed. A leader that has
    stopped stands until the phase is over. Jitter is an independent acceleration at every step, as Krauss drivers in
    SUMO have it; its standard deviation is drawn per scene.
    """

    phases: bool = False
    """False: constant speed; the other fields are then not used."""
    duration: tuple[float, float] = (1.5, 6.0)
    """Length of a phase [s]."""
    accelerate: tuple[float, float] = (0.2, 2.0)
    """Acceleration of an accelerating phase [m/s²]."""
    brake: tuple[float, float] = (-2.5, -0.2)
    """Acceleration of a braking phase [m/s²]."""
    brake_hard: tuple[float, float] = (-4.5, -2.5)
    """Acceleration of a hard-braking phase [m/s²]."""
    hard_share: float = 0.2
    """Share of braking phases that brake hard."""
    jitter: float = 0.8
    """Largest standard deviation of the jitter [m/s²]."""
    acceleration: tuple[float, float] = (-4.5, 2.6)
    """Limits of the acceleration, jitter included [m/s²]."""
    speed: tuple[float, float] = (0.0, 22.0)
    """Limits of the speed [m/s]."""


def uniform(generator: torch.Generator, low: float, high: float, *shape: int) -> Tensor:
    """Uniform random numbers between `low` and `high`, in a tensor of that shape."""
    return low + (high - low) * torch.rand(*shape, generator=generator)


def leader_states(
    config: LeaderConfig, start: Float[Tensor, "B 3"], steps: int, dt: float, generator: torch.Generator
) -> Float[Tensor, "B T 3"]:
    """T states [x, v, a] of each leader, the start included; `dt` is in seconds."""
    if not config.phases:
        time = torch.arange(steps)[None] * dt
        speed = start[:, 1:2].expand(-1, steps)
        return torch.stack([start[:, :1] + speed * time, speed, torch.zeros_like(speed)], -1)
    drawn = accelerations(config, len(start), steps, dt, generator)
    states = [_limited(config, start[:, :2], drawn[:, 0], dt)]
    for t in range(1, steps):
        moved = POINT_MASS_1D.step(states[-1], torch.zeros_like(states[-1][:, :1]), dt)
        moved = stop_at_standstill(states[-1], moved)
        states.append(_limited(config, moved[:, :2], drawn[:, t], dt))
    return torch.stack(states, 1)


def _limited(config: LeaderConfig, moved: Tensor, acceleration: Tensor, dt: float) -> Float[Tensor, "B 3"]:
    """Position and speed [B, 2] with the acceleration, cut so that the next speed stays within its limits."""
    low = torch.where(moved[:, 1] <= 0, 0.0, config.acceleration[0])
    high = ((config.speed[1] - moved[:, 1]) / dt).clamp(max=config.acceleration[1])
    return torch.cat([moved, acceleration.maximum(low).minimum(high)[:, None]], -1)


def accelerations(
    config: LeaderConfig, scenes: int, steps: int, dt: float, generator: torch.Generator
) -> Float[Tensor, "B T"]:
    """Piecewise constant accelerations plus jitter [m/s²], before the limits apply."""
    phases = int(steps * dt / config.duration[0]) + 2
    lengths = uniform(generator, *config.duration, scenes, phases)
    level = _phase_accelerations(config, scenes, phases, generator)
    began = (
        lengths.cumsum(1) - uniform(generator, 0.0, 1.0, scenes, 1) * lengths[:, :1]
    )  # the first phase has begun before the scene
    time = torch.arange(steps)[None, :, None] * dt
    phase = (time >= began[:, None]).sum(-1).clamp(max=phases - 1)
    strength = uniform(generator, 0.0, config.jitter, scenes, 1)
    return level.gather(1, phase) + strength * torch.randn(scenes, steps, generator=generator)


def _phase_accelerations(
    config: LeaderConfig, scenes: int, phases: int, generator: torch.Generator
) -> Float[Tensor, "B P"]:
    """One acceleration per phase [m/s²]: 40 % of the phases accelerate, 30 % brake, 30 % keep the speed.

    Brakings are harder than accelerations, so that the speed does not drift.
    """
    shape = (scenes, phases)
    chance = torch.rand(shape, generator=generator)
    brake = torch.where(
        torch.rand(shape, generator=generator) < config.hard_share,
        uniform(generator, *config.brake_hard, *shape),
        uniform(generator, *config.brake, *shape),
    )
    accelerate = uniform(generator, *config.accelerate, *shape)
    return torch.where(chance < 0.4, accelerate, torch.where(chance < 0.7, brake, torch.zeros(shape)))
