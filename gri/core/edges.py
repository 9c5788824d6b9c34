"""Edge types, their vocabularies, and the order of ordered pairs; needs no torch (Sec. IV, VI-C, VI-D).

Pairs are in lexicographic order (sender, receiver); see `gri.core.graph`.
"""

from enum import StrEnum


class EdgeType(StrEnum):
    """How the receiver reacts to the sender (Sec. VI-C): it follows it, yields to it, or cuts in front of it."""

    NONE = "none"
    FOLLOW = "follow"
    YIELD = "yield"
    CUT_IN = "cut_in"


Vocabulary = tuple[EdgeType, ...]
"""The edge types of a model, in the order of their indices k; index 0 is `NONE`."""
FOLLOWING: Vocabulary = (EdgeType.NONE, EdgeType.FOLLOW)
"""Car following (Sec. VI-C)."""
YIELDING: Vocabulary = (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD)
"""Lane changes in recorded traffic, without cut-ins, as in the paper (Sec. VI-D)."""
LANE_CHANGING: Vocabulary = (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN)
"""Synthetic lane changing and merges (Sec. VI-C)."""


def pairs(n: int) -> list[tuple[int, int]]:
    """All ordered pairs (sender, receiver) of n vehicles, in the order of the edge axis of a complete graph."""
    return [(i, j) for i in range(n) for j in range(n) if i != j]


MOST_COMPLETE = 3
"""A graph is complete on at most so many vehicles; on more it has candidate pairs only."""


def vehicle_count(edges: int) -> int:
    """The number of vehicles N of E = N(N−1) ordered pairs."""
    n = int((1 + (1 + 4 * edges) ** 0.5) / 2)
    assert n * (n - 1) == edges, f"{edges} is not N(N-1) for any N"
    return n
