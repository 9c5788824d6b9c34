"""True graphs of synthetic scenes, and how often each occurs."""

from collections.abc import Mapping

import msgspec

from gri.core.graph import EdgeType
from gri.networks.model import Edge


class GraphShare(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A true graph and its share of the scenes, from 0 to 1."""

    share: float
    edges: tuple[Edge, ...]


def edges(types: Mapping[tuple[int, int], EdgeType]) -> tuple[Edge, ...]:
    """Edges from `{(sender, receiver): type}`; pairs that are not named have no edge."""
    return tuple(Edge(sender=i, receiver=j, type=kind) for (i, j), kind in types.items())


def follow_edges(*pairs: tuple[int, int]) -> tuple[Edge, ...]:
    """Edges over which the receiver follows the sender, from pairs (sender, receiver)."""
    return edges({pair: EdgeType.FOLLOW for pair in pairs})
