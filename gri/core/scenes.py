"""Scenes: a batch of demonstrations with their true graphs, on which models are trained and tested."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Scenes:
    """S demonstrations: states of N vehicles, actions of the R driven ones, true graphs as type indices; SI units."""

    state: Float[Tensor, "S N T D"]
    action: Float[Tensor, "S R T-1 A"]
    graph: Int[Tensor, "S E"]
    history: Float[Tensor, "S N H D"] | None = None
    """H states up to and including the start of the scene; None: there is no history, and graphs are inferred from the
    scene itself.
    """

    def __len__(self) -> int:
        """S, the number of scenes."""
        return len(self.state)

    def __getitem__(self, scenes: Tensor | slice) -> "Scenes":
        """The selected scenes."""
        history = None if self.history is None else self.history[scenes]
        return Scenes(self.state[scenes], self.action[scenes], self.graph[scenes], history)

    @property
    def observed(self) -> Float[Tensor, "S N H D"]:
        """The states from which the graph is inferred: the history, or the scene itself."""
        return self.state if self.history is None else self.history

    @property
    def start(self) -> Float[Tensor, "S N D"]:
        """The states at the start of the scenes."""
        return self.state[:, :, 0]

    @property
    def leader(self) -> Float[Tensor, "S T D"]:
        """The states of the leader, the last vehicle."""
        return self.state[:, -1]

    def one_hot(self, types: int) -> Float[Tensor, "S E K"]:
        """The true graphs as one-hot vectors of K = `types` edge types."""
        return torch.nn.functional.one_hot(self.graph, types).float()
