"""Simulated car-following scenes in which it is known who reacts to whom.

Three things are drawn independently of each other: where vehicles start and how fast they are, who reacts to whom, and
how each driver drives. So neither positions nor speeds of one instant say anything about the graph beyond who is ahead.

Every vehicle j reacts to at most one vehicle: to one of those ahead of it in the scene, or to a leader that is not in
the scene ("unseen"), or to nobody ("own": it keeps a wished speed of its own, which wanders). Both of the latter mean
that no edge enters j.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.bench.driver_models import FREE, DriverModel
from gri.core.edges import pairs
from gri.core.scenes import Scenes

DT = 0.2  # [s] between two states of a scene
LENGTH = 5.0  # [m] of every vehicle
WINDOW = 31  # states of 6 s that rows may see
OWN, UNSEEN = -1, -2
SUBSTEPS = 2  # simulation steps per step of the scene


@dataclass(frozen=True)
class SceneFamily:
    """What scenes are drawn from. Ranges are uniform unless said otherwise; SI units."""

    name: str
    vehicles: int = 3
    steps: int = 61
    dt: float = DT
    speed: tuple[float, float] = (0.0, 33.0)
    speed_spread: float = 1.0
    """Standard deviation of a vehicle's first speed around the scene's."""
    headway: tuple[float, float] = (10.0, 155.0)
    """Front to front, log-uniform."""
    wished_surplus: tuple[float, float] = (-1.5, 6.0)
    """Of the wished speed over the first speed; the same for drivers with and without a leader."""
    follows: float = 0.55
    """Probability that a vehicle which has someone ahead of it in the scene reacts to one of them."""
    unseen: float = 0.5
    """Probability that a vehicle without an edge reacts to a leader that is not in the scene."""
    delay: tuple[float, float] = (0.0, 0.8)
    perception_noise: float = 0.03
    """Relative to the gap; the speed difference gets this share of 10 m/s. Correlation time 2 s."""
    action_noise: float = 0.15
    """[m/s²], correlation time 1 s."""
    length: float = LENGTH
    """[m] of every vehicle. The rows are not told; they take `LENGTH`."""


@dataclass(frozen=True)
class KnownScenes:
    """Scenes with their true relations."""

    state: Float[Tensor, "S N T 3"]
    """x [m], v [m/s], a [m/s²]; vehicle N−1 is the foremost."""
    leader: Int[Tensor, "S N"]
    """The vehicle that each vehicle reacts to; `OWN` or `UNSEEN` where it is none of the scene."""
    acceptance: float
    """Share of the drawn scenes without a collision or overlap; the others were thrown away."""
    shown: int = WINDOW
    """How many of the first states rows may see."""

    def __len__(self) -> int:
        return len(self.state)

    def __getitem__(self, scenes: slice) -> "KnownScenes":
        """The selected scenes."""
        return KnownScenes(self.state[scenes], self.leader[scenes], self.acceptance, self.shown)

    def graph(self) -> Int[Tensor, "S E"]:
        """Type indices of all ordered pairs (sender, receiver): 1 where the receiver follows the sender."""
        n = self.state.shape[1]
        return torch.stack([(self.leader[:, j] == i).long() for i, j in pairs(n)], 1)

    def scenes(self) -> Scenes:
        """As the scenes that models are evaluated on."""
        action = self.state[:, :-1, 1:, 2:] - self.state[:, :-1, :-1, 2:]
        return Scenes(self.state.float(), action.float(), self.graph())


def draw_scenes(family: SceneFamily, model: DriverModel, count: int, seed: int) -> KnownScenes:
    """Draw `count` scenes without collision; the same seed gives the same scenes."""
    generator = torch.Generator().manual_seed(seed)
    kept: list[tuple[Tensor, Tensor]] = []
    drawn = 0
    while sum(len(state) for state, _ in kept) < count:
        state, leader = _simulate(family, model, max(count, 64), generator)
        fine = is_free_of_contact(state, family.length)
        drawn += len(state)
        kept.append((state[fine], leader[fine]))
    state, leader = (torch.cat(parts) for parts in zip(*kept, strict=True))
    return KnownScenes(state[:count], leader[:count], len(state) / drawn)


def is_free_of_contact(state: Float[Tensor, "S N T 3"], length: float = LENGTH) -> Bool[Tensor, " S"]:
    """Whether all vehicles keep their order and 0.3 m of gap throughout."""
    x = state[..., 0]
    return ((x[:, 1:] - x[:, :-1]) > length + 0.3).all(-1).all(-1)


def uniform(shape: tuple[int, ...], bounds: tuple[float, float], generator: torch.Generator) -> Tensor:
    low, high = bounds
    return low + (high - low) * torch.rand(shape, generator=generator, dtype=torch.float64)


def log_uniform(shape: tuple[int, ...], bounds: tuple[float, float], generator: torch.Generator) -> Tensor:
    low, high = torch.tensor(bounds).log().tolist()
    return torch.exp(uniform(shape, (low, high), generator))


def accelerations(v: Float[Tensor, "*B T"]) -> Float[Tensor, "*B T-1"]:
    """Mean accelerations [m/s²] between the states of a scene."""
    return (v[..., 1:] - v[..., :-1]) / DT


def _draw_leaders(family: SceneFamily, count: int, generator: torch.Generator) -> Int[Tensor, "S N"]:
    """Whom each vehicle reacts to: one of those ahead with equal odds, an unseen leader, or nobody."""
    n = family.vehicles
    follows = torch.rand((count, n), generator=generator) < family.follows
    unseen = torch.rand((count, n), generator=generator) < family.unseen
    choice = torch.rand((count, n), generator=generator)
    ahead = torch.arange(n - 1, -1, -1)  # how many vehicles are ahead of each
    candidate = torch.arange(n) + 1 + (choice * ahead).long().clamp(max=(ahead - 1).clamp(min=0))
    nobody = torch.where(unseen, UNSEEN, OWN)
    return torch.where(follows & (ahead > 0), candidate, nobody)


def wander(shape: tuple[int, ...], steps: int, dt: float, time: float, generator: torch.Generator) -> Tensor:
    """An Ornstein–Uhlenbeck process of unit variance with a correlation time [s]."""
    keep = torch.exp(torch.tensor(-dt / time, dtype=torch.float64))
    value, path = torch.randn(shape, generator=generator, dtype=torch.float64), []
    for _ in range(steps):
        path.append(value)
        value = keep * value + (1 - keep**2).sqrt() * torch.randn(shape, generator=generator, dtype=torch.float64)
    return torch.stack(path)


def unseen_leaders(
    family: SceneFamily, speed: Float[Tensor, "S N"], steps: int, dt: float, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Positions (from their start) and speeds of leaders nobody sees: phases of constant acceleration."""
    shape = tuple(speed.shape)
    v, x = speed + family.speed_spread * torch.randn(shape, generator=generator, dtype=torch.float64), 0.0 * speed
    a, left = torch.zeros_like(speed), torch.zeros_like(speed)
    positions, speeds = [], []
    for _ in range(steps):
        positions.append(x)
        speeds.append(v.clamp(min=0))
        renew = left <= 0
        a = torch.where(renew, uniform(shape, (-2.0, 1.5), generator), a)
        left = torch.where(renew, uniform(shape, (1.0, 5.0), generator), left - dt)
        faster = (v + a * dt).clamp(0.0, family.speed[1] + 5.0)
        x, v = x + (v.clamp(min=0) + faster) / 2 * dt, faster
    return torch.stack(positions), torch.stack(speeds)


