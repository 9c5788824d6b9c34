"""Evidence for reactions: how well a vehicle's accelerations are explained with and without another vehicle.

For a receiver j and a sender k, with a_t = (v_{t+1} − v_t)/Δt of smoothed speeds:

- own:      a_t = ρ a_{t−1} + c + b₁ (v_t − v̄) + b₂ (v_t − v̄)² + noise
- linear:   own + g₁ (gap − 7 − 1.4 v) + g₂ Δv, all seen τ seconds earlier
- ratio:    own + g₃ (1 − ((7 + 1.4 v)/gap)²) + g₄ v Δv/gap, all seen τ seconds earlier

All coefficients have broad Gaussian priors, so that the evidence is a Gaussian integral. It is averaged over levels of
the noise. No constant of a driver is assumed: 7 m and 1.4 s are only where the priors are centred.
"""

from math import log, pi

import torch
from jaxtyping import Float
from torch import Tensor

STANDSTILL, TIME_GAP = 7.0, 1.4  # [m], [s]
DELAYS = (0.0, 0.2, 0.4, 0.8)  # [s]
NOISE = (0.005, 0.015, 0.05, 0.15, 0.5)  # [m/s²]
# Pairs of a mean and a standard deviation. Released encoders learned with these; another value is another encoder.
OWN = ((0.4, 0.4), (0.0, 0.5), (-0.1, 0.15), (0.0, 0.01))  # ρ, c, b₁, b₂
LINEAR = ((0.06, 0.3), (0.06, 0.3))  # g₁ [1/s²], g₂ [1/s]
RATIO = ((0.7, 0.4), (0.6, 0.4))  # g₃ [m/s²], g₄ [1]
EVIDENCES = 1 + 2 * len(DELAYS)


def reaction_evidence(
    gap: Float[Tensor, "P T"], own: Float[Tensor, "P T"], other: Float[Tensor, "P T"], dt: float
) -> Float[Tensor, "P F"]:
    """Log evidence per acceleration [nats] of "own", and the log evidence of each follow form and delay over it [nats].

    Gaps [m], speeds of the receiver and the sender [m/s], sampled every `dt` [s].
    """
    gap, own, other = gap.double(), own.double(), other.double()
    first = round(max(DELAYS) / dt)
    a = (own[:, 1:] - own[:, :-1]) / dt
    y, v = a[:, first:], own[:, first:-1] - own.mean(-1, keepdim=True)
    alone = [a[:, first - 1 : -1], torch.ones_like(y), v, v**2]
    base = log_evidence(y, torch.stack(alone, -1), OWN)
    found = []
    for delay in DELAYS:
        late = slice(first - round(delay / dt), a.shape[1] - round(delay / dt))
        for columns, prior in ((linear_columns, LINEAR), (ratio_columns, RATIO)):
            reaction = columns(gap[:, late], own[:, late], other[:, late])
            found.append(log_evidence(y, torch.stack(alone + reaction, -1), OWN + prior) - base)
    return torch.stack([base / y.shape[1], *found], -1)


def linear_columns(
    gap: Float[Tensor, "*B T"], own: Float[Tensor, "*B T"], other: Float[Tensor, "*B T"]
) -> list[Float[Tensor, "*B T"]]:
    """What g₁ and g₂ multiply: gap [m], speeds of receiver and sender [m/s]."""
    return [(gap - (STANDSTILL + TIME_GAP * own)).clamp(max=30.0), other - own]


def ratio_columns(
    gap: Float[Tensor, "*B T"], own: Float[Tensor, "*B T"], other: Float[Tensor, "*B T"]
) -> list[Float[Tensor, "*B T"]]:
    """What g₃ and g₄ multiply; the gap must be positive."""
    return [1 - ((STANDSTILL + TIME_GAP * own) / gap).clamp(max=3.0) ** 2, own * (other - own) / gap]


def log_evidence(
    y: Float[Tensor, "P T"], design: Float[Tensor, "P T C"], prior: tuple[tuple[float, float], ...]
) -> Float[Tensor, " P"]:
    """log of the mean over noise levels σ of N(y; X m, σ² I + X S² X')."""
    mean, sd = (torch.tensor(values, dtype=y.dtype) for values in zip(*prior, strict=True))
    residual, scaled = y - design @ mean, design * sd
    values, vectors = torch.linalg.eigh(scaled.mT @ scaled)
    values = values.clamp(min=0)
    explained = (vectors.mT @ (scaled.mT @ residual[..., None]))[..., 0] ** 2
    square, steps = residual.square().sum(-1), y.shape[1]
    variance, log_sigma = torch.tensor([(sigma**2, 2 * steps * log(sigma)) for sigma in NOISE], dtype=y.dtype).mT
    values, variance = values[None], variance[:, None]  # Shapes: (1, P, C), (S, 1)
    rest = (square - (explained / (variance[..., None] + values)).sum(-1)) / variance
    log_det = (1 + values / variance[..., None]).log().sum(-1) + log_sigma[:, None]
    found = -0.5 * (rest + log_det + steps * log(2 * pi))
    return found.logsumexp(0) - log(len(NOISE))
