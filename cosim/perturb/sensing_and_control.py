"""Perturbed sensors and actuators of one round: noise, dropout and latency of what a policy observes, noise and delay
of its actions, and the friction of the road.

All random numbers are drawn in advance, from the scenario's seed and the names of the group, so that all policies meet
the same noise. Every channel remembers what went in and what came out, from which its effect is measured.
"""

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from zlib import crc32

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from cosim.perturb.effects import Effect, delay_between
from cosim.perturb.state_predictor import StatePredictor
from cosim.perturb.traffic_demand import GRAVITY
from cosim.spec.perturbations import (
    ActionDelay,
    ActionNoise,
    Dropout,
    LocalizationLatency,
    LowFriction,
    ObservationNoise,
    PerceptionLatency,
    Perturbation,
)
from cosim.spec.scenario import USUAL_SIZE
from gri.core.dynamics import Dynamics

States = Float[Tensor, "G N D"]
Filter = Callable[[Sequence[Tensor]], Tensor]
"""All values so far, the present one last -> what comes out at present."""
Measure = Callable[[np.ndarray, np.ndarray], list[Effect]]
"""What went into a filter and what came out for one group, of shape (T, views, N, features) -> its effects."""
OWN = ("a", "yaw_rate")  # features that a driver feels, or has commanded itself
MIN_SPEED = 0.1  # [m/s]; slower vehicles have no lateral acceleration


@dataclass(frozen=True)
class RoundSetting:
    """What the channels depend on in a round.

    `names` identify its groups of `size` vehicles, `driven_roles` are the roles that the policy drives, `steps` is the
    largest number of observations, those of the history included, `dt` [s] is the length of a step. `curvature` gives
    the curvature of the road [1/m] at the place of each vehicle. A policy that `predicts` knows the latencies.
    """

    dynamics: Dynamics
    dt: float
    steps: int
    seed: int
    names: tuple[str, ...]
    driven_roles: tuple[int, ...]
    curvature: Callable[[States], Float[Tensor, "G N"]]
    size: int = USUAL_SIZE
    predicts: bool = False


@dataclass(frozen=True)
class Stage:
    """One perturbation of a channel: its filter, and how its effect is measured."""

    apply: Filter
    measure: Measure


@dataclass(frozen=True)
class Channel:
    """Stages in a row. `values` are the inputs of each stage so far, in order of time, and the last outputs."""

    stages: tuple[Stage, ...] = ()
    values: tuple[list[Tensor], ...] = ()

    @classmethod
    def of(cls, stages: Sequence[Stage]) -> "Channel":
        """A channel through which nothing has gone yet."""
        return cls(tuple(stages), tuple([] for _ in range(len(stages) + 1)))

    def send(self, value: Tensor) -> Tensor:
        """What comes out when `value` goes in, one step after the last call."""
        for stage, seen in zip(self.stages, self.values, strict=False):
            seen.append(value)
            value = stage.apply(seen)
        if self.stages:
            self.values[-1].append(value)
        return value

    def preview(self, value: Tensor) -> Tensor:
        """What `send` would return; the value is not sent."""
        for stage, seen in zip(self.stages, self.values, strict=False):
            value = stage.apply([*seen, value])
        return value

    def effects(self, group: int) -> list[Effect]:
        """The effects that the stages have had on a group."""
        found: list[Effect] = []
        for k, stage in enumerate(self.stages):
            before, after = (torch.stack(self.values[side])[..., group, :, :].numpy() for side in (k, k + 1))
            found += stage.measure(before.astype(float), after.astype(float))
        return found


