"""Rows of vehicles in which it is drawn who reacts to whom: what "follow" means, with everything else left open.

An edge k → j of type "follow" says one thing about vehicle j: its acceleration is bounded by a reaction to vehicle k
that grows with the gap and with k's speed. How strong, how late and in which form it reacts is a latent of each driver
with a broad prior (`ReactionPrior`). A vehicle without an edge keeps a wished speed of its own, or reacts in the same
way to a leader that is not observed. So the null is fair: unobserved leaders make vehicles move like followers.

`draw_reactions` draws from this model, and `gri.training.relations` teaches the encoder to invert it. That is the
posterior over graphs with all latents integrated out, without one constant of an expert.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import msgspec
import torch
from jaxtyping import Float, Int
from torch import Tensor

OWN, UNSEEN = -1, -2
LEAST_GAP = 0.5  # [m]
SUBSTEPS = 2  # steps of the simulation per step of the scene
LENGTH = 5.0  # [m]

Span = tuple[float, float]


class ReactionPrior(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What drivers, starts and noise are drawn from. Spans are log-uniform, except where a field says uniform."""

    vehicles: int = 5
    speed: Span = (0.0, 38.0)
    """First speed of a scene [m/s], uniform."""
    headway: Span = (5.0, 600.0)
    """First headways, front to front [m]."""
    time_gap: Span = (0.5, 2.8)
    """[s]"""
    standstill: Span = (1.0, 7.0)
    """Gap at rest [m]."""
    gap_gain: Span = (0.02, 0.5)
    """Acceleration per metre of gap [1/s²]."""
    speed_gain: Span = (0.05, 1.2)
    """Acceleration per speed difference [1/s]."""
    own_gain: Span = (0.03, 0.8)
    """Acceleration per difference from the wished speed [1/s]."""
    acceleration: Span = (0.6, 3.0)
    """Largest one [m/s²]."""
    deceleration: Span = (1.2, 5.0)
    """Comfortable one [m/s²]."""
    delay: Span = (0.0, 1.0)
    """Of the reaction [s], uniform."""
    lag: Span = (0.0, 0.7)
    """Time constant of the actuator [s], uniform."""
    action_noise: Span = (0.005, 0.6)
    """[m/s²]"""
    perception_noise: Span = (0.001, 0.06)
    """Of the gap, relative."""
    quiet: Span = (0.02, 1.0)
    """Factor on all noise of 0.6 of the scenes, so that some scenes are quiet as a whole."""
    reach: Span = (50.0, 250.0)
    """Largest first headway over which a driver reacts [m]."""
    follows: float = 0.65
    """Probability that a vehicle with others ahead reacts to one of them."""
    next_ahead: float = 0.6
    """Probability that this one is the next ahead; else any of those ahead."""
    settle: tuple[float, ...] = (0.0, 0.0, 2.0, 6.0, 20.0)
    """Seconds from the start of the simulation to the start of a scene: some traffic has settled, some has not."""
    unseen: float = 0.5
    """Probability that a vehicle without an edge reacts to a leader that is not observed."""


@dataclass(frozen=True)
class Reactions:
    """Scenes with drawn relations; vehicle N−1 is the foremost."""

    x: Float[Tensor, "S N T"]
    """Front bumpers [m]."""
    v: Float[Tensor, "S N T"]
    """[m/s]"""
    leader: Int[Tensor, "S N"]
    """The vehicle that each vehicle reacts to, or `OWN`, or `UNSEEN`."""

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, rows: Tensor | slice) -> "Reactions":
        return Reactions(self.x[rows], self.v[rows], self.leader[rows])


def draw_reactions(prior: ReactionPrior, count: int, steps: int, dt: float, generator: torch.Generator) -> Reactions:
    """`count` scenes of `steps` states, less those in which vehicles touch."""
    count //= len(prior.settle)
    return joined([_simulate(prior, count, steps, dt, settle, generator) for settle in prior.settle])


def joined(parts: Sequence[Reactions]) -> Reactions:
    """All scenes of the parts, which have the same N and T."""
    return Reactions(*(torch.cat([getattr(part, name) for part in parts]) for name in ("x", "v", "leader")))


