"""Scenes on two lanes in which it is known, step by step, which vehicle reacts to which.

The type is independent of where scenes come from: a simulation of this room, SUMO, or a file.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import max_pool1d, pad

from gri.core.edges import LANE_CHANGING, EdgeType, pairs

NONE, FOLLOW, YIELD, CUT_IN = (
    LANE_CHANGING.index(kind) for kind in (EdgeType.NONE, EdgeType.FOLLOW, EdgeType.YIELD, EdgeType.CUT_IN)
)
MERGER, LAG, LEADER = "merger", "lag", "leader"
SHORTEST = 1.0  # [s] that a relation must last in all to be in the graph of a scene


@dataclass(frozen=True)
class LaneScenes:
    """S scenes of N vehicles at T instants; SI units.

    The frame lies in the target lane: y is 0 at its centre and grows to the left. The lane in which the merger begins
    has its centre at −`lane_width`; changes to the right are mirrored.
    """

    state: Float[Tensor, "S N T 4"]
    """x of the front bumper [m], y [m], speed along the road v [m/s], heading [rad]."""
    lane_width: Float[Tensor, " S"]
    length: Float[Tensor, "S N"]
    relations: Int[Tensor, "S T E"]
    """How the receiver of each ordered pair reacts to the sender from this instant to the next: an index into
    `LANE_CHANGING`."""
    kind: tuple[str, ...]
    """What each scene is, such as "merge"; S names."""
    roles: tuple[str, ...]
    """Of the N vehicles: "merger", "lag" (behind the gap in the target lane) or "leader" (ahead of it)."""
    acceptance: Float[Tensor, " S"]
    """Share of the drawn scenes of the same kind and drivers that were kept; the others had a contact or no change."""
    dt: float = 0.2

    def __post_init__(self) -> None:
        scenes, n, steps, _ = self.state.shape
        assert len(self.roles) == n, f"got {len(self.roles)} roles, wanted {n}, one per vehicle"
        assert len(self.kind) == scenes, f"got {len(self.kind)} kinds, wanted {scenes}, one per scene"
        assert self.relations.shape == (scenes, steps, n * (n - 1)), f"{self.relations.shape} does not fit the states"

    def __len__(self) -> int:
        return len(self.state)

    def __getitem__(self, rows: Int[Tensor, " R"]) -> "LaneScenes":
        """The selected scenes."""
        return LaneScenes(
            self.state[rows],
            self.lane_width[rows],
            self.length[rows],
            self.relations[rows],
            tuple(self.kind[row] for row in rows.tolist()),
            self.roles,
            self.acceptance[rows],
            self.dt,
        )

    def graph(self) -> Int[Tensor, "S E"]:
        """One graph per scene: see `summary_graph`."""
        return summary_graph(self.relations, self.dt)

    def without(self, role: str) -> "LaneScenes":
        """The same scenes without the vehicle of this role, which is then one that nobody sees."""
        n, gone = len(self.roles), self.roles.index(role)
        kept = [vehicle for vehicle in range(n) if vehicle != gone]
        edges = [edge for edge, pair in enumerate(pairs(n)) if gone not in pair]
        return LaneScenes(
            self.state[:, kept],
            self.lane_width,
            self.length[:, kept],
            self.relations[..., edges],
            self.kind,
            tuple(self.roles[vehicle] for vehicle in kept),
            self.acceptance,
            self.dt,
        )


def joined(parts: Sequence[LaneScenes]) -> LaneScenes:
    """Scenes of the same vehicles and sampling time, one part after the other."""
    first = parts[0]
    assert all(part.roles == first.roles and part.dt == first.dt for part in parts), "parts have different vehicles"
    return LaneScenes(
        torch.cat([part.state for part in parts]),
        torch.cat([part.lane_width for part in parts]),
        torch.cat([part.length for part in parts]),
        torch.cat([part.relations for part in parts]),
        tuple(kind for part in parts for kind in part.kind),
        first.roles,
        torch.cat([part.acceptance for part in parts]),
        first.dt,
    )


def summary_graph(relations: Int[Tensor, "S T E"], dt: float) -> Int[Tensor, "S E"]:
    """For each pair the relation other than "none" that lasts longest in all.

    It is "none" if no relation lasts `SHORTEST` seconds; of equally long ones the first of `LANE_CHANGING` counts.
    """
    steps = torch.stack([(relations == kind).sum(1) for kind in range(1, len(LANE_CHANGING))], -1)
    longest = steps.max(-1)
    return torch.where(longest.values * dt >= SHORTEST - 1e-9, longest.indices + 1, NONE)


def role_pairs(roles: Sequence[str]) -> list[tuple[str, str]]:
    """(role of the sender, role of the receiver) of all ordered pairs."""
    return [(roles[i], roles[j]) for i, j in pairs(len(roles))]


def pairs_that_may_react(roles: Sequence[str]) -> list[int]:
    """Edges whose receiver may react to somebody of the scene; the leader has nobody ahead of it."""
    return [edge for edge, (_, receiver) in enumerate(role_pairs(roles)) if receiver != LEADER]


def pairs_of_merger(roles: Sequence[str]) -> list[int]:
    """Edges from and into the merger, without those into the leader."""
    return [edge for edge in pairs_that_may_react(roles) if MERGER in role_pairs(roles)[edge]]


def close_gaps(types: Int[Tensor, "S T E"], steps: int) -> Int[Tensor, "S T E"]:
    """Fill interruptions of a relation that last at most `steps` steps and are "none"."""
    reach = (steps + 1) // 2
    found = types
    for kind in range(1, len(LANE_CHANGING)):
        is_kind = (types == kind).transpose(1, 2).float()
        wide = max_pool1d(is_kind, 2 * reach + 1, stride=1, padding=reach)
        wide = pad(wide, (reach, reach))  # beyond the ends nothing holds
        closed = -max_pool1d(-wide, 2 * reach + 1, stride=1)
        found = torch.where((found == NONE) & (closed.transpose(1, 2) > 0), kind, found)
    return found


def shares(types: Int[Tensor, "*shape"], kinds: int = len(LANE_CHANGING)) -> list[float]:
    """How often each type occurs."""
    return (torch.bincount(types.flatten(), minlength=kinds).double() / max(types.numel(), 1)).tolist()


def balanced_steps(
    relations: Int[Tensor, "S T E"], edges: Iterable[int], first: int, most: float, seed: int
) -> Bool[Tensor, "S T E"]:
    """Which steps of which pairs are scored, so that no type has more than the share `most` of a pair's scored steps.

    Steps from `first` on count. Of each pair's most frequent type, steps are left out at random.
    """
    generator = torch.Generator().manual_seed(seed)
    scored = torch.zeros(relations.shape, dtype=torch.bool)
    for edge in edges:
        types = relations[:, first:, edge]
        order = torch.rand(types.shape, generator=generator)
        counts = torch.bincount(types.flatten(), minlength=len(LANE_CHANGING))
        frequent = int(counts.argmax())
        rest = types.numel() - int(counts[frequent])
        kept = min(int(counts[frequent]), int(rest * most / (1 - most)))
        is_frequent = types == frequent
        rank = torch.where(is_frequent, order, torch.inf).flatten().argsort().argsort().reshape(types.shape)
        scored[:, first:, edge] = ~is_frequent | (rank < kept)
    return scored
