"""The structured reward: a weighted sum of named terms per vehicle and edge type (Sec. IV, VI-C), and its shaped form.

    r_j = −Σ_m (1 + e^ξ_m)·f_m(x_j, a_j) − Σ_{i≠j} Σ_{k≥1} 1(z_ij = k) Σ_m (1 + e^ψ_km)·g_km(x_i, x_j)

The "1 +" forces every term to be used, so that the units of the terms matter: term m is divided by its unit, e.g. g_IDM
by (5 m)². The sum is multiplied by the temperature. The reward of edge type 0 is 0. `gri.rewards.terms` lists all terms
by scenario and edge type.
"""

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.graph import EdgeType, vehicle_count
from gri.core.layers import edge_ends, incidence, mlp
from gri.core.scale import Scale
from gri.errors import InputError
from gri.rewards.terms import AnyRewardConfig as AnyRewardConfig
from gri.rewards.terms import AssumedReward as AssumedReward
from gri.rewards.terms import LaneRewardConfig as LaneRewardConfig
from gri.rewards.terms import NaturalisticConfig as NaturalisticConfig
from gri.rewards.terms import RewardConfig as RewardConfig
from gri.rewards.terms import Units as Units
from gri.rewards.terms import constants_of, references_of, terms_of
from gri.rewards.unstructured import NetworkReward


class StructuredReward(nn.Module):
    """The reward with its weights: `psi` has one vector for the vehicle alone, "node", and one per edge type.

    `log_alpha` is the logarithm of the drivers' rationality, which multiplies the reward in likelihoods of actions.
    """

    def __init__(self, config: AnyRewardConfig) -> None:
        super().__init__()
        self.config = config
        self.references = references_of(config)
        self.constants = constants_of(config)
        self.terms, self.vocabulary = terms_of(config, self.references, self.constants)
        sizes = {"node": len(self.terms.node)} | {str(k): len(terms) for k, terms in self.terms.edge.items()}
        self.psi = nn.ParameterDict({name: nn.Parameter(torch.zeros(size)) for name, size in sizes.items()})
        self.log_alpha = nn.Parameter(torch.zeros(()))

    @classmethod
    def with_weights(cls, config: AnyRewardConfig, weights: Mapping[str, Mapping[str, float]]) -> "StructuredReward":
        """The reward with given weights 1 + e^ψ per group ("node" or an edge type); weights of other groups are 2.

        Raises `InputError` if a group is unknown, if the names are not those of its terms, or if a weight is 1 or less.
        """
        reward = cls(config)
        for group, values in weights.items():
            if group not in reward.psi or set(values) != set(reward.names(group)):
                wanted = {name: reward.names(name) for name in reward.psi}
                raise InputError(f"got weights of {group}: {', '.join(values)}; wanted all terms of one of {wanted}")
            excess = torch.tensor([values[name] for name in reward.names(group)]) - 1
            if not (excess > 0).all():
                raise InputError(f"got weights of {group}: {dict(values)}; weights are 1 + e^psi, wanted all above 1")
            reward.psi[group].data = excess.log()
        return reward

    def in_double(self) -> "StructuredReward":
        """A copy in double precision with fixed weights: in single precision, rounding errors stop line searches."""
        copy = StructuredReward(self.config)
        copy.load_state_dict(self.state_dict())
        return copy.double().requires_grad_(False)

    def names(self, group: str) -> tuple[str, ...]:
        """Names of the terms of a group: "node" or an edge type."""
        return tuple(self.terms.node if group == "node" else self.terms.edge[EdgeType(group)])

    def weights(self, group: str) -> Float[Tensor, " terms"]:
        """temperature·(1 + e^ψ) of the terms of a group."""
        return self.config.temperature * (1 + self.psi[group].exp())

    def node_features(
        self, state: Float[Tensor, "*batch D"], action: Float[Tensor, "*batch A"]
    ) -> Float[Tensor, "*batch terms"]:
        """The terms of the vehicle alone, before their weights."""
        return torch.stack([term(state, action) for term in self.terms.node.values()], -1)

    def edge_features(
        self, kind: EdgeType, sender: Float[Tensor, "*batch D"], receiver: Float[Tensor, "*batch D"]
    ) -> Float[Tensor, "*batch terms"]:
        """The terms of one edge type, before their weights."""
        return torch.stack([term(sender, receiver) for term in self.terms.edge[kind].values()], -1)

    def of_vehicles(self, state: Float[Tensor, "B N T D"], action: Float[Tensor, "B N T A"]) -> Float[Tensor, "B N T"]:
        """r^n, the reward of every vehicle alone, at every step."""
        return -self.node_features(state, action) @ self.weights("node")

    def of_edges(
        self, sender: Float[Tensor, "B E T D"], receiver: Float[Tensor, "B E T D"]
    ) -> Float[Tensor, "B E T K"]:
        """r^{e,k} of every ordered pair, step and edge type; 0 for types without terms."""
        zero = sender.new_zeros(sender.shape[:-1])
        return torch.stack(
            [
                -self.edge_features(k, sender, receiver) @ self.weights(k) if k in self.terms.edge else zero
                for k in self.vocabulary
            ],
            -1,
        )

    def forward(
        self,
        state: Float[Tensor, "B N T D"],
        action: Float[Tensor, "B N T A"],
        graph: Float[Tensor, "B E K"],
        cooperative: bool = True,
    ) -> Float[Tensor, "B N T"]:
        """r_j of every vehicle and step, linear in the one-hot or soft graph.

        Without `cooperative`, there is no gradient through the states of senders: a vehicle does not change its motion
        to improve the reward of others.
        """
        senders, receivers = edge_ends(vehicle_count(graph.shape[1]))
        sent = state[:, senders] if cooperative else state[:, senders].detach()
        edges = (self.of_edges(sent, state[:, receivers]) * graph[:, :, None]).sum(-1)  # Shape: (B, E, T)
        return self.of_vehicles(state, action) + incidence(state.shape[1]).to(edges) @ edges


