"""Types of edges, their vocabularies, and the order of ordered pairs; needs no torch.

The E = N(N−1) ordered pairs stand in lexicographic order (sender, receiver); see `gri.core.graph`.
"""

from enum import StrEnum


class EdgeType(StrEnum):
    """What the receiver does towards the sender (Sec. VI-C)."""

    NONE = "none"
    FOLLOW = "follow"
    YIELD = "yield"
    CUT_IN = "cut_in"


Vocabulary = tuple[EdgeType, ...]
FOLLOWING: Vocabulary = (EdgeType.NONE, EdgeType.FOLLOW)
YIELDING: Vocabulary = (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD)
"""Lane changes in recorded traffic: without cutting in, as the paper has it (Sec. VI-D)."""
LANE_CHANGING: Vocabulary = (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN)


def pairs(n: int) -> list[tuple[int, int]]:
    """All ordered pairs (sender, receiver) of n vehicles, in the order of the edge axis."""
    return [(i, j) for i in range(n) for j in range(n) if i != j]


def vehicle_count(edges: int) -> int:
    """N for a number of ordered pairs E = N(N−1)."""
    n = int((1 + (1 + 4 * edges) ** 0.5) / 2)
    assert n * (n - 1) == edges, f"{edges} is not N(N-1) for any N"
    return n