def _simulate(
    prior: ReactionPrior, count: int, steps: int, dt: float, settle: float, generator: torch.Generator
) -> Reactions:
    n, step = prior.vehicles, dt / SUBSTEPS
    shape = (count, n)

    def draw(span: Span, size: tuple[int, ...] = shape) -> Tensor:
        return log_uniform(span, size, generator)

    def uniform(span: Span, size: tuple[int, ...] = shape) -> Tensor:
        return span[0] + (span[1] - span[0]) * torch.rand(size, generator=generator)

    def chance(p: float, size: tuple[int, ...] = shape) -> Tensor:
        return torch.rand(size, generator=generator) < p

    settling = int(settle / step)
    total = settling + (steps - 1) * SUBSTEPS + 1
    speed = uniform(prior.speed, (count, 1))
    v = (speed + torch.randn(shape, generator=generator) * uniform((0.0, 2.0), (count, 1))).clamp(min=0)
    driver = Drivers(
        own_gain=draw(prior.own_gain),
        gap_gain=draw(prior.gap_gain),
        speed_gain=draw(prior.speed_gain),
        time_gap=draw(prior.time_gap),
        standstill=draw(prior.standstill),
        acceleration=draw(prior.acceleration),
        deceleration=draw(prior.deceleration),
        form=torch.randint(len(FORMS), shape, generator=generator),
        saturating=chance(0.5),
    )
    # Half of the scenes begin with headways that suit the speeds, the others with any.
    suited = driver.standstill + driver.time_gap * v + LENGTH
    suited = suited * (0.35 * torch.randn(shape, generator=generator)).exp()
    headway = torch.where(chance(0.5, (count, 1)), draw(prior.headway), suited).clamp(min=LENGTH + 1.0)
    x = torch.cat([torch.zeros(count, 1), headway[:, 1:].cumsum(1)], 1)
    leader = _leaders(prior, count, generator)
    away = x.gather(1, leader.clamp(min=0)) - x
    leader = torch.where((leader >= 0) & (away > draw(prior.reach)), OWN, leader)
    # Wished speeds: near the present speed, somewhat above it, or anywhere above it.
    surplus = torch.where(chance(0.6), uniform((-2.0, 8.0)), 0.5 * torch.randn(shape, generator=generator))
    above = v + (prior.speed[1] - v).clamp(min=1.0) * uniform((0.0, 1.0))
    wished = torch.where(chance(0.4), above, (v + surplus).clamp(min=1.0))
    unseen_headway = torch.where(chance(0.5), draw(prior.headway), suited)
    delay = (uniform(prior.delay) / step).round().long() * chance(0.8)
    keep = torch.exp(-step / uniform(prior.lag).clamp(min=1e-3)) * chance(0.7)
    quiet = torch.where(chance(0.6, (count, 1)), draw(prior.quiet, (count, 1)), torch.ones(count, 1))
    act = Wander(quiet * draw(prior.action_noise), uniform((0.2, 3.0)), step, generator)
    wish = Wander(quiet * uniform((0.0, 1.8)) * chance(0.8), uniform((2.0, 20.0)), step, generator)
    see = Wander(quiet * draw(prior.perception_noise) * chance(0.6), uniform((0.5, 4.0)), step, generator)
    outside = Outside(x + unseen_headway, v, prior.speed[1] + 4.0, uniform((0.2, 2.5)), step, generator)
    everybody = torch.arange(n)
    rows = torch.where(leader >= 0, leader, torch.where(leader == UNSEEN, n + everybody, everybody))
    scene, most = torch.arange(count)[:, None], int(delay.max()) + 1
    past = torch.zeros(most, 2, count, 2 * n)
    a, frames = torch.zeros(shape), []
    for k in range(total):
        past[k % most, 0] = torch.cat([x, outside.x], 1)
        past[k % most, 1] = torch.cat([v, outside.v], 1)
        if k >= settling and (k - settling) % SUBSTEPS == 0:
            frames.append(torch.stack([x, v], -1))
        late = (k - delay.clamp(max=k)) % most
        gap = (past[late, 0, scene, rows] - past[late, 0, scene, everybody] - LENGTH) * (1 + see())
        target = driver.acceleration_wanted(
            v, gap, past[late, 1, scene, rows] + 5 * see.value, wished + wish(), leader == OWN
        )
        a = keep * a + (1 - keep) * target.clamp(-8.0, 4.0)
        faster = (v + (a + act()) * step).clamp(min=0)
        x, v = x + (v + faster) / 2 * step, faster
        outside.advance()
    states = torch.stack(frames, 2)
    apart = (states[:, 1:, :, 0] - states[:, :-1, :, 0] > LENGTH + 0.3).all(-1).all(-1)
    states, leader = states[apart], leader[apart]
    return Reactions(states[..., 0], states[..., 1], leader)