@dataclass(frozen=True)
class Road:
    """The friction of the road: no total acceleration above `limit` [m/s²].

    `demanded` and `possible` have the greatest total acceleration of each vehicle before and after the cut, step by
    step.
    """

    spec: LowFriction
    limit: float
    curvature: Callable[[States], Float[Tensor, "G N"]]
    demanded: list[Float[Tensor, "G N"]] = field(default_factory=list)
    possible: list[Float[Tensor, "G N"]] = field(default_factory=list)

    def cut(self, state: States, dynamics: Dynamics) -> States:
        """The state with a total acceleration inside the friction circle.

        The lateral acceleration is v·(ω + v·κ), with the yaw rate ω relative to the road and the road's curvature κ.
        Both accelerations are reduced by one factor. Without a yaw rate (1-D) only the one along the road can be.
        """
        bounded, a, v = state.clone(), state[..., dynamics.index("a")], state[..., dynamics.speed]
        bend = v.square() * self.curvature(state)
        if "yaw_rate" in dynamics.state:
            yaw = dynamics.index("yaw_rate")
            lateral = v * state[..., yaw] + bend
            factor = (self.limit / torch.hypot(a, lateral).clamp(min=1e-9)).clamp(max=1.0)
            bounded[..., dynamics.index("a")] = a * factor
            turned = (lateral * factor - bend) / v.clamp(min=MIN_SPEED)
            cut = (factor < 1) & (v > MIN_SPEED)
            bounded[..., yaw] = torch.where(cut, turned, state[..., yaw])
            after = torch.hypot(a * factor, lateral * factor)
        else:
            lateral = bend
            left = (self.limit**2 - bend.square()).clamp(min=0.0).sqrt()
            bounded[..., dynamics.index("a")] = torch.minimum(torch.maximum(a, -left), left)
            after = torch.hypot(bounded[..., dynamics.index("a")], lateral)
        self.demanded.append(torch.hypot(a, lateral))
        self.possible.append(after)
        return bounded

    def effects(self, group: int, driven_roles: Sequence[int], steps: int) -> list[Effect]:
        """The greatest total acceleration of the driven vehicles in the first `steps` steps."""
        roles, now = list(driven_roles), slice(0, steps)
        demanded, possible = (
            float(torch.stack(values[now])[:, group, roles].max()) for values in (self.demanded, self.possible)
        )
        quantity = "greatest acceleration when driven"
        return [Effect(self.spec.kind, self.spec.intensity, quantity, "m/s²", self.limit, possible, demanded)]


@dataclass(frozen=True)
class SensingAndControl:
    """The channels between the world and a policy; without stages and road they change nothing.

    Each of the `views` is what one driven vehicle, or all of them together (a single view), observe of the group.
    `known[view, role, feature]` is known without observing it. `view_of[role]` is the view by which a role is driven.
    A `predictor` makes up for late and lost states; `clock` shows at which step they were true.
    """

    dynamics: Dynamics
    observation: Channel = field(default_factory=Channel)
    clock: Channel = field(default_factory=Channel)
    action: Channel = field(default_factory=Channel)
    known: Bool[Tensor, "E N D"] | None = None
    view_of: tuple[int, ...] = (0,) * USUAL_SIZE
    driven_roles: tuple[int, ...] = ()
    road: Road | None = None
    predictor: StatePredictor | None = None

    @property
    def views(self) -> int:
        """The number of views."""
        return max(self.view_of) + 1

    @property
    def changes_nothing(self) -> bool:
        """Whether sensors and actuators are perfect and the road is not slippery; there is one view then."""
        return self.views == 1 and not self.observation.stages and not self.action.stages and self.road is None

    def observed(self, state: States, *, final: bool = True) -> Float[Tensor, "E G N D"]:
        """What each view shows of the state; with `final=False` only what it would show."""
        views = state.expand(self.views, *state.shape)
        shown = views
        if self.observation.stages:
            shown = self.observation.send(views) if final else self.observation.preview(views)
            if self.known is not None:
                shown = torch.where(self.known[:, None], views, shown)
        if self.predictor is None:
            return shown
        now = len(self.predictor.felt)
        times = torch.full((*views.shape[:-1], 1), now)
        seen = self.clock.send(times) if final else self.clock.preview(times)
        return self.predictor.predicted(shown, (now - seen)[..., 0], final=final)

    def executed_action(self, action: Float[Tensor, "G N A"]) -> Float[Tensor, "G N A"]:
        """The action that the vehicle executes."""
        return self.action.send(action[None])[0] if self.action.stages else action

    def feasible_state(self, state: States) -> States:
        """The next state with an acceleration that the road surface allows."""
        return state if self.road is None else self.road.cut(state, self.dynamics)

    def effects(self, group: int, steps: int) -> list[Effect]:
        """What the perturbations of sensors, actuators and friction did to a group in its first `steps` steps."""
        found = [*self.observation.effects(group), *self.action.effects(group)]
        return found if self.road is None else found + self.road.effects(group, self.driven_roles, steps)


