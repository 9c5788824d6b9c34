"""An encoder that compares explanations of each vehicle's motion: whom it reacts to, an unseen leader, or nobody.

The paper's encoder (`gri.networks.encoder`) judges each ordered pair alone and may answer anything. This one has the
structure of the answer built in, in training and at inference:

    e_jk = f(series of the pair, statistics of the pair)          for every vehicle k ahead of vehicle j
    c_j  = (mean of e_jk over k, largest e_jk over k)
    q(j reacts to k | τ) = softmax over {own speed, unseen leader, every k} of (g_null(c_j), g_follow(e_jk, c_j))

A vehicle follows at most one other vehicle, and only one that is ahead. The pair's series are the gap, both speeds and
both accelerations, on the scale of drivers and on the scale of their own variation. The statistics say how much
better j's accelerations are explained by what j would see of k (`gri.networks.reaction_evidence`). Nothing depends on
the number of vehicles.

An encoder that learns from few recordings reads less, and has several members, whose log probabilities are averaged.
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import msgspec
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from gri.core.edges import pairs
from gri.networks import fast_reaction_evidence
from gri.networks.reaction_evidence import DELAYS, EVIDENCES, reaction_evidence

LENGTH = 5.0  # [m] of every vehicle
LEAST_GAP = 0.5  # [m]
NEVER = -30.0  # logit
SERIES, STATISTICS = 18, EVIDENCES + 3  # channels
PLAIN = 8  # the first channels of the series, on the scale of drivers


class PairEncoderConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Size of the encoder."""

    hidden: int = 48
    """Units per hidden layer."""
    kernel: int = 5
    """Width of the convolutions [time steps]."""
    heads: int = 4
    """Number of attention heads that pool over time."""
    reads: Literal["everything", "motion"] = "everything"
    """"motion": only the series on the scale of drivers, no statistics."""
    members: int = 1
    """Networks of this kind, each with its own weights."""


class Pairs(NamedTuple):
    """The P pairs with a vehicle ahead: indices of the scene, of the receiver j and of the sender k."""

    scene: Tensor
    receiver: Tensor
    sender: Tensor