def log_uniform(span: Span, size: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Random values of this shape, whose logarithms are uniform."""
    low, high = torch.tensor(span).log().tolist()
    return (low + (high - low) * torch.rand(size, generator=generator)).exp()


def _leaders(prior: ReactionPrior, count: int, generator: torch.Generator) -> Int[Tensor, "S N"]:
    """Whom each vehicle reacts to, independent of positions beyond their order."""
    n = prior.vehicles
    ahead = torch.arange(n - 1, -1, -1)
    draws = torch.rand((4, count, n), generator=generator)
    other = torch.arange(n) + 1 + (draws[0] * ahead).long().clamp(max=(ahead - 1).clamp(min=0))
    chosen = torch.where(draws[1] < prior.next_ahead, torch.arange(n) + 1, other)
    nobody = torch.where(draws[2] < prior.unseen, UNSEEN, OWN)
    return torch.where((draws[3] < prior.follows) & (ahead > 0), chosen, nobody)


@dataclass(frozen=True)
class Drivers:
    """Latents of S × N drivers."""

    own_gain: Tensor
    gap_gain: Tensor
    speed_gain: Tensor
    time_gap: Tensor
    standstill: Tensor
    acceleration: Tensor
    deceleration: Tensor
    form: Tensor
    """Index into `FORMS`."""
    saturating: Tensor
    """Whether the wish for an own speed fades only near that speed; else it is linear in the difference."""

    def acceleration_wanted(self, v: Tensor, gap: Tensor, leader: Tensor, wished: Tensor, alone: Tensor) -> Tensor:
        """[m/s²], by the gap [m] and the speeds [m/s]."""
        linear = (self.own_gain * (wished - v)).clamp(max=self.acceleration)
        late = self.acceleration * (1 - (v / wished.clamp(min=1.0)) ** (1 + 6 * self.own_gain)).clamp(min=-3.0)
        scene = Situation(v, gap.clamp(min=LEAST_GAP), leader, wished, torch.where(self.saturating, late, linear))
        reacting = torch.stack([form(self, scene) for form in FORMS], -1).gather(-1, self.form[..., None])[..., 0]
        return torch.where(alone, scene.own, reacting)


class Situation(NamedTuple):
    """What drivers decide by: speeds [m/s], the gap [m], and their wish for an own speed as acceleration [m/s²]."""

    v: Tensor
    gap: Tensor
    leader: Tensor
    wished: Tensor
    own: Tensor


def _to_the_gap(d: Drivers, s: Situation) -> Tensor:
    return (d.gap_gain * (s.gap - d.standstill - d.time_gap * s.v)).clamp(max=1.5)


def _linear(d: Drivers, s: Situation) -> Tensor:
    """Linear in the gap and the speed difference; the lower of that and the own wish."""
    return torch.minimum(s.own, _to_the_gap(d, s) + d.speed_gain * (s.leader - s.v))


def _added(d: Drivers, s: Situation) -> Tensor:
    """Linear in the gap and the speed difference, added to the own wish."""
    return s.own.clamp(min=-2.0) / 2 + _to_the_gap(d, s) + d.speed_gain * (s.leader - s.v)


def _wanted_ratio(d: Drivers, s: Situation) -> Tensor:
    """The wanted gap, which grows with the speed of approach, over the gap."""
    approach = s.v * (s.v - s.leader) / (2 * (d.acceleration * d.deceleration).sqrt())
    return ((d.standstill + (d.time_gap * s.v + approach).clamp(min=0)) / s.gap).clamp(max=6.0)


def _ratio(d: Drivers, s: Situation) -> Tensor:
    """By a power of the ratio of the wanted gap and the gap; the lower of that and the own wish."""
    return torch.minimum(s.own, d.acceleration * (1 - _wanted_ratio(d, s) ** (1.0 + 3.0 * d.own_gain)))


def _subtracted(d: Drivers, s: Situation) -> Tensor:
    """The same power, subtracted from the own wish."""
    return s.own - d.acceleration * _wanted_ratio(d, s) ** (1.5 + 2.0 * d.gap_gain)


def _speed_of_gap(d: Drivers, s: Situation) -> Tensor:
    """Adapts to a speed that is a function of the gap, and to the leader's speed; some ignore the latter."""
    reach = d.standstill + d.time_gap * 10
    smooth = s.wished * ((s.gap / reach - 1.5).tanh() + 0.905) / 1.905
    straight = torch.minimum(s.wished, (s.gap - d.standstill) / d.time_gap).clamp(min=0)
    target = torch.where(d.saturating, smooth, straight)
    gain = torch.where(d.speed_gain < 0.12, 0.0, d.speed_gain)
    return (0.1 + d.own_gain) * (target - s.v) + gain * (s.leader - s.v) / (1 + s.gap / 100)


def _safe_speed(d: Drivers, s: Situation) -> Tensor:
    """The speed from which it can still stop behind the leader; the lower of the way there and the own wish."""
    tau = d.time_gap
    room = (s.gap - d.standstill).clamp(min=-20.0)
    inside = (d.deceleration * tau) ** 2 + s.leader.clamp(min=0) ** 2 + 2 * d.deceleration * room
    safe = -d.deceleration * tau + inside.clamp(min=0).sqrt()
    return torch.minimum(s.own, (safe - s.v) / (0.5 + 2 * d.own_gain))


FORMS: tuple[Callable[[Drivers, Situation], Tensor], ...] = (
    _linear,
    _added,
    _ratio,
    _subtracted,
    _speed_of_gap,
    _safe_speed,
)


class Wander:
    """An Ornstein–Uhlenbeck process with given standard deviations and correlation times [s]."""

    def __init__(self, sd: Tensor, time: Tensor, dt: float, generator: torch.Generator) -> None:
        self.keep = torch.exp(-dt / time)
        self.jump = sd * (1 - self.keep**2).sqrt()
        self.generator = generator
        self.value = sd * torch.randn(sd.shape, generator=generator)

    def __call__(self) -> Tensor:
        """The next value."""
        self.value = self.keep * self.value + self.jump * torch.randn(self.jump.shape, generator=self.generator)
        return self.value


class Outside:
    """Leaders that are not observed: phases of constant acceleration, at times to a stop."""

    def __init__(self, x: Tensor, v: Tensor, fastest: float, sd: Tensor, dt: float, generator: torch.Generator) -> None:
        self.x, self.v, self.fastest, self.sd, self.dt, self.generator = x, v, fastest, sd, dt, generator
        self.home = v
        self.a, self.left = torch.zeros_like(v), torch.zeros_like(v)

    def advance(self) -> None:
        """One step on."""
        renew = self.left <= 0
        drawn = self.sd * torch.randn(self.v.shape, generator=self.generator) + 0.1 * (self.home - self.v)
        self.a = torch.where(renew, drawn.clamp(-4.0, 2.5), self.a)
        duration = 0.5 + 5.0 * torch.rand(self.v.shape, generator=self.generator)
        self.left = torch.where(renew, duration, self.left - self.dt)
        faster = (self.v + self.a * self.dt).clamp(min=0, max=self.fastest)
        self.x, self.v = self.x + (self.v + faster) / 2 * self.dt, faster