def sensing_and_control(perturbations: Sequence[Perturbation], setting: RoundSetting) -> SensingAndControl:
    """The channels under these perturbations; other kinds of perturbations change nothing here."""
    own_views = any(isinstance(spec, PerceptionLatency | LocalizationLatency) for spec in perturbations)
    views = tuple((role,) for role in setting.driven_roles) if own_views else (setting.driven_roles,)
    own = torch.tensor([[role in roles for role in range(setting.size)] for roles in views])
    observation: list[Stage] = []
    clock: list[Stage] = []  # the stages of `observation` that show older states
    action: list[Stage] = []
    frictions: list[LowFriction] = []
    for spec in perturbations:
        match spec:
            case ObservationNoise():
                observation.append(_observation_noise(spec, setting))
            case Dropout():
                observation.append(_dropout(spec, setting))
                clock.append(observation[-1])
            case PerceptionLatency() | LocalizationLatency():
                late = own if isinstance(spec, LocalizationLatency) else ~own
                observation.append(_latency(spec, setting, late, partial(_straight_on_before, setting)))
                clock.append(_latency(spec, setting, late, operator.sub))
            case ActionNoise():
                action.append(_action_noise(spec, setting))
            case ActionDelay():
                action.append(_action_delay(spec, setting))
            case LowFriction():
                frictions.append(spec)
    executed = Channel.of(action)
    delay = sum(delay_steps(spec.intensity, setting.dt) for spec in perturbations if isinstance(spec, ActionDelay))
    predictor = StatePredictor(setting.dynamics, setting.dt, own, delay, executed.values[0])
    slippery = min(frictions, key=lambda spec: spec.intensity, default=None)
    feels = torch.tensor([name in OWN for name in setting.dynamics.state])
    return SensingAndControl(
        dynamics=setting.dynamics,
        observation=Channel.of(observation),
        clock=Channel.of(clock),
        action=executed,
        known=own[..., None] & feels,
        view_of=tuple(next((k for k, roles in enumerate(views) if role in roles), 0) for role in range(setting.size)),
        driven_roles=setting.driven_roles,
        road=None if slippery is None else Road(slippery, slippery.intensity * GRAVITY, setting.curvature),
        predictor=predictor if setting.predicts and (clock or delay) else None,
    )


def delay_steps(seconds: float, dt: float) -> int:
    """A delay [s] in steps of `dt` [s], rounded."""
    return round(seconds / dt)


def _rng(kind: str, setting: RoundSetting, group: str) -> np.random.Generator:
    return np.random.default_rng([setting.seed, crc32(group.encode()), crc32(kind.encode())])


def _noise(kind: str, setting: RoundSetting, sigma: Sequence[float]) -> Float[Tensor, "T G N F"]:
    """White noise with these standard deviations for every step, group and vehicle."""
    drawn = [
        _rng(kind, setting, name).standard_normal((setting.steps, setting.size, len(sigma))) for name in setting.names
    ]
    return torch.from_numpy(np.stack(drawn, axis=1) * np.array(sigma))


def _observation_noise(spec: ObservationNoise, setting: RoundSetting) -> Stage:
    """White noise on positions and speeds, the same in all views."""
    scale = {"x": 1.0, "y": spec.across, "v": spec.speed}
    sigma = [spec.intensity * scale.get(name, 0.0) for name in setting.dynamics.state]
    noise = _noise(spec.kind, setting, sigma)
    names = {"x": ("error along the road", "m"), "y": ("error across the road", "m"), "v": ("error of speed", "m/s")}

    def measure(given: np.ndarray, shown: np.ndarray) -> list[Effect]:
        error = np.sqrt(np.mean((shown - given) ** 2, axis=(0, 1, 2)))
        return [
            Effect(spec.kind, spec.intensity, *names[name], stated=sigma[k], measured=float(error[k]), unperturbed=0.0)
            for k, name in enumerate(setting.dynamics.state)
            if name in names
        ]

    return Stage(lambda seen: seen[-1] + noise[len(seen) - 1].to(seen[-1].dtype), measure)


