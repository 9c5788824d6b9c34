"""The policy decoders: what each vehicle does, given the state of all and the graph (Appendix A).

Feed-forward (equations policy1-3):  h_ij = Σ_k 1(z_ij = k) f_e^k(x_i, x_j),  μ_j = f_v(Σ_i h_ij),  a_j ~
N(μ_j, σ²) Recurrent (equations rnn1-4):  the messages also read a memory h, and a GRU cell carries it from
step to step.

Longitudinal positions enter as differences only. The paper's literal form sums messages of type 0 ("no
interaction") as well and gives f_v no own state, so that a vehicle sees its neighbours even over edges of
type 0. By default (`none_is_silent`) type 0 sends nothing and f_v reads the vehicle's own state instead.
"""

from typing import Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.graph import agents_of
from gri.neural import edge_ends, mlp
from gri.scale import Scale

DenseGraph = Float[Tensor, "B N N K"]


class DecoderConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Size and form of the policy decoder."""

    kind: Literal["feed_forward", "recurrent"] = "feed_forward"
    hidden: int = 64
    none_is_silent: bool = True
    log_sigma: float = -1.0
    """Logarithm of the standard deviation of the scaled action, at the start of training."""
    learn_sigma: bool = True


def dense(edges: Float[Tensor, "B E K"]) -> DenseGraph:
    """One-hot edge types as a matrix over (sender, receiver) with an empty diagonal."""
    n = agents_of(edges.shape[1])
    senders, receivers = edge_ends(n)
    matrix = edges.new_zeros(edges.shape[0], n, n, edges.shape[2])
    return matrix.index_put((torch.arange(len(edges))[:, None], senders, receivers), edges)


class Decoder(nn.Module):
    """Gaussian policy: mean action of every vehicle, with a standard deviation that does not depend on the
    state.
    """

    offset: Tensor
    unit: Tensor
    action_unit: Tensor
    position: Tensor

    def __init__(self, config: DecoderConfig, scale: Scale, edge_types: int) -> None:
        super().__init__()
        self.config = config
        features, actions = len(scale.unit), len(scale.action)
        self.register_buffer("offset", torch.tensor(scale.offset), persistent=False)
        self.register_buffer("unit", torch.tensor(scale.unit), persistent=False)
        self.register_buffer("action_unit", torch.tensor(scale.action), persistent=False)
        self.register_buffer("position", torch.eye(features)[0], persistent=False)
        body = FeedForward if config.kind == "feed_forward" else Recurrent
        self.body = body(config, features, actions, edge_types)
        self.log_sigma = nn.Parameter(torch.full((actions,), config.log_sigma), config.learn_sigma)

    @property
    def memory_size(self) -> int:
        return self.body.memory_size

    @property
    def sigma(self) -> Float[Tensor, " A"]:
        """Standard deviation of the action, in SI units."""
        return self.log_sigma.clamp(-5, 2).exp() * self.action_unit

    def forward(
        self, state: Float[Tensor, "B N D"], graph: DenseGraph, memory: Float[Tensor, "B N H"]
    ) -> tuple[Float[Tensor, "B N A"], Float[Tensor, "B N H"]]:
        # Positions relative to the last vehicle: only differences count, and float32 keeps its digits.
        scaled = (state - state[:, -1:] * self.position - self.offset) / self.unit
        action, memory = self.body(scaled, graph, memory)
        return action * self.action_unit, memory


class Messages(nn.Module):
    """One two-layer edge network f_e^k per type, all types fused into one matrix product per layer.

    The one-hot graph masks the hidden layer, after which the second layers of all types are one product. This
    equals the sum over types only where the graph is one-hot.
    """

    def __init__(self, inputs: int, hidden: int, edge_types: int, none_is_silent: bool) -> None:
        super().__init__()
        self.first_type = 1 if none_is_silent else 0
        self.hidden = hidden
        types = edge_types - self.first_type
        self.sender = nn.Linear(inputs, types * hidden)
        self.receiver = nn.Linear(inputs - 1, types * hidden, bias=False)
        self.second = nn.Linear(types * hidden, hidden, bias=False)
        self.second_bias = nn.Parameter(torch.zeros(types, hidden))
        with torch.no_grad():
            self.second.weight.mul_(types**0.5)  # as if each type had its own layer

    def forward(self, node: Float[Tensor, "B N I"], graph: DenseGraph) -> Float[Tensor, "B N H"]:
        """Sum of the messages that reach each vehicle; the first feature enters as a difference."""
        z = graph[..., self.first_type :]
        from_receiver = torch.cat([-self.sender.weight[:, :1], self.receiver.weight], 1)
        sent = self.sender(node)[:, :, None] + (node @ from_receiver.T)[:, None]  # Shape: (B, N, N, types·H)
        masked = (nn.functional.silu(sent).unflatten(-1, (-1, self.hidden)) * z[..., None]).flatten(-2)
        return nn.functional.silu(self.second(masked) + z @ self.second_bias).sum(1)


class FeedForward(nn.Module):
    """Equations (policy1)-(policy3)."""

    memory_size = 0

    def __init__(self, config: DecoderConfig, features: int, actions: int, edge_types: int) -> None:
        super().__init__()
        self.messages = Messages(features, config.hidden, edge_types, config.none_is_silent)
        self.own = features - 1 if config.none_is_silent else 0
        self.node = mlp([config.hidden + self.own, config.hidden, config.hidden, actions], last_scale=0.1)

    def forward(
        self, node: Float[Tensor, "B N D"], graph: DenseGraph, memory: Float[Tensor, "B N 0"]
    ) -> tuple[Float[Tensor, "B N A"], Float[Tensor, "B N 0"]]:
        own = node[..., node.shape[-1] - self.own :]
        return self.node(torch.cat([self.messages(node, graph), own], -1)), memory


class Recurrent(nn.Module):
    """Equations (rnn1)-(rnn4); messages also read the relative state (x_ij of equation gnn-1), so that none
    is late.
    """

    def __init__(self, config: DecoderConfig, features: int, actions: int, edge_types: int) -> None:
        super().__init__()
        self.memory_size = config.hidden
        self.messages = Messages(features + config.hidden, config.hidden, edge_types, config.none_is_silent)
        self.cell = nn.GRUCell(config.hidden + features - 1, config.hidden)
        self.out = mlp([config.hidden, config.hidden, actions], last_scale=0.1)

    def forward(
        self, node: Float[Tensor, "B N D"], graph: DenseGraph, memory: Float[Tensor, "B N H"]
    ) -> tuple[Float[Tensor, "B N A"], Float[Tensor, "B N H"]]:
        received = self.messages(torch.cat([node, memory], -1), graph)
        inputs = torch.cat([received, node[..., 1:]], -1)
        memory = self.cell(inputs.flatten(0, 1), memory.flatten(0, 1)).unflatten(0, memory.shape[:2])
        return self.out(memory), memory
