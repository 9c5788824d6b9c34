"""How good are inferred graphs? What the accuracy over all edges does not say (Sec. VI-B).

The sparse truth makes the empty graph look good (two thirds of the chain's edges are "none"), and labels
without meaning have to be renamed before they can be compared at all. Renaming has its own trap: the mean
accuracy over all K! namings is exactly 1/K, because each true type meets each label in (K−1)! of them, so
that the best naming never scores below 1/K, whatever was inferred.
"""

from itertools import permutations
from math import log

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.graph import agents_of, pairs

Types = Int[Tensor, "S E"]


def edges_into_driven(types: Types) -> Int[Tensor, "S F"]:
    """The edges that enter driven vehicles; no data speaks of those into the leader."""
    n = agents_of(types.shape[1])
    return types[:, [edge for edge, (_, receiver) in enumerate(pairs(n)) if receiver < n - 1]]


def f1(inferred: Types, true: Types, kind: int) -> float | None:
    """2·TP / (2·TP + FP + FN) of one type over all given edges; None where it neither occurs nor is inferred."""
    hit = int(((inferred == kind) & (true == kind)).sum())
    called, present = int((inferred == kind).sum()), int((true == kind).sum())
    return 2 * hit / (called + present) if called + present else None


def renamed(inferred: Types, naming: tuple[int, ...]) -> Types:
    """Label k read as type naming[k]."""
    return torch.tensor(naming)[inferred]


def best_naming(inferred: Types, true: Types, types: int, move_none: bool) -> tuple[int, ...]:
    """The naming with the highest accuracy over all scenes, one for the whole data set.

    `move_none` also renames label 0. A model in which type 0 sends no message has a label 0 that does mean
    something, and the paper's own figures (below 1/3 with three types) only come out if it is kept.
    """
    free = range(types) if move_none else range(1, types)
    fixed = () if move_none else (0,)
    namings = [(*fixed, *order) for order in permutations(free)]
    return max(namings, key=lambda naming: float((renamed(inferred, naming) == true).float().mean()))


def edge_budget(edges: int, total: int, no_edge_prior: float, types: int = 2) -> float:
    """KL of a certain graph to the sparse prior, mean per edge [nats]: what I_c has to leave room for."""
    none, other = -log(no_edge_prior), -log((1 - no_edge_prior) / (types - 1))
    return ((total - edges) * none + edges * other) / total


def shuffled(state: Float[Tensor, "S N T D"], order: Int[Tensor, " N"]) -> Float[Tensor, "S N T D"]:
    """The same scene with vehicle order[j] at place j."""
    return state[:, order]


def unshuffled(types: Types, order: Int[Tensor, " N"]) -> Types:
    """Edge types inferred from a shuffled scene, back at the pairs they belong to."""
    n = len(order)
    places = {int(vehicle): place for place, vehicle in enumerate(order)}
    return types[:, [pairs(n).index((places[i], places[j])) for i, j in pairs(n)]]