def _dropout(spec: Dropout, setting: RoundSetting) -> Stage:
    """Lose states at random and show the last one received; the first state is always received."""
    lost = [
        _rng(spec.kind, setting, name).random((setting.steps, setting.size)) < spec.intensity for name in setting.names
    ]
    step = np.arange(setting.steps)[:, None, None]
    received = np.maximum.accumulate(np.where(np.stack(lost, axis=1) & (step > 0), 0, step), axis=0)
    latest = torch.from_numpy(received)  # step of the last received state, of shape (T, G, N)

    def hold(seen: Sequence[Tensor]) -> Tensor:
        at = latest[len(seen) - 1]
        value = seen[-1]
        for step in at.unique().tolist():
            value = torch.where((at == step)[..., None], seen[step], value)
        return value

    def measure(given: np.ndarray, shown: np.ndarray) -> list[Effect]:
        missing = float((given != shown).any(-1)[1:].mean()) if len(given) > 1 else np.nan
        return [Effect(spec.kind, spec.intensity, "share of missing states", "", spec.intensity, missing, 0.0)]

    return Stage(hold, measure)


def _latency(
    spec: PerceptionLatency | LocalizationLatency,
    setting: RoundSetting,
    late: Bool[Tensor, "E N"],
    before: Callable[[Tensor, int], Tensor],
) -> Stage:
    """Show the vehicles that are `late` in a view as they were some steps ago.

    `before` gives what a first value was so many steps before the first observation.
    """
    steps = delay_steps(spec.intensity, setting.dt)

    def delay(seen: Sequence[Tensor]) -> Tensor:
        past = seen[-1 - steps] if len(seen) > steps else before(seen[0], steps - len(seen) + 1)
        return torch.where(late[:, None, :, None], past, seen[-1])

    def measure(given: np.ndarray, shown: np.ndarray) -> list[Effect]:
        rows = late.numpy()
        found = delay_between(given[:, rows], shown[:, rows]) if rows.any() else 0
        return [_delay_effect(spec, found * setting.dt)]

    return Stage(delay, measure)


def _straight_on_before(setting: RoundSetting, first: Float[Tensor, "E G N D"], steps: int) -> Float[Tensor, "E G N D"]:
    """The states so many steps before the first ones, of vehicles that drove straight on at their first speed."""
    past, dynamics, earlier = first.clone(), setting.dynamics, steps * setting.dt
    v, planar = past[..., dynamics.speed], "heading" in dynamics.state
    heading = past[..., dynamics.index("heading")] if planar else torch.zeros_like(v)
    past[..., dynamics.index("x")] -= earlier * v * heading.cos()
    if planar:
        past[..., dynamics.index("y")] -= earlier * v * heading.sin()
    return past


def _delay_effect(spec: PerceptionLatency | LocalizationLatency | ActionDelay, measured: float) -> Effect:
    return Effect(spec.kind, spec.intensity, "delay", "s", spec.intensity, measured, 0.0)


def _action_noise(spec: ActionNoise, setting: RoundSetting) -> Stage:
    scale = {"jerk": 1.0, "yaw_acceleration": spec.yaw}
    sigma = [spec.intensity * scale[name] for name in setting.dynamics.action]
    noise = _noise(spec.kind, setting, sigma)
    units = {"jerk": ("error of jerk", "m/s³"), "yaw_acceleration": ("error of yaw acceleration", "rad/s²")}

    def measure(given: np.ndarray, executed: np.ndarray) -> list[Effect]:
        error = np.sqrt(np.mean((executed - given) ** 2, axis=(0, 1, 2)))
        return [
            Effect(spec.kind, spec.intensity, *units[name], stated=sigma[k], measured=float(error[k]), unperturbed=0.0)
            for k, name in enumerate(setting.dynamics.action)
        ]

    return Stage(lambda seen: seen[-1] + noise[len(seen) - 1].to(seen[-1].dtype), measure)


def _action_delay(spec: ActionDelay, setting: RoundSetting) -> Stage:
    """Execute the action of some steps ago, and none before the first one."""
    steps = delay_steps(spec.intensity, setting.dt)
    roles = list(setting.driven_roles)

    def measure(given: np.ndarray, executed: np.ndarray) -> list[Effect]:
        found = delay_between(given[:, :, roles], executed[:, :, roles])
        return [_delay_effect(spec, found * setting.dt)]

    return Stage(lambda seen: seen[-1 - steps] if len(seen) > steps else torch.zeros_like(seen[0]), measure)