class PairEncoder(nn.Module):
    """Logits of none and follow for all ordered pairs, from positions and speeds."""

    def __init__(self, config: PairEncoderConfig, speed: int, dt: float) -> None:
        """`speed`: index of the speed among the state features."""
        super().__init__()
        self.config, self.speed, self.dt = config, speed, dt
        h, k = config.hidden, config.kernel
        series, statistics = (SERIES, STATISTICS) if config.reads == "everything" else (PLAIN, 0)
        self.convolutions = nn.Sequential(
            nn.Conv1d(series, h, k, padding=k // 2),
            nn.SiLU(),
            nn.Conv1d(h, h, k, padding=k // 2, stride=2),
            nn.SiLU(),
            nn.Conv1d(h, h, k, padding=k // 2),
            nn.SiLU(),
        )
        self.attention = nn.Conv1d(h, config.heads, 1)
        self.pair = nn.Sequential(nn.Linear(3 * h + statistics, 2 * h), nn.SiLU(), nn.Linear(2 * h, h), nn.SiLU())
        self.follow = nn.Sequential(nn.Linear(3 * h, h), nn.SiLU(), nn.Linear(h, 1))
        self.nulls = nn.Sequential(nn.Linear(2 * h, h), nn.SiLU(), nn.Linear(h, 2))
        alone = msgspec.structs.replace(config, members=1)
        self.others = nn.ModuleList(PairEncoder(alone, speed, dt) for _ in range(config.members - 1))

    @property
    def members(self) -> Sequence["PairEncoder"]:
        """This encoder, and the others whose answers are averaged with its own."""
        return [self, *(other for other in self.others if isinstance(other, PairEncoder))]

    @property
    def least_steps(self) -> int:
        """Fewest instants of a history."""
        return round(max(DELAYS) / self.dt) + 10

    def forward(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B E 2"]:
        """Log probabilities of none and follow, in the order of `gri.pairs`."""
        shares = self.explanations(state)[..., 2:]
        follow = torch.stack([shares[:, j, i] for i, j in pairs(state.shape[1])], 1)
        return torch.stack([1 - follow, follow], -1).clamp(min=1e-13).log()

    def explanations(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B N 2+N"]:
        """Probabilities of the explanations of each vehicle's motion: own speed, unseen leader, vehicle k."""
        return self.scores(state).softmax(-1)

    def scores(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B N 2+N"]:
        """Logits of the explanations; those of vehicles that are not ahead at the last instant are `NEVER` or less."""
        if not self.others:
            return self.own_scores(state)
        return torch.stack([member.own_scores(state).log_softmax(-1) for member in self.members]).mean(0)

    def own_scores(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B N 2+N"]:
        """The same of this network alone."""
        x, v = state[..., 0], state[..., self.speed]
        b, n, _ = x.shape
        ahead = x[:, None, :, -1] > x[:, :, None, -1]
        which = Pairs(*ahead.nonzero(as_tuple=True))
        embedded = self._embed(x - x.mean((1, 2), keepdim=True), v, which)
        context = _context(embedded, which, ahead)
        follow = self.follow(torch.cat([embedded, context[which.scene, which.receiver]], -1))[:, 0]
        scores = follow.new_full((b, n, n), NEVER).index_put(tuple(which), follow)
        return torch.cat([self.nulls(context), scores], -1)

    def _embed(self, x: Float[Tensor, "B N T"], v: Float[Tensor, "B N T"], which: Pairs) -> Float[Tensor, "P H"]:
        motion = pair_motion(x, v, which, self.dt)
        features = self.convolutions(self.series(motion))
        evidence_of = reaction_evidence if torch.is_grad_enabled() else fast_reaction_evidence.reaction_evidence
        return self.embedded(features, motion, evidence_of)

    def series(self, motion: "PairMotion") -> Float[Tensor, "P C T"]:
        """The channels that this encoder reads."""
        series = pair_series(motion, self.dt)
        return series if self.config.reads == "everything" else series[:, :PLAIN]

    def embedded(
        self, features: Float[Tensor, "P H T"], motion: "PairMotion", evidence_of: Callable[..., Tensor]
    ) -> Float[Tensor, "P H"]:
        """Pairs as vectors: features pooled over time, and the statistics."""
        weight = self.attention(features).softmax(-1)
        heads = features.unflatten(1, (self.config.heads, -1))
        found = [(heads * weight[:, :, None]).sum(-1).flatten(1), features.mean(-1), features.amax(-1)]
        if self.config.reads == "everything":
            found.append(pair_statistics(motion, self.dt, evidence_of))
        return self.pair(torch.cat(found, -1))


class PairMotion(NamedTuple):
    """How the vehicles of P pairs move."""

    gap: Float[Tensor, "P T"]
    """[m]"""
    receiver: Float[Tensor, "P T"]
    """Speed [m/s]."""
    sender: Float[Tensor, "P T"]
    receiver_a: Float[Tensor, "P T"]
    """Acceleration [m/s²]."""
    sender_a: Float[Tensor, "P T"]


def pair_motion(x: Float[Tensor, "B N T"], v: Float[Tensor, "B N T"], which: Pairs, dt: float) -> PairMotion:
    """Gaps, smoothed speeds, and their derivatives."""
    padded = torch.cat([2 * v[..., :1] - v[..., 1:2], v, 2 * v[..., -1:] - v[..., -2:-1]], -1)
    v = padded[..., :-2] / 4 + padded[..., 1:-1] / 2 + padded[..., 2:] / 4
    inner = (v[..., 2:] - v[..., :-2]) / (2 * dt)
    a = torch.cat([inner[..., :1], inner, inner[..., -1:]], -1)
    scene, j, k = which
    gap = (x[scene, k] - x[scene, j] - LENGTH).clamp(min=LEAST_GAP)
    return PairMotion(gap, v[scene, j], v[scene, k], a[scene, j], a[scene, k])


def _context(embedded: Float[Tensor, "P H"], which: Pairs, ahead: Bool[Tensor, "B N N"]) -> Float[Tensor, "B N 2*H"]:
    """Mean and maximum over the vehicles ahead; zero where there is none."""
    every = embedded.new_zeros(*ahead.shape, embedded.shape[-1]).index_put(tuple(which), embedded)
    mean = every.sum(2) / ahead.sum(2, keepdim=True).clamp(min=1)
    largest = every.masked_fill(~ahead[..., None], -torch.inf).amax(2)
    return torch.cat([mean, largest.masked_fill(~ahead.any(2)[..., None], 0.0)], -1)


def _normalised(series: Float[Tensor, "P T"], floor: float = 0.02) -> Float[Tensor, "P T"]:
    centred = series - series.mean(-1, keepdim=True)
    return centred / (centred.square().mean(-1, keepdim=True).sqrt() + floor)


def pair_series(motion: PairMotion, dt: float) -> Float[Tensor, "P C T"]:
    """The channels that the convolutions read."""
    gap, own, other, own_a, other_a = motion
    time = (torch.arange(1 - gap.shape[-1], 1, dtype=gap.dtype) * dt / 4.0).expand_as(gap)  # Units: 4 s
    reaction, space, difference, cause = (_normalised(s) for s in (own_a, gap, other - own, other_a))
    on_the_scale_of_drivers = [
        gap.log() / 2 - 1.5,
        (gap / (own + 3)).clamp(0, 20) / 4 - 0.5,
        (other - own) / 3,
        own / 15 - 1,
        own_a,
        other_a,
        (5 * own_a).tanh(),
        (5 * other_a).tanh(),
    ]
    on_their_own_scale = [_normalised(own), _normalised(other), space, reaction, cause, difference, time]
    products = [reaction * difference, reaction * space, reaction * cause]
    return torch.stack(on_the_scale_of_drivers + on_their_own_scale + products, 1)


@torch.no_grad()
def pair_statistics(
    motion: PairMotion, dt: float, evidence_of: Callable[..., Tensor] = reaction_evidence
) -> Float[Tensor, "P F"]:
    """The evidence for a reaction, squashed, the best of it, and how much both vehicles accelerate."""
    evidence = evidence_of(motion.gap, motion.receiver, motion.sender, dt)
    best = evidence[:, 1:].amax(-1, keepdim=True)
    moves = [(a.square().mean(-1, keepdim=True) + 1e-4).log() / 4 for a in (motion.receiver_a, motion.sender_a)]
    squashed = (torch.cat([evidence[:, 1:], best], -1) / 3).asinh()
    return torch.cat([evidence[:, :1], squashed, *(m.double() for m in moves)], -1).to(motion.gap.dtype)
