"""What lies between the world and a policy, and between the policy and the wheels, in one round of groups.

Everything random is drawn beforehand from a seed that is the scenario's and the group's own, so that all policies meet
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
class Setting:
    """What signals have to know of a round.

    `names` identify its groups, `owned` are the roles that the policy drives, `past` are the states before the
    take-over, `steps` how many steps there are at most.
    """

    dynamics: Dynamics
    dt: float
    steps: int
    seed: int
    names: tuple[str, ...]
    owned: tuple[int, ...]
    past: tuple[Tensor, ...]


@dataclass(frozen=True)
class Signals:
    """The perturbed channels; `known` is what the policy need not observe, `limit` [m/s²] what the road gives."""

    observation: tuple[Filter, ...]
    action: tuple[Filter, ...]
    known: Bool[Tensor, "3 D"]
    limit: float | None
    dynamics: Dynamics

    def see(self, step: int, state: States) -> States:
        """What the policy sees, and what it knows of the vehicles that it drives."""
        return torch.where(self.known, state, _through(self.observation, step, state))

    def apply(self, step: int, action: Float[Tensor, "G 3 A"]) -> Float[Tensor, "G 3 A"]:
        """The action that reaches the wheels."""
        return _through(self.action, step, action)

    def bound(self, state: States) -> States:
        """The next state as the road allows it."""
        if self.limit is None:
            return state
        bounded, a = state.clone(), self.dynamics.index("a")
        bounded[..., a] = state[..., a].clamp(-self.limit, self.limit)
        return bounded


def _through(filters: Sequence[Filter], step: int, value: Tensor) -> Tensor:
    for change in filters:
        value = change(step, value)
    return value


def signals(perturbations: Sequence[Perturbation], setting: Setting) -> Signals | None:
    """The channels as the perturbations make them; None where none of them does anything here."""
    observation: list[Filter] = []
    action: list[Filter] = []
    limits: list[float] = []
    for spec in perturbations:
        match spec:
            case ObservationNoise():
                observation.append(_adding(_noise(spec.kind, setting, _observed(spec, setting.dynamics))))
            case Dropout():
                observation.append(_dropping(spec, setting))
            case Latency():
                observation.append(_delaying(list(setting.past), delay_steps(spec.intensity, setting.dt)))
            case ActionNoise():
                scale = {"jerk": 1.0, "yaw_acceleration": spec.yaw}
                sigma = [spec.intensity * scale[name] for name in setting.dynamics.action]
                action.append(_adding(_noise(spec.kind, setting, sigma)))
            case ActionDelay():
                steps = delay_steps(spec.intensity, setting.dt)
                none = torch.zeros(len(setting.names), 3, len(setting.dynamics.action), dtype=torch.float64)
                action.append(_delaying([none] * steps, steps))
            case LowFriction(intensity=friction):
                limits.append(friction * GRAVITY)
    if not (observation or action or limits):
        return None
    known = _known(setting.owned, setting.dynamics)
    return Signals(tuple(observation), tuple(action), known, min(limits, default=None), setting.dynamics)


def _known(owned: Sequence[int], dynamics: Dynamics) -> Bool[Tensor, "3 D"]:
    """What a driver feels or has commanded, and so knows at once: its own acceleration and yaw rate."""
    known = torch.zeros(3, len(dynamics.state), dtype=torch.bool)
    features = [k for k, name in enumerate(dynamics.state) if name in ("a", "yaw_rate")]
    known[torch.tensor(owned)[:, None], torch.tensor(features)] = True
    return known


def delay_steps(seconds: float, dt: float) -> int:
    """A delay [s] in whole steps, the nearest number of them."""
    return round(seconds / dt)


def _observed(spec: ObservationNoise, dynamics: Dynamics) -> list[float]:
    scale = {"x": 1.0, "y": spec.across, "v": spec.speed}
    return [spec.intensity * scale.get(name, 0.0) for name in dynamics.state]


def _rng(kind: str, setting: Setting, group: str) -> np.random.Generator:
    return np.random.default_rng([setting.seed, crc32(group.encode()), crc32(kind.encode())])


def _noise(kind: str, setting: Setting, sigma: Sequence[float]) -> Float[Tensor, "T G 3 F"]:
    """White noise with these standard deviations for every step, group and vehicle."""
    drawn = [_rng(kind, setting, name).standard_normal((setting.steps, 3, len(sigma))) for name in setting.names]
    return torch.from_numpy(np.stack(drawn, axis=1) * np.array(sigma))


def _adding(noise: Float[Tensor, "T G 3 F"]) -> Filter:
    return lambda step, value: value + noise[step].to(value.dtype)


def _dropping(spec: Dropout, setting: Setting) -> Filter:
    """Holds the last state that was seen; the first one always is."""
    lost = [_rng(spec.kind, setting, name).random((setting.steps, 3)) < spec.intensity for name in setting.names]
    missing = torch.from_numpy(np.stack(lost, axis=1))[..., None]
    held: list[Tensor] = []

    def drop(step: int, value: Tensor) -> Tensor:
        seen = torch.where(missing[step], held[0], value) if held else value
        held[:] = [seen]
        return seen

    return drop


def _delaying(past: Sequence[Tensor], steps: int) -> Filter:
    """What came `steps` ago; before the first step came `past`, whose first value lasts for ever."""
    earlier = [*past[:1]] * max(steps - len(past), 0)
    waiting = deque([*earlier, *past[max(len(past) - steps, 0) :]])

    def delay(step: int, value: Tensor) -> Tensor:
        waiting.append(value)
        return waiting.popleft().to(value.dtype)

    return delay
