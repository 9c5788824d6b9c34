"""Interaction graphs: a distribution over edge types for each candidate pair of vehicles (Sec. III-A, IV).

`z[i, j]` is the effect of vehicle i (sender) on vehicle j (receiver): with `z[1, 0] = FOLLOW`, vehicle 0 follows
vehicle 1. The E candidate pairs are in lexicographic order (sender, receiver). The complete graph on a few vehicles has
all N(N−1) ordered pairs; for many vehicles `gri.core.candidate_pairs` says which pairs are candidates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from gri.core.edges import FOLLOWING, LANE_CHANGING, MOST_COMPLETE, YIELDING, EdgeType, Vocabulary, pairs, vehicle_count

__all__ = [
    "FOLLOWING",
    "LANE_CHANGING",
    "MOST_COMPLETE",
    "YIELDING",
    "EdgeType",
    "InteractionGraph",
    "Vocabulary",
    "incoming",
    "pairs",
    "vehicle_count",
]

HOLDS_BACK = EdgeType.FOLLOW, EdgeType.YIELD
"""Types by which the sender may make the receiver slow down."""


@dataclass(frozen=True)
class InteractionGraph:
    """Distributions over K edge types for E candidate pairs of B groups; the vocabulary says what index k means."""

    logits: Float[Tensor, "B E K"]
    vocabulary: Vocabulary
    unknown: Float[Tensor, " B"] | None = None
    """How far the history is from all that the model was trained on; above 1 the model does not know such scenes. None:
    the model cannot tell.
    """
    candidates: tuple[tuple[int, int], ...] | None = None
    """The candidate pairs (sender, receiver) of each group, in lexicographic order; all other pairs have type none.
    None: the graph is complete.
    """
    in_doubt: Bool[Tensor, "B E"] | None = None
    """Pairs in which the receiver is to react although none is more probable (`reacting_in_doubt`). None: no pair."""

    def __post_init__(self) -> None:
        assert self.logits.shape[-1] == len(self.vocabulary), f"{self.logits.shape} does not fit {self.vocabulary}"
        if self.candidates is not None:
            assert self.logits.shape[-2] == len(self.candidates), f"{self.logits.shape} does not fit the candidates"

    @property
    def pairs(self) -> Sequence[tuple[int, int]]:
        """The candidate pairs (sender, receiver), in the order of the edge axis."""
        return pairs(vehicle_count(self.logits.shape[-2])) if self.candidates is None else self.candidates

    @classmethod
    def certain(
        cls,
        types: Int[Tensor, "B E"],
        vocabulary: Vocabulary,
        candidates: tuple[tuple[int, int], ...] | None = None,
    ) -> "InteractionGraph":
        """A graph with probability 1 (up to e⁻³⁰) on the given type indices."""
        logits = (torch.nn.functional.one_hot(types, len(vocabulary)).float() - 1) * 30
        return cls(logits, vocabulary, candidates=candidates)

    @classmethod
    def of_edges(
        cls,
        edges: Mapping[tuple[int, int], EdgeType],
        vocabulary: Vocabulary,
        n: int = 3,
        batch: int = 1,
        candidates: tuple[tuple[int, int], ...] | None = None,
    ) -> "InteractionGraph":
        """The certain graph from `{(sender, receiver): type}`; other pairs have type none.

        It is complete on n vehicles, or has the given candidate pairs, among which are all pairs with an edge.
        """
        which = pairs(n) if candidates is None else candidates
        types = [vocabulary.index(edges.get(pair, EdgeType.NONE)) for pair in which]
        return cls.certain(torch.tensor([types] * batch), vocabulary, candidates)

    def on(self, candidates: tuple[tuple[int, int], ...]) -> "InteractionGraph":
        """The same graph on other candidate pairs, in lexicographic order; pairs that it lacks have type none."""
        if candidates == tuple(self.pairs):
            return self
        place = {pair: k for k, pair in enumerate(self.pairs)}
        none = self.logits.new_full((len(self), 1, self.logits.shape[-1]), -30.0)
        none[..., 0] = 0.0
        every = torch.cat([self.logits, none], 1)
        rows = [place.get(pair, len(place)) for pair in candidates]
        doubted = None
        if self.in_doubt is not None:
            doubted = torch.cat([self.in_doubt, self.in_doubt.new_zeros(len(self), 1)], 1)[:, rows]
        return replace(self, logits=every[:, rows], candidates=candidates, in_doubt=doubted)

    def where(self, groups: Bool[Tensor, " B"], other: "InteractionGraph") -> "InteractionGraph":
        """This graph for some groups, the other one, on the same pairs, for the rest."""
        assert tuple(self.pairs) == tuple(other.pairs), "the graphs have different pairs"
        doubted, unknown = None, None
        if self.in_doubt is not None or other.in_doubt is not None:
            nowhere = torch.zeros(self.logits.shape[:2], dtype=torch.bool)
            one, two = (nowhere if graph.in_doubt is None else graph.in_doubt for graph in (self, other))
            doubted = torch.where(groups[:, None], one, two)
        if self.unknown is not None and other.unknown is not None:
            unknown = torch.where(groups, self.unknown, other.unknown)
        logits = torch.where(groups[:, None, None], self.logits, other.logits)
        return replace(self, logits=logits, unknown=unknown, in_doubt=doubted)

    @property
    def probs(self) -> Float[Tensor, "B E K"]:
        """Probabilities of the edge types."""
        return self.logits.softmax(-1)

    @property
    def map(self) -> Int[Tensor, "B E"]:
        """Index of the most probable type of each edge; of a pair in doubt, that of the most probable reaction."""
        most_probable = self.logits.argmax(-1)
        return most_probable if self.in_doubt is None else torch.where(self.in_doubt, self._reaction[0], most_probable)

    @property
    def one_hot(self) -> Float[Tensor, "B E K"]:
        """The most probable graph as one-hot vectors."""
        return torch.nn.functional.one_hot(self.map, self.logits.shape[-1]).to(self.logits.dtype)

    @property
    def _reaction(self) -> tuple[Int[Tensor, "B E"], Float[Tensor, "B E"]]:
        """The most probable type by which the receiver lets itself be held back, and its probability."""
        kinds = torch.tensor([k for k, kind in enumerate(self.vocabulary) if kind in HOLDS_BACK])
        best = self.probs[..., kinds].max(-1)
        return kinds[best.indices], best.values

    def reacting_in_doubt(self, receivers: Sequence[int], least: float) -> "InteractionGraph":
        """The graph in which none of these receivers reacts to nobody without being sure of it.

        Whoever would react to nobody (no edge that holds it back, such as follow) gets its most probable reaction, if
        that has the probability `least`, or a fiftieth of it in a scene that the model does not know.
        """
        probability = self._reaction[1]
        holds_back = torch.tensor([kind in HOLDS_BACK for kind in self.vocabulary])
        unknown = torch.zeros(len(self), dtype=torch.bool) if self.unknown is None else self.unknown > 1
        doubted = torch.zeros(self.logits.shape[:2], dtype=torch.bool)
        for receiver in receivers:
            into = torch.tensor([k for k, pair in enumerate(self.pairs) if pair[1] == receiver], dtype=torch.long)
            if not len(into):
                continue
            best = probability[:, into].max(-1)
            free = ~holds_back[self.map[:, into]].any(-1)
            reacts = free & (best.values >= torch.where(unknown, least / 50, least))
            doubted[torch.arange(len(self)), into[best.indices]] |= reacts
        return replace(self, in_doubt=doubted if doubted.any() else None)

    def sample(self, generator: torch.Generator, temperature: float = 0.5) -> Float[Tensor, "B E K"]:
        """Straight-through Gumbel-softmax: one-hot samples with the gradient of the relaxed samples."""
        uniform = torch.rand(self.logits.shape, generator=generator, dtype=self.logits.dtype)
        gumbel = -torch.log(-torch.log(uniform.clamp(1e-9, 1 - 1e-7)))
        soft = ((self.logits + gumbel) / temperature).softmax(-1)
        hard = torch.nn.functional.one_hot(soft.argmax(-1), soft.shape[-1]).to(soft.dtype)
        return hard + soft - soft.detach()

    def __len__(self) -> int:
        """B, the number of groups."""
        return self.logits.shape[0]

    def __getitem__(self, scenes: Tensor | slice) -> "InteractionGraph":
        """The graphs of the selected groups."""
        unknown = None if self.unknown is None else self.unknown[scenes]
        doubted = None if self.in_doubt is None else self.in_doubt[scenes]
        return replace(self, logits=self.logits[scenes], unknown=unknown, in_doubt=doubted)

    def edges(self, scene: int = 0) -> dict[tuple[int, int], tuple[EdgeType, float]]:
        """`{(sender, receiver): (type in map, its probability)}` of one group, without pairs of type none."""
        types, probs = self.map[scene].tolist(), self.probs[scene].tolist()
        return {
            pair: (self.vocabulary[k], p[k])
            for pair, k, p in zip(self.pairs, types, probs, strict=True)
            if self.vocabulary[k] is not EdgeType.NONE
        }


def incoming(graph: Int[Tensor, "B E"], vehicle: int, vehicles: int) -> tuple[list[int], Int[Tensor, "B S"]]:
    """The other vehicles, and the type indices of their edges into this one."""
    others = [other for other in range(vehicles) if other != vehicle]
    edges = [pairs(vehicles).index((other, vehicle)) for other in others]
    return others, graph[:, edges]
