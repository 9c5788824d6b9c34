"""A hidden Markov chain whose states are explanations: forward and backward pass for whole batches, in logarithms.

From one step to the next the state stays with probability `stay`, if it is still admissible. Else a new one is drawn
from the prior of that step. So the transition matrix is a diagonal plus a matrix of rank one, and a pass costs K, not
K², per step.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

IMPOSSIBLE = -1e4  # stands for log 0; finite, so that gradients stay finite


@dataclass(frozen=True)
class Smoothed:
    """What a chain says after it has seen all steps."""

    marginals: Float[Tensor, "*B T K"]
    """P(state at a step | all observations)."""
    evidence: Float[Tensor, "*B"]
    """Log probability of all observations [nats]."""


def log_evidence(
    likelihood: Float[Tensor, "*B T K"], prior: Float[Tensor, "*B T K"], stay: float | Tensor
) -> Float[Tensor, "*B"]:
    """Log probability of all observations; arguments as in `smooth`."""
    return _forward(likelihood, prior, stay)[-1].logsumexp(-1)


def smooth(likelihood: Float[Tensor, "*B T K"], prior: Float[Tensor, "*B T K"], stay: float | Tensor) -> Smoothed:
    """Forward-backward pass.

    Args:
        likelihood: log probability of each step's observation in each state [nats].
        prior: log probability of each state at each step where the state is drawn anew; `IMPOSSIBLE` where it is not
            admissible. Normalised over K.
        stay: probability that an admissible state is kept.
    """
    forward = _forward(likelihood, prior, stay)
    steps = likelihood.shape[-2]
    backward = torch.zeros_like(forward[-1])
    found = [forward[-1]]
    for t in range(steps - 2, -1, -1):
        ahead = likelihood[..., t + 1, :] + backward
        keep, leave = _kept(prior[..., t + 1, :], stay)
        anew = (prior[..., t + 1, :] + ahead).logsumexp(-1, keepdim=True)
        backward = torch.logaddexp(keep + ahead, leave + anew)
        found.append(forward[t] + backward)
    return Smoothed(torch.stack(found[::-1], -2).softmax(-1), forward[-1].logsumexp(-1))


def _kept(prior: Float[Tensor, "*B K"], stay: float | Tensor) -> tuple[Tensor, Tensor]:
    """Log probabilities that a state is kept, and that it is drawn anew."""
    admissible = prior > IMPOSSIBLE / 2
    stays = torch.as_tensor(stay, dtype=prior.dtype)
    keep = torch.where(admissible, stays.log(), torch.full_like(prior, IMPOSSIBLE))
    leave = torch.where(admissible, torch.log1p(-stays), torch.zeros_like(prior))
    return keep, leave


def _forward(likelihood: Tensor, prior: Tensor, stay: float | Tensor) -> list[Tensor]:
    """Log of P(observations up to t, state at t) for every t."""
    alpha = prior[..., 0, :] + likelihood[..., 0, :]
    found = [alpha]
    for t in range(1, likelihood.shape[-2]):
        keep, leave = _kept(prior[..., t, :], stay)
        anew = (alpha + leave).logsumexp(-1, keepdim=True) + prior[..., t, :]
        alpha = torch.logaddexp(alpha + keep, anew) + likelihood[..., t, :]
        found.append(alpha)
    return found
