"""The probability of edge types: prior, and posterior given the likelihood of the recorded actions (Sec. III-A, IV).

The likelihood of a driven vehicle's actions depends on all edges that enter it. So prior and likelihood are combined
for every combination of those edges (`combinations`), and the posterior of one edge is the sum over the others
(`marginals`).
"""

from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.graph import EdgeType, pairs, vehicle_count
from gri.core.layers import edge_ends
from gri.rewards.structured import StructuredReward

UNLIKELY = 1e-12
"""Probability of an edge type that nearly contradicts its definition; a likelihood can still outweigh it."""
EXCLUDED_BELOW = 1e-30
"""Edge types with a smaller probability are excluded: their logarithm is set to `LOG_EXCLUDED`."""
LOG_EXCLUDED = -1e5
"""Logarithm of the probability of an excluded type [nats]: finite, and below what any likelihood can outweigh."""


def combinations(reward: StructuredReward, senders: int) -> tuple[Float[Tensor, "C M"], Float[Tensor, "C S K"]]:
    """All C = K^S ways to set the types of the S edges that enter one vehicle.

    Returns masks over the M reward features (1 where the features of an edge count), and the types as one-hot vectors.
    The features are those of the vehicle alone, then for every sender those of every type.
    """
    vocabulary, node = reward.vocabulary, len(reward.terms.node)
    masks, types = [], []
    for kinds in product(range(len(vocabulary)), repeat=senders):
        mask = [1.0] * node
        for kind in kinds:
            for k, terms in reward.terms.edge.items():
                mask += [float(vocabulary[kind] == k)] * len(terms)
        masks.append(mask)
        types.append(list(kinds))
    return torch.tensor(masks), torch.nn.functional.one_hot(torch.tensor(types), len(vocabulary)).float()


def edge_prior(edge_types: int, none: float) -> Float[Tensor, " K"]:
    """The sparse prior p(z_ij): `none` for type 0; the other types share the rest equally."""
    return torch.tensor([none] + [(1 - none) / (edge_types - 1)] * (edge_types - 1))


def scene_prior(
    reward: StructuredReward, state: Float[Tensor, "B N T D"], none: float, ahead_only: bool = False
) -> Float[Tensor, "B E K"]:
    """The sparse prior p(z_ij) of every scene.

    With `ahead_only`, following a vehicle that is behind at the end of the scene is `UNLIKELY`.
    """
    n = state.shape[1]
    prior = edge_prior(len(reward.vocabulary), none).repeat(len(state), n * (n - 1), 1)
    if ahead_only:
        senders, receivers = edge_ends(n)
        behind = state[:, senders, -1, 0] < state[:, receivers, -1, 0]
        k = reward.vocabulary.index(EdgeType.FOLLOW)
        prior[..., k] = prior[..., k].masked_fill(behind, UNLIKELY)
    return prior / prior.sum(-1, keepdim=True)


def combination_prior(reward: StructuredReward, prior: Float[Tensor, "B E K"], driven: int) -> Float[Tensor, "B R C"]:
    """log p(z_j) [nats] of every combination of the edges that enter each of the R = `driven` vehicles.

    Types less probable than `EXCLUDED_BELOW` are excluded, as likelihoods differ by hundreds of nats over a scene.
    """
    n = vehicle_count(prior.shape[1])
    incoming = torch.tensor([[pairs(n).index((i, j)) for i in range(n) if i != j] for j in range(driven)])
    logs = torch.where(prior < EXCLUDED_BELOW, LOG_EXCLUDED, prior.log())
    return torch.einsum("brsk,csk->brc", logs[:, incoming], combinations(reward, n - 1)[1])


def marginals(
    reward: StructuredReward, likelihood: Float[Tensor, "B R C"], prior: Float[Tensor, "B E K"]
) -> Float[Tensor, "B E K"]:
    """The posterior p(z_ij | u) of each edge, from log p(u_j | z_j) of all combinations and the prior.

    Edges into vehicles that are not driven keep the prior.
    """
    driven, n = likelihood.shape[1], vehicle_count(prior.shape[1])
    scores = likelihood + combination_prior(reward, prior, driven)
    marginal = torch.einsum("brc,csk->brsk", scores.softmax(-1), combinations(reward, n - 1)[1])
    posterior = prior.clone()
    for edge, (i, j) in enumerate(pairs(n)):
        if j < driven:
            posterior[:, edge] = marginal[:, j, i if i < j else i - 1]
    return posterior
