"""Rewards without semantics, for the ablations GRI-VAIRL and GRI-AIRL (Appendix C).

Networks take the place of the terms in equations (node_reward) and (edge_reward). The reward of type 0 is still 0.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.graph import Vocabulary
from gri.core.layers import mlp
from gri.core.scale import Scale


class NetworkReward(nn.Module):
    """r^n(x_j, a_j) and r^{e,k}(x_i, x_j) as networks; positions along the road enter as differences."""

    offset: Tensor
    unit: Tensor
    action_unit: Tensor

    def __init__(self, scale: Scale, vocabulary: Vocabulary, hidden: int = 32) -> None:
        super().__init__()
        self.vocabulary = vocabulary
        for name, values in (("offset", scale.offset), ("unit", scale.unit), ("action_unit", scale.action)):
            self.register_buffer(name, torch.tensor(values), persistent=False)
        features = len(scale.unit) - 1  # all but the position along the road
        self.vehicle = mlp([features + len(scale.action), hidden, hidden, 1], last_scale=0.1)
        self.relation = mlp([2 * features + 1, hidden, hidden, len(vocabulary) - 1], last_scale=0.1)

    def of_vehicles(
        self, state: Float[Tensor, "*batch D"], action: Float[Tensor, "*batch A"]
    ) -> Float[Tensor, "*batch"]:
        """r^n, the reward of every vehicle alone."""
        return self.vehicle(torch.cat([self._scaled(state), action / self.action_unit], -1))[..., 0]

    def of_edges(
        self, sender: Float[Tensor, "*batch D"], receiver: Float[Tensor, "*batch D"]
    ) -> Float[Tensor, "*batch K"]:
        """r^{e,k} of every ordered pair and edge type; 0 for type 0."""
        gap = (sender - receiver)[..., :1] / self.unit[0]
        reward = self.relation(torch.cat([gap, self._scaled(sender), self._scaled(receiver)], -1))
        return torch.cat([torch.zeros_like(reward[..., :1]), reward], -1)

    def _scaled(self, state: Tensor) -> Tensor:
        return ((state - self.offset) / self.unit)[..., 1:]
