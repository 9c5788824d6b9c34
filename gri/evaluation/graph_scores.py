"""Scores of inferred graphs that the accuracy over all edges does not show (Sec. VI-B).

True graphs are sparse, so the empty graph has a high accuracy: two thirds of the chain's edges are "none". Labels
without meaning must be renamed to types before a comparison. The best of all K! namings has an accuracy of at least
1/K for any inferred graph, because the mean over all namings is exactly 1/K.
"""

from itertools import permutations
from math import log

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.graph import pairs, vehicle_count

Types = Int[Tensor, "S E"]


def edges_into_driven(types: Types) -> Int[Tensor, "S F"]:
    """The edges into driven vehicles. Scenes have no information on edges into the leader, the last vehicle."""
    n = vehicle_count(types.shape[1])
    return types[:, [edge for edge, (_, receiver) in enumerate(pairs(n)) if receiver < n - 1]]


def f1(inferred: Types, true: Types, kind: int) -> float | None:
    """F1 = 2·TP / (2·TP + FP + FN) of type `kind` over all given edges; None if it neither occurs nor is inferred."""
    true_positives = int(((inferred == kind) & (true == kind)).sum())
    predicted, present = int((inferred == kind).sum()), int((true == kind).sum())
    return 2 * true_positives / (predicted + present) if predicted + present else None


def f1_of_types(
    inferred: Int[np.ndarray, "*S"], true: Int[np.ndarray, "*S"], types: int
) -> Float[np.ndarray, " {types}"]:
    """F1 of each of `types` types, over all values; NaN for a type that does not occur."""
    counts = np.bincount((true * types + inferred).ravel(), minlength=types * types).reshape(types, types)
    present = counts.sum(1)
    return np.where(present > 0, 2 * np.diag(counts) / np.maximum(counts.sum(0) + present, 1), np.nan)


def renamed(inferred: Types, naming: tuple[int, ...]) -> Types:
    """The graphs in which label k is replaced by type naming[k]."""
    return torch.tensor(naming)[inferred]


def best_label_matching(inferred: Types, true: Types, types: int, move_none: bool) -> tuple[int, ...]:
    """The naming of K = `types` labels with the highest accuracy over all scenes; one naming for the whole data set.

    With `move_none`, label 0 is renamed as well. If type 0 sends no message, label 0 has a meaning, however. The
    paper's accuracies (below 1/3 with three types) are possible only if label 0 is not renamed.
    """
    free = range(types) if move_none else range(1, types)
    fixed = () if move_none else (0,)
    namings = [(*fixed, *order) for order in permutations(free)]
    return max(namings, key=lambda naming: float((renamed(inferred, naming) == true).float().mean()))


def edge_budget(edges: int, total: int, no_edge_prior: float, types: int = 2) -> float:
    """KL[q || p] of a certain graph q to the sparse prior p, with `edges` of `total` edges, mean per edge [nats].

    I_c must be at least this large, or the bottleneck does not allow this graph.
    """
    none, other = -log(no_edge_prior), -log((1 - no_edge_prior) / (types - 1))
    return ((total - edges) * none + edges * other) / total


def shuffled(state: Float[Tensor, "S N T D"], order: Int[Tensor, " N"]) -> Float[Tensor, "S N T D"]:
    """The same scenes with the vehicles renumbered: vehicle order[j] becomes vehicle j."""
    return state[:, order]


def unshuffled(types: Types, order: Int[Tensor, " N"]) -> Types:
    """Edge types that were inferred from shuffled scenes, in the original numbering."""
    n = len(order)
    places = {int(vehicle): place for place, vehicle in enumerate(order)}
    return types[:, [pairs(n).index((places[i], places[j])) for i, j in pairs(n)]]