class ShapedReward(nn.Module):
    """The shaped reward f = r + h(x') − h(x) of the discriminator (Sec. V-A, equations node_reward and edge_reward).

    There is one potential h for the vehicle alone and one per edge type, and a learned constant. The constant takes the
    place of the logarithm of the partition function, which potentials cannot express.
    """

    offset: Tensor
    unit: Tensor

    def __init__(self, reward: StructuredReward | NetworkReward, scale: Scale, hidden: int = 32) -> None:
        super().__init__()
        self.reward = reward
        features = len(scale.unit)
        self.register_buffer("offset", torch.tensor(scale.offset), persistent=False)
        self.register_buffer("unit", torch.tensor(scale.unit), persistent=False)
        self.vehicle = mlp([features - 1, hidden, hidden, 1])
        kinds = len(reward.vocabulary) - 1
        self.relation = mlp([2 * features - 1, hidden, hidden, kinds])
        self.bias = nn.Parameter(torch.zeros(()))

    def potentials(self, state: Float[Tensor, "B N T D"]) -> tuple[Float[Tensor, "B N T"], Float[Tensor, "B E T K"]]:
        """h^n of every vehicle and h^{e,k} of every pair (0 for type 0); they read positions as differences only."""
        senders, receivers = edge_ends(state.shape[1])
        scaled = (state - self.offset) / self.unit
        gap = (state[:, senders, :, :1] - state[:, receivers, :, :1]) / self.unit[0]
        pair = torch.cat([gap, scaled[:, senders, :, 1:], scaled[:, receivers, :, 1:]], -1)
        edges = self.relation(pair)
        return self.vehicle(scaled[..., 1:])[..., 0], torch.cat([torch.zeros_like(edges[..., :1]), edges], -1)

    def edges(self, state: Float[Tensor, "B N T D"]) -> Float[Tensor, "B E T-1 K"]:
        """f^{e,k} of every ordered pair, step and edge type."""
        senders, receivers = edge_ends(state.shape[1])
        potential = self.potentials(state)[1]
        rewards = self.reward.of_edges(state[:, senders, :-1], state[:, receivers, :-1])
        return rewards + potential[:, :, 1:] - potential[:, :, :-1]

    def forward(
        self,
        state: Float[Tensor, "B N T D"],
        action: Float[Tensor, "B N T-1 A"],
        graph: Float[Tensor, "B E K"],
    ) -> Float[Tensor, "B N T-1"]:
        """f_j of every vehicle and step."""
        vehicle = self.potentials(state)[0]
        node = self.reward.of_vehicles(state[:, :, :-1], action) + vehicle[..., 1:] - vehicle[..., :-1]
        edges = (self.edges(state) * graph[:, :, None]).sum(-1)
        return node + incidence(state.shape[1]).to(edges) @ edges + self.bias
