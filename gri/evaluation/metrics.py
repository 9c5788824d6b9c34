"""Metrics of the paper (Sec. VI-B, VI-E) as pure functions, one value per scene, and their means with
intervals.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.graph import agents_of, pairs


@dataclass(frozen=True)
class Summary:
    """Mean over scenes, their standard deviation, and half the width of the 95 % interval of the mean."""

    mean: float
    std: float
    half_width: float
    scenes: int

    def __str__(self) -> str:
        return f"{self.mean:.4f} ± {self.std:.4f}"


def summary(values: Float[Tensor, " S"]) -> Summary:
    """Mean, standard deviation over scenes and normal 95 % interval."""
    count = len(values)
    std = float(values.std()) if count > 1 else 0.0
    return Summary(float(values.mean()), std, 1.96 * std / count**0.5, count)


def proportion(values: Bool[Tensor, " S"]) -> Summary:
    """Share of true values with a Wilson 95 % interval, which does not shrink to nothing at 0 and 100 %."""
    count, share, z = len(values), float(values.float().mean()), 1.96
    spread = (share * (1 - share) / count + z**2 / (4 * count**2)) ** 0.5
    return Summary(share, (share * (1 - share)) ** 0.5, z * spread / (1 + z**2 / count), count)


def rmse(state: Float[Tensor, "S N T D"], recorded: Float[Tensor, "S N T D"], feature: int) -> Float[Tensor, " S"]:
    """sqrt(Σ_j Σ_t (ε^E − ε̂)² / ((N−1)·T)): the leader is given, so N−1 vehicles count; t = 0 counts."""
    error = (state - recorded)[..., feature]
    return (error**2).sum((1, 2)).div((error.shape[1] - 1) * error.shape[2]).sqrt()


def accuracy(inferred: Int[Tensor, "S E"], true: Int[Tensor, "S E"]) -> Float[Tensor, " S"]:
    """Share of all N(N−1) edges with the right type."""
    return (inferred == true).float().mean(-1)


def driven_accuracy(inferred: Int[Tensor, "S E"], true: Int[Tensor, "S E"]) -> Float[Tensor, " S"]:
    """Share of right edges among those that enter driven vehicles; no data speaks of edges into the leader."""
    n = agents_of(true.shape[1])
    counted = [edge for edge, (_, receiver) in enumerate(pairs(n)) if receiver < n - 1]
    return accuracy(inferred[:, counted], true[:, counted])


def success(final: Float[Tensor, "S N D"], margin: float = 2.0) -> Bool[Tensor, " S"]:
    """Δx^f = x_1^T − x_0^T ≥ δ_f: at the end vehicle 0 is behind vehicle 1 by the margin [m] (Sec. VI-E)."""
    return final[:, 1, 0] - final[:, 0, 0] >= margin


def smallest_headway(state: Float[Tensor, "S N T D"]) -> Float[Tensor, "S R"]:
    """Least distance [m] of each driven vehicle to the next higher index over time, front to front."""
    return (state[:, 1:, :, 0] - state[:, :-1, :, 0]).amin(-1)


def collision(state: Float[Tensor, "S N T D"], distance: float = 2.0) -> Bool[Tensor, " S"]:
    """d_min ≤ δ_c between vehicles 0 and 1 (Sec. VI-E), in one dimension."""
    return (state[:, 1, :, 0] - state[:, 0, :, 0]).abs().amin(-1) <= distance


def edge_frequency(inferred: Int[Tensor, "S E"], types: int) -> Float[Tensor, "K N N"]:
    """Adjacency matrices as the paper prints them: A^k[receiver, sender] = share of scenes with that type."""
    n = agents_of(inferred.shape[1])
    matrix = torch.zeros(types, n, n)
    for edge, (sender, receiver) in enumerate(pairs(n)):
        for k in range(types):
            matrix[k, receiver, sender] = (inferred[:, edge] == k).float().mean()
    return matrix
