"""Metrics of the paper (Sec. VI-B, VI-E) as pure functions with one value per scene, and their means with intervals."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.graph import pairs, vehicle_count
from gri.evaluation.graph_scores import edges_into_driven


@dataclass(frozen=True)
class Summary:
    """Mean and standard deviation over scenes, half the width of the mean's 95 % interval, and the number of scenes."""

    mean: float
    std: float
    half_width: float
    scenes: int

    def __str__(self) -> str:
        return f"{self.mean:.4f} ± {self.std:.4f}"


def summary(values: Float[Tensor, " S"]) -> Summary:
    """Mean and standard deviation over scenes, with the normal 95 % interval of the mean."""
    count = len(values)
    std = float(values.std()) if count > 1 else 0.0
    return Summary(float(values.mean()), std, 1.96 * std / count**0.5, count)


def proportion(values: Bool[Tensor, " S"]) -> Summary:
    """Share of true values with a Wilson 95 % interval, which has a positive width also at 0 and 100 %."""
    count, share, z = len(values), float(values.float().mean()), 1.96
    width = (share * (1 - share) / count + z**2 / (4 * count**2)) ** 0.5
    return Summary(share, (share * (1 - share)) ** 0.5, z * width / (1 + z**2 / count), count)


def rmse(state: Float[Tensor, "S N T D"], recorded: Float[Tensor, "S N T D"], feature: int) -> Float[Tensor, " S"]:
    """RMSE of each scene in the feature's unit: sqrt(Σ_j Σ_t (ε^E − ε̂)² / ((N−1)·T)) (Sec. VI-B).

    `feature` is its position on the last axis. The leader is given, so the divisor has N−1 vehicles. t = 0 counts.
    """
    error = (state - recorded)[..., feature]
    return (error**2).sum((1, 2)).div((error.shape[1] - 1) * error.shape[2]).sqrt()


def accuracy(inferred: Int[Tensor, "S E"], true: Int[Tensor, "S E"]) -> Float[Tensor, " S"]:
    """Share of all E = N(N−1) edges with the correct type (Sec. VI-B)."""
    return (inferred == true).float().mean(-1)


def driven_accuracy(inferred: Int[Tensor, "S E"], true: Int[Tensor, "S E"]) -> Float[Tensor, " S"]:
    """Share of the edges into driven vehicles with the correct type (`graph_scores.edges_into_driven`)."""
    return accuracy(edges_into_driven(inferred), edges_into_driven(true))


def success(final: Float[Tensor, "S N D"], margin: float = 2.0) -> Bool[Tensor, " S"]:
    """Δx^f = x_1^T − x_0^T ≥ δ_f: vehicle 0 ends at least δ_f = `margin` [m] behind vehicle 1 (Sec. VI-E)."""
    return final[:, 1, 0] - final[:, 0, 0] >= margin


def smallest_headway(state: Float[Tensor, "S N T D"]) -> Float[Tensor, "S R"]:
    """Smallest distance of each vehicle j < N−1 to vehicle j + 1 over time, front to front [m]."""
    return (state[:, 1:, :, 0] - state[:, :-1, :, 0]).amin(-1)


def collision(state: Float[Tensor, "S N T D"], distance: float = 2.0) -> Bool[Tensor, " S"]:
    """d_min ≤ δ_c = `distance` [m] between vehicles 0 and 1, along the road (Sec. VI-E)."""
    return (state[:, 1, :, 0] - state[:, 0, :, 0]).abs().amin(-1) <= distance


def edge_frequency(inferred: Int[Tensor, "S E"], types: int) -> Float[Tensor, "K N N"]:
    """Adjacency matrices as in the paper: A^k[receiver, sender] is the share of scenes with type k (Sec. VI-B)."""
    n = vehicle_count(inferred.shape[1])
    matrix = torch.zeros(types, n, n)
    for edge, (sender, receiver) in enumerate(pairs(n)):
        for k in range(types):
            matrix[k, receiver, sender] = (inferred[:, edge] == k).float().mean()
    return matrix
