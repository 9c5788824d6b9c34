"""Who does each vehicle react to? A posterior in closed form, without labels and without training of a network.

For each receiver j it compares explanations of j's accelerations a_t = (v_{t+1} − v_t)/Δt, one at a time:

- own: a_t = ρ a_{t−1} + c + b₁ (v_t − v_0) + b₂ (v_t − v_0)² + noise. The wished speed is in c and b.
- follow k, for every k ahead of j: the same plus g₁ (gap − 7 − 1.4 v) + g₂ Δv, or plus
  g₃ (1 − ((7 + 1.4 v)/gap)²) + g₄ v Δv/gap, all τ seconds earlier. Both forms are averaged.
- unseen: follow, averaged over leaders of other scenes with nearly the same mean speed, put where each candidate began.
This
  is the fair null in traffic, where everybody moves as if following somebody.

All coefficients have broad Gaussian priors, so that each evidence is a Gaussian integral. It is averaged over a grid of
delays τ, noise levels σ and noise correlations φ. What is *not* assumed: constants of a driver, an equilibrium headway,
or a start in equilibrium. Only vehicles ahead can be followed, and one at a time; this holds by construction.
"""

from dataclasses import dataclass
from math import log, pi

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.edges import pairs
from gri.networks.reaction_evidence import OWN, linear_columns, ratio_columns

MOST_DELAY = 4  # steps; all explanations are judged on the same accelerations, from this step on
LEAST_GAP = 1.0  # [m]
# Means and standard deviations of g₁ [1/s²] and g₂ [1/s], and of g₃ [m/s²] and g₄ [1]; narrower than the encoder's.
LINEAR = ((0.06, 0.06), (0.3, 0.3))
RATIO = ((0.7, 0.6), (0.4, 0.4))


@dataclass(frozen=True)
class Explanations:
    """How well each explanation accounts for each receiver's motion, and how the explanations are weighted."""

    own: Float[Tensor, "S N"]
    """Log evidence [nats]."""
    unseen: Float[Tensor, "S N"]
    follow: Float[Tensor, "S N N"]
    """[scene, receiver, leader]; −inf for leaders that are not ahead."""

    def posterior(self, weights: "Weights") -> Float[Tensor, "S N N"]:
        """P(receiver reacts to leader)."""
        return self._shares(weights)[..., 2:]

    def _shares(self, weights: "Weights") -> Float[Tensor, "S N 2+N"]:
        candidates = torch.isfinite(self.follow).sum(-1, keepdim=True)
        scores = [self.own + log(weights.own), self.unseen + log(weights.unseen)]
        follow = self.follow + log(weights.follow) - candidates.clamp(min=1).log()
        scores = torch.cat([torch.stack(scores, -1), follow], -1)
        return scores.softmax(-1)

    def weights(self, rounds: int = 50) -> "Weights":
        """How often each kind of explanation holds in these scenes, by expectation maximisation; needs no labels."""
        found = Weights()
        has_choice = torch.isfinite(self.follow).any(-1)
        for _ in range(rounds):
            shares = self._shares(found)[has_choice]
            own, unseen = float(shares[:, 0].mean()), float(shares[:, 1].mean())
            found = Weights(*(max(w, 0.02) for w in (own, unseen, 1 - own - unseen)))
        return found


@dataclass(frozen=True)
class Weights:
    """Prior probability of each kind of explanation, for a receiver that has somebody ahead."""

    own: float = 0.25
    unseen: float = 0.25
    follow: float = 0.5


@dataclass(frozen=True)
class Grid:
    """What the evidence is averaged over."""

    delays: tuple[int, ...] = (0, 1, 2, 4)
    """Steps."""
    noise: tuple[float, ...] = (0.01, 0.03, 0.1, 0.3)
    """[m/s²]"""
    correlation: tuple[float, ...] = (0.0, 0.5, 0.9)


def explain(
    x: Float[Tensor, "S N T"],
    v: Float[Tensor, "S N T"],
    dt: float,
    lengths: float = 5.0,
    others: int = 12,
    grid: Grid = Grid(),
    seed: int = 0,
) -> Explanations:
    """Log evidences of all explanations of all vehicles' motion.

    Args:
        x: positions of the front bumpers [m]; v: speeds [m/s]; sampled every `dt` seconds, at least 10 times.
        lengths: of the vehicles [m].
        others: leaders of other scenes that "unseen" is averaged over.
        seed: of the choice among leaders of other scenes.

    Raises:
        ValueError: numbers that are not finite, or too few steps.
    """
    if not (bool(torch.isfinite(x).all()) and bool(torch.isfinite(v).all())):
        raise ValueError(
            "got positions or speeds that are not finite; leave out vehicles that were not seen throughout"
        )
    if x.shape[-1] < MOST_DELAY + 6:
        raise ValueError(f"got {x.shape[-1]} steps, wanted at least {MOST_DELAY + 6}; give a longer history")
    x, v = x.double(), v.double()
    scenes, n, _ = x.shape
    own = _evidence(v, None, None, dt, grid)
    follow = torch.full((scenes, n, n), -torch.inf, dtype=torch.float64)
    unseen = torch.full((scenes, n), -torch.inf, dtype=torch.float64)
    stand_ins = _leaders_of_other_scenes(v, others, seed)
    for j in range(n):
        starts = []
        for k in range(n):
            gap = x[:, k] - x[:, j] - lengths
            ahead = gap[:, 0] > 0
            evidence = _evidence(v[:, j], gap, v[:, k], dt, grid)
            follow[:, j, k] = torch.where(ahead, evidence, torch.tensor(-torch.inf, dtype=torch.float64))
            starts.append(torch.where(ahead, gap[:, 0], torch.inf))
        first = torch.stack(starts, -1).min(-1).values
        first = torch.where(torch.isfinite(first), first, first.new_tensor(30.0))
        drawn = []
        for m in range(others):
            scene, vehicle = stand_ins[:, j, m].unbind(-1)
            leader_x, leader_v = x[scene, vehicle], v[scene, vehicle]
            gap = first[:, None] + (leader_x - leader_x[:, :1]) - (x[:, j] - x[:, j, :1])
            drawn.append(_evidence(v[:, j], gap, leader_v, dt, grid))
        unseen[:, j] = torch.logsumexp(torch.stack(drawn), 0) - log(others)
    return Explanations(own, unseen, follow)