def _simulate(
    family: SceneFamily, model: DriverModel, count: int, generator: torch.Generator
) -> tuple[Float[Tensor, "S N T 3"], Int[Tensor, "S N"]]:
    n, dt = family.vehicles, family.dt / SUBSTEPS
    shape, steps = (count, n), (family.steps - 1) * SUBSTEPS + 1
    # Starts, graph and drivers are drawn independently of each other.
    headway = log_uniform(shape, family.headway, generator)
    x = (headway.cumsum(1) - headway[:, :1]).clone()
    v = (
        uniform((count, 1), family.speed, generator)
        + family.speed_spread * torch.randn(shape, generator=generator, dtype=torch.float64)
    ).clamp(min=0)
    leader = _draw_leaders(family, count, generator)
    drivers = model.draw(shape, generator)
    wished = (v + uniform(shape, family.wished_surplus, generator)).clamp(min=1.0)
    delay = (uniform(shape, family.delay, generator) / dt).round().long()
    wished_path = wished + wander(shape, steps, dt, 8.0, generator)
    see_gap = 1 + family.perception_noise * wander(shape, steps, dt, 2.0, generator)
    see_speed = 10 * family.perception_noise * wander(shape, steps, dt, 2.0, generator)
    act = family.action_noise * wander(shape, steps, dt, 1.0, generator)
    unseen_x, unseen_v = unseen_leaders(family, v, steps, dt, generator)
    unseen_x = unseen_x + x + log_uniform(shape, family.headway, generator)

    rows = torch.where(leader >= 0, leader, torch.where(leader == UNSEEN, n + torch.arange(n), torch.arange(n)))
    a = torch.zeros(shape, dtype=torch.float64)
    past_x, past_v = (torch.empty(steps, count, 2 * n, dtype=torch.float64) for _ in range(2))
    scenes, own, frames = torch.arange(count)[:, None], torch.arange(n), []
    for k in range(steps):
        past_x[k], past_v[k] = torch.cat([x, unseen_x[k]], 1), torch.cat([v, unseen_v[k]], 1)
        if k % SUBSTEPS == 0:
            frames.append(torch.stack([x, v, a], -1))
        seen = (k - delay).clamp(min=0)
        distance = past_x[seen, scenes, rows] - past_x[seen, scenes, own] - family.length
        gap = torch.where(leader == OWN, FREE, distance * see_gap[k])
        leader_v = past_v[seen, scenes, rows] + see_speed[k]
        wanted = model.acceleration({**drivers, "v0": wished_path[k].clamp(min=1.0)}, v, gap, leader_v)
        wanted = (wanted + act[k]).clamp(-8.0, 3.0)
        faster = (v + wanted * dt).clamp(min=0)
        a = (faster - v) / dt
        x, v = x + (v + faster) / 2 * dt, faster
    return torch.stack(frames, 2), leader
