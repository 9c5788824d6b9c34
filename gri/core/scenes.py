"""Scenes: a batch of demonstrations with their graphs, of whatever origin; what models are trained and tested on."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Scenes:
    """Demonstrations: states, the actions of the driven vehicles, and the true graph as type indices."""

    state: Float[Tensor, "S N T D"]
    action: Float[Tensor, "S R T-1 A"]
    graph: Int[Tensor, "S E"]
    history: Float[Tensor, "S N H D"] | None = None
    """What was seen before anybody in question drove, the start included; None: the scene itself is all there is."""

    def __len__(self) -> int:
        return len(self.state)

    def __getitem__(self, scenes: Tensor | slice) -> "Scenes":
        history = None if self.history is None else self.history[scenes]
        return Scenes(self.state[scenes], self.action[scenes], self.graph[scenes], history)

    @property
    def seen(self) -> Float[Tensor, "S N H D"]:
        """What the graph is to be inferred from."""
        return self.state if self.history is None else self.history

    @property
    def start(self) -> Float[Tensor, "S N D"]:
        return self.state[:, :, 0]

    @property
    def leader(self) -> Float[Tensor, "S T D"]:
        return self.state[:, -1]

    def one_hot(self, types: int) -> Float[Tensor, "S E K"]:
        return torch.nn.functional.one_hot(self.graph, types).float()