def follow_probabilities(posterior: Float[Tensor, "S N N"]) -> Float[Tensor, "S E"]:
    """P(follow) of all ordered pairs (sender, receiver), in the order of `gri.pairs`."""
    return torch.stack([posterior[:, j, i] for i, j in pairs(posterior.shape[1])], 1)


def _leaders_of_other_scenes(v: Float[Tensor, "S N T"], count: int, seed: int) -> Int[Tensor, "S N M 2"]:
    """For each vehicle, `count` vehicles of other scenes, drawn among the 4·count nearest by mean speed."""
    scenes, n, _ = v.shape
    generator = torch.Generator().manual_seed(seed)
    mean = v.mean(-1).reshape(-1)
    order = mean.argsort()
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order))
    near = min(2 * count, max((len(order) - n) // 2, count))
    offsets = torch.cat([torch.arange(-near, 0), torch.arange(1, near + 1)])
    picked = []
    for _ in range(count):
        offset = offsets[torch.randint(len(offsets), (len(order),), generator=generator)]
        chosen = order[(place + offset) % len(order)]
        same = chosen // n == torch.arange(len(order)) // n
        picked.append(torch.where(same, order[(place - offset) % len(order)], chosen))
    flat = torch.stack(picked, -1).reshape(scenes, n, count)
    return torch.stack([flat // n, flat % n], -1)


def _evidence(
    v: Float[Tensor, "*B T"],
    gap: Float[Tensor, "*B T"] | None,
    leader: Float[Tensor, "*B T"] | None,
    dt: float,
    grid: Grid,
) -> Float[Tensor, "*B"]:
    """Log of the mean evidence over the grid; without a gap that of "own"."""
    a = (v[..., 1:] - v[..., :-1]) / dt
    y, before = a[..., MOST_DELAY:], a[..., MOST_DELAY - 1 : -1]
    now = v[..., MOST_DELAY:-1] - v[..., :1]
    base = [before, torch.ones_like(y), now, now**2]
    if gap is None or leader is None:
        found = [_gaussian(y, torch.stack(base, -1), OWN, grid)]
    else:
        found = []
        for columns, prior in ((linear_columns, LINEAR), (ratio_columns, RATIO)):
            room = gap.clamp(min=LEAST_GAP) if columns is ratio_columns else gap
            for delay in grid.delays:
                late = slice(MOST_DELAY - delay, v.shape[-1] - 1 - delay)
                reaction = columns(room[..., late], v[..., late], leader[..., late])
                found.append(_gaussian(y, torch.stack(base + reaction, -1), OWN + prior, grid))
    stacked = torch.cat(found, 0)
    return torch.logsumexp(stacked, 0) - log(len(stacked))


def _gaussian(
    y: Float[Tensor, "*B T"],
    design: Float[Tensor, "*B T P"],
    prior: tuple[tuple[float, float], ...],
    grid: Grid,
) -> Float[Tensor, "G *B"]:
    """log N(y; X m, σ²R + X S X') for all σ and φ; R is the correlation of an autoregression of the noise with φ.

    The first value of the noise is taken as drawn from the innovations, as all others.
    """
    m, s = (torch.tensor(values, dtype=y.dtype) for values in zip(*prior, strict=True))
    residual, scaled = y - design @ m, design * s  # unit prior after scaling
    found = []
    for phi in grid.correlation:
        r = torch.cat([residual[..., :1], residual[..., 1:] - phi * residual[..., :-1]], -1)
        w = torch.cat([scaled[..., :1, :], scaled[..., 1:, :] - phi * scaled[..., :-1, :]], -2)
        gram, cross, square = w.mT @ w, (w.mT @ r[..., None])[..., 0], (r**2).sum(-1)
        for sigma in grid.noise:
            inner = torch.eye(len(prior), dtype=y.dtype) + gram / sigma**2
            factor = torch.linalg.cholesky(inner)
            half = torch.linalg.solve_triangular(factor, cross[..., None] / sigma**2, upper=False)[..., 0]
            log_det = 2 * factor.diagonal(dim1=-2, dim2=-1).log().sum(-1) + 2 * y.shape[-1] * log(sigma)
            found.append(-0.5 * (square / sigma**2 - (half**2).sum(-1) + log_det + y.shape[-1] * log(2 * pi)))
    return torch.stack(found)
