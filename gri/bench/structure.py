"""The structured prior of the rows "+ prior": only vehicles ahead, one at a time, and nobody with even odds.

A row with the flat prior gives every ordered pair the probability `FLAT` beforehand. Its likelihood ratio of each edge
is its odds over the prior's. The row "+ prior" puts the same ratios under the structured prior, which is that of the
row "prior alone". So both rows differ in the prior and in nothing else.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from gri.bench.answers import Infer, ask
from gri.bench.car_following_scenes import KnownScenes
from gri.core.edges import pairs
from gri.relations.closed_form_posterior import Weights

FLAT = 0.1
"""P(follow) of every ordered pair under the flat prior, as in NRI and in the paper."""


def share_among_those_ahead(log_ratio: Float[Tensor, "S E"]) -> Float[Tensor, "S E"]:
    """P(follow) of all pairs from log p(motion | edge) − log p(motion | no edge); vehicle N−1 is the foremost."""
    n = int((1 + (1 + 4 * log_ratio.shape[1]) ** 0.5) / 2)
    follow, found = Weights().follow, torch.zeros_like(log_ratio)
    every = pairs(n)
    for j in range(n - 1):
        ahead = [every.index((k, j)) for k in range(j + 1, n)]
        scores = log_ratio[:, ahead] + torch.tensor(follow / len(ahead) / (1 - follow)).log()
        found[:, ahead] = torch.cat([torch.zeros_like(scores[:, :1]), scores], 1).softmax(1)[:, 1:]
    return found


def with_prior(infer: Infer, before: float = FLAT) -> Infer:
    """The same row under the structured prior; `before` is its P(follow) without any motion."""
    flat = torch.tensor(before, dtype=torch.float64).logit()

    def structured(known: KnownScenes) -> Float[Tensor, "S E"]:
        odds = ask(infer, known).follow.double().clamp(1e-12, 1 - 1e-12).logit()
        return share_among_those_ahead(odds - flat)

    return structured
