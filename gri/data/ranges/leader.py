"""How the given leader of a synthetic scene moves."""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.dynamics import POINT_MASS_1D, stop_at_standstill


class LeaderConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Phases of constant acceleration, the first one included; no phases: constant speed.

    Every phase draws its length and one of three moods: accelerate, brake (hard in `hard_share` of the
    cases) or hold the speed. A leader that has stopped stands until the phase is over. `jitter` adds an
    independent acceleration at every step, of a strength drawn per scene, as Krauss drivers in SUMO show it.
    """

    phases: bool = False
    duration: tuple[float, float] = (1.5, 6.0)  # [s]
    accelerate: tuple[float, float] = (0.2, 2.0)  # [m/s^2]
    brake: tuple[float, float] = (-2.5, -0.2)  # [m/s^2]
    brake_hard: tuple[float, float] = (-4.5, -2.5)  # [m/s^2]
    hard_share: float = 0.2
    jitter: float = 0.8  # [m/s^2], largest standard deviation
    acceleration: tuple[float, float] = (-4.5, 2.6)  # [m/s^2], after jitter
    speed: tuple[float, float] = (0.0, 22.0)  # [m/s]


def uniform(generator: torch.Generator, low: float, high: float, *shape: int) -> Tensor:
    return low + (high - low) * torch.rand(*shape, generator=generator)


def leader_states(
    config: LeaderConfig, start: Float[Tensor, "B 3"], steps: int, dt: float, generator: torch.Generator
) -> Float[Tensor, "B T 3"]:
    """T states of each leader, the start included."""
    if not config.phases:
        time = torch.arange(steps)[None] * dt
        speed = start[:, 1:2].expand(-1, steps)
        return torch.stack([start[:, :1] + speed * time, speed, torch.zeros_like(speed)], -1)
    wanted = accelerations(config, len(start), steps, dt, generator)
    states = [_limited(config, start[:, :2], wanted[:, 0], dt)]
    for t in range(1, steps):
        moved = POINT_MASS_1D.step(states[-1], torch.zeros_like(states[-1][:, :1]), dt)
        moved = stop_at_standstill(states[-1], moved)
        states.append(_limited(config, moved[:, :2], wanted[:, t], dt))
    return torch.stack(states, 1)


def _limited(config: LeaderConfig, moved: Tensor, acceleration: Tensor, dt: float) -> Float[Tensor, "B 3"]:
    """Position and speed with the acceleration, cut down so that the next speed stays in range."""
    low = torch.where(moved[:, 1] <= 0, 0.0, config.acceleration[0])
    high = ((config.speed[1] - moved[:, 1]) / dt).clamp(max=config.acceleration[1])
    return torch.cat([moved, acceleration.maximum(low).minimum(high)[:, None]], -1)


def accelerations(
    config: LeaderConfig, scenes: int, steps: int, dt: float, generator: torch.Generator
) -> Float[Tensor, "B T"]:
    """Piecewise constant accelerations plus jitter, before the limits of speed apply."""
    phases = int(steps * dt / config.duration[0]) + 2
    lengths = uniform(generator, *config.duration, scenes, phases)
    level = _moods(config, torch.rand(scenes, phases, generator=generator), generator)
    began = lengths.cumsum(1) - uniform(generator, 0.0, 1.0, scenes, 1) * lengths[:, :1]  # the first is under way
    time = torch.arange(steps)[None, :, None] * dt
    phase = (time >= began[:, None]).sum(-1).clamp(max=phases - 1)
    strength = uniform(generator, 0.0, config.jitter, scenes, 1)
    return level.gather(1, phase) + strength * torch.randn(scenes, steps, generator=generator)


def _moods(config: LeaderConfig, dice: Float[Tensor, "B P"], generator: torch.Generator) -> Float[Tensor, "B P"]:
    """Four in ten phases accelerate, three brake, three hold: brakings are harder, so both weigh the same."""
    shape = dice.shape
    brake = torch.where(
        torch.rand(shape, generator=generator) < config.hard_share,
        uniform(generator, *config.brake_hard, *shape),
        uniform(generator, *config.brake, *shape),
    )
    accelerate = uniform(generator, *config.accelerate, *shape)
    return torch.where(dice < 0.4, accelerate, torch.where(dice < 0.7, brake, torch.zeros(shape)))
