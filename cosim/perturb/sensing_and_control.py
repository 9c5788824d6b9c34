"""Perturbed sensors and actuators of one round: noise, latency and dropout of what a policy observes, and noise, delay
and limits of its actions.

All random numbers are drawn in advance, from the scenario's seed and the names of the group, so that all policies meet
the same noise.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cosim.perturb.traffic_demand import GRAVITY
from cosim.spec.perturbations import (
    ActionDelay,
    ActionNoise,
    Dropout,
    Latency,
    LowFriction,
    ObservationNoise,
    Perturbation,
)
from gri.core.dynamics import Dynamics

States = Float[Tensor, "G 3 D"]
Filter = Callable[[int, Tensor], Tensor]
"""(number of the step, value) -> value; called once per step, in order."""


@dataclass(frozen=True)
class RoundSetting:
    """What the channels depend on in a round.

    `names` identify its groups, `driven_roles` are the roles that the policy drives, `past` are the states before the
    take-over, `steps` is the largest number of steps, `dt` [s] is the length of a step.
    """

    dynamics: Dynamics
    dt: float
    steps: int
    seed: int
    names: tuple[str, ...]
    driven_roles: tuple[int, ...]
    past: tuple[Tensor, ...]


@dataclass(frozen=True)
class SensingAndControl:
    """The channels between the world and a policy; without filters and limit they change nothing.

    `always_known` are the features that the policy knows without observing them, `limit` [m/s²] is the largest
    acceleration or braking that the road surface allows.
    """

    dynamics: Dynamics
    observation: tuple[Filter, ...] = ()
    action: tuple[Filter, ...] = ()
    always_known: Bool[Tensor, "3 D"] | None = None
    limit: float | None = None

    def observed_state(self, step: int, state: States) -> States:
        """What the policy observes, with what it always knows of the vehicles that it drives."""
        if not self.observation:
            return state
        observed = _through(self.observation, step, state)
        return observed if self.always_known is None else torch.where(self.always_known, state, observed)

    def executed_action(self, step: int, action: Float[Tensor, "G 3 A"]) -> Float[Tensor, "G 3 A"]:
        """The action that the vehicle executes."""
        return _through(self.action, step, action)

    def feasible_state(self, state: States) -> States:
        """The next state with an acceleration that the road surface allows."""
        if self.limit is None:
            return state
        bounded, a = state.clone(), self.dynamics.index("a")
        bounded[..., a] = state[..., a].clamp(-self.limit, self.limit)
        return bounded


def _through(filters: Sequence[Filter], step: int, value: Tensor) -> Tensor:
    for apply in filters:
        value = apply(step, value)
    return value


def sensing_and_control(perturbations: Sequence[Perturbation], setting: RoundSetting) -> SensingAndControl:
    """The channels under these perturbations; other kinds of perturbations change nothing here."""
    observation: list[Filter] = []
    action: list[Filter] = []
    limits: list[float] = []
    for spec in perturbations:
        match spec:
            case ObservationNoise():
                observation.append(_add(_noise(spec.kind, setting, _observation_sigma(spec, setting.dynamics))))
            case Dropout():
                observation.append(_drop(spec, setting))
            case Latency():
                observation.append(_delay(list(setting.past), delay_steps(spec.intensity, setting.dt)))
            case ActionNoise():
                scale = {"jerk": 1.0, "yaw_acceleration": spec.yaw}
                sigma = [spec.intensity * scale[name] for name in setting.dynamics.action]
                action.append(_add(_noise(spec.kind, setting, sigma)))
            case ActionDelay():
                steps = delay_steps(spec.intensity, setting.dt)
                none = torch.zeros(len(setting.names), 3, len(setting.dynamics.action), dtype=torch.float64)
                action.append(_delay([none] * steps, steps))
            case LowFriction(intensity=friction):
                limits.append(friction * GRAVITY)
    return SensingAndControl(
        dynamics=setting.dynamics,
        observation=tuple(observation),
        action=tuple(action),
        always_known=_always_known(setting.driven_roles, setting.dynamics),
        limit=min(limits, default=None),
    )


def _always_known(driven_roles: Sequence[int], dynamics: Dynamics) -> Bool[Tensor, "3 D"]:
    """The features that a driver feels or has commanded itself: the acceleration and yaw rate of its own vehicle."""
    known = torch.zeros(3, len(dynamics.state), dtype=torch.bool)
    features = [k for k, name in enumerate(dynamics.state) if name in ("a", "yaw_rate")]
    known[torch.tensor(driven_roles)[:, None], torch.tensor(features)] = True
    return known


def delay_steps(seconds: float, dt: float) -> int:
    """A delay [s] in steps of `dt` [s], rounded."""
    return round(seconds / dt)


def _observation_sigma(spec: ObservationNoise, dynamics: Dynamics) -> list[float]:
    """Standard deviation of every state feature."""
    scale = {"x": 1.0, "y": spec.across, "v": spec.speed}
    return [spec.intensity * scale.get(name, 0.0) for name in dynamics.state]


def _rng(kind: str, setting: RoundSetting, group: str) -> np.random.Generator:
    return np.random.default_rng([setting.seed, crc32(group.encode()), crc32(kind.encode())])


def _noise(kind: str, setting: RoundSetting, sigma: Sequence[float]) -> Float[Tensor, "T G 3 F"]:
    """White noise with these standard deviations for every step, group and vehicle."""
    drawn = [_rng(kind, setting, name).standard_normal((setting.steps, 3, len(sigma))) for name in setting.names]
    return torch.from_numpy(np.stack(drawn, axis=1) * np.array(sigma))


def _add(noise: Float[Tensor, "T G 3 F"]) -> Filter:
    return lambda step, value: value + noise[step].to(value.dtype)


def _drop(spec: Dropout, setting: RoundSetting) -> Filter:
    """Lose states at random and repeat the last one received; the first state is always received."""
    lost = [_rng(spec.kind, setting, name).random((setting.steps, 3)) < spec.intensity for name in setting.names]
    missing = torch.from_numpy(np.stack(lost, axis=1))[..., None]
    held: list[Tensor] = []

    def drop(step: int, value: Tensor) -> Tensor:
        received = torch.where(missing[step], held[0], value) if held else value
        held[:] = [received]
        return received

    return drop


def _delay(past: Sequence[Tensor], steps: int) -> Filter:
    """Return the value of `steps` ago; `past` are the values before the first step, repeated at the front."""
    earlier = [*past[:1]] * max(steps - len(past), 0)
    waiting = deque([*earlier, *past[max(len(past) - steps, 0) :]])

    def delay(step: int, value: Tensor) -> Tensor:
        waiting.append(value)
        return waiting.popleft().to(value.dtype)

    return delay
