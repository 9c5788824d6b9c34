"""The policy decoder: the action of each vehicle, given the states of all vehicles and the graph (Appendix A).

Feed-forward, equations (policy1)-(policy3), for the synthetic scenes of the paper:

    h_ij = Σ_k 1(z_ij = k)·f_e^k(x_i, x_j),   μ_j = f_v(Σ_{i≠j} h_ij),   a_j ~ N(μ_j, σ²)

Recurrent, equations (rnn1)-(rnn4), for recorded traffic: the messages h_ij also read a hidden state per vehicle, which
a GRU cell carries from step to step.

Positions along the road enter as differences only. In the paper's literal form, type 0 ("no interaction") sends
messages as well and f_v does not read the vehicle's own state, so that a vehicle sees its neighbours even over edges of
type 0. By default (`none_is_silent`) type 0 sends nothing and f_v reads the vehicle's own state instead
(docs/decisions/007-type-zero.md).

This file is the definition. The program runs `gri.networks.fast_decoder`, which computes the same faster.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import linear, silu

from gri.core.graph import vehicle_count
from gri.core.layers import edge_ends, mlp
from gri.core.scale import Scale

DenseGraph = Float[Tensor, "B N R K"]
"""One-hot edge types by sender and receiver; the R receivers are the driven vehicles, the first R of the N."""
Act = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""(state [B, N, D], memory [B, R, H]) -> (mean action [B, R, A], memory for the next step)."""


class DecoderConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Size and form of the policy decoder."""

    kind: Literal["feed_forward", "recurrent"] = "feed_forward"
    hidden: int = 64
    """Units per hidden layer."""
    none_is_silent: bool = True
    """Edges of type 0 send no message, and the node network reads the vehicle's own state."""
    log_sigma: float = -1.0
    """Logarithm of the standard deviation of the scaled action, at the start of training."""
    learn_sigma: bool = True
    """Train the standard deviation; else it stays at its start."""


def dense(
    edges: Float[Tensor, "B E K"], pairs: Sequence[tuple[int, int]] | None = None, vehicles: int = 0
) -> DenseGraph:
    """One-hot edge types [B, E, K] as a matrix [B, N, N, K] over (sender, receiver) with an empty diagonal.

    They are those of all ordered pairs, or of the given candidate pairs among so many vehicles.
    """
    n = vehicle_count(edges.shape[1]) if pairs is None else vehicles
    senders, receivers = (
        edge_ends(n) if pairs is None else torch.tensor(pairs, dtype=torch.long).reshape(-1, 2).unbind(1)
    )
    matrix = edges.new_zeros(edges.shape[0], n, n, edges.shape[2])
    return matrix.index_put((torch.arange(len(edges))[:, None], senders, receivers), edges)


class Decoder(nn.Module):
    """Gaussian policy: the mean action of every driven vehicle, and one standard deviation per action feature."""

    offset: Tensor
    unit: Tensor
    action_unit: Tensor

    def __init__(self, config: DecoderConfig, scale: Scale, edge_types: int) -> None:
        super().__init__()
        self.config = config
        features, actions = len(scale.unit), len(scale.action)
        self.register_buffer("offset", torch.tensor((0.0, *scale.offset[1:])), persistent=False)
        self.register_buffer("unit", torch.tensor(scale.unit), persistent=False)
        self.register_buffer("action_unit", torch.tensor(scale.action), persistent=False)
        body = FeedForward if config.kind == "feed_forward" else Recurrent
        self.body = body(config, features, actions, edge_types)
        self.log_sigma = nn.Parameter(torch.full((actions,), config.log_sigma), config.learn_sigma)

    @property
    def memory_size(self) -> int:
        """H, the size of the hidden state per vehicle; 0 for the feed-forward form."""
        return self.body.memory_size

    @property
    def sigma(self) -> Float[Tensor, " A"]:
        """Standard deviation of the action, in SI units."""
        return self.log_sigma.clamp(-5, 2).exp() * self.action_unit

    def bind(self, graph: DenseGraph, detach_senders: bool = False) -> Act:
        """The policy under one graph, as the equations have it; states and actions are in SI units.

        `detach_senders` cuts the gradient through the states of senders: the action of a vehicle then gets no gradient
        for what it makes other vehicles do.
        """
        step = self.body.bind(graph, detach_senders)

        def act(state: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
            action, memory = step((state - self.offset) / self.unit, memory)
            return action * self.action_unit, memory

        return act


class EdgeNetworks(nn.Module):
    """One edge network f_e^k with two layers per type; one matrix product per layer computes all types.

    The one-hot graph masks the hidden layer. The second layers of all types are then one product. This equals the sum
    over types only where the graph is one-hot.
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

    def first_layer(self) -> tuple[Tensor, Tensor]:
        """Weights [types·H, inputs] for the sender and for the receiver; the first feature enters as a difference."""
        weight = self.sender.weight
        return weight, torch.cat([-weight[:, :1], self.receiver.weight], 1)

    def bind(self, graph: DenseGraph) -> "MessageSum":
        """The second half of the edge networks under one graph."""
        z = graph[..., self.first_type :]
        mask = z.repeat_interleave(self.hidden, -1)
        return MessageSum(mask, (z @ self.second_bias).flatten(0, 2), self.second.weight.T)


@dataclass(frozen=True)
class MessageSum:
    """Σ_i h_ij: first layers of sender [B, N, types·H] and receiver [B, R, types·H] -> sum of messages [B, R, H]."""

    mask: Float[Tensor, "B N R W"]
    """W = types·H."""
    bias: Float[Tensor, "pairs H"]
    """One row for each of the B·N·R pairs."""
    second: Float[Tensor, "W H"]

    def __call__(self, sender: Tensor, receiver: Tensor) -> Tensor:
        b, n, r, width = self.mask.shape
        hidden = silu(sender[:, :, None] + receiver[:, None]) * self.mask
        messages = silu(torch.addmm(self.bias, hidden.reshape(b * n * r, width), self.second))
        return messages.reshape(b, n, r, -1).sum(1)


class FeedForward(nn.Module):
    """Equations (policy1)-(policy3)."""

    memory_size = 0

    def __init__(self, config: DecoderConfig, features: int, actions: int, edge_types: int) -> None:
        super().__init__()
        self.messages = EdgeNetworks(features, config.hidden, edge_types, config.none_is_silent)
        self.own = nn.Linear(features - 1, config.hidden, bias=False) if config.none_is_silent else None
        self.node = mlp([config.hidden, config.hidden, config.hidden, actions], last_scale=0.1)

    def bind(self, graph: DenseGraph, detach_senders: bool = False) -> Act:
        """(scaled state, memory) -> (scaled action, the same memory) under one graph."""
        sender, receiver = self.messages.first_layer()
        sum_messages, driven = self.messages.bind(graph), graph.shape[2]

        def step(state: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
            sent = linear(state.detach() if detach_senders else state, sender, self.messages.sender.bias)
            own = state[:, :driven]
            hidden = self.node[0](sum_messages(sent, linear(own, receiver)))
            if self.own is not None:
                hidden = hidden + self.own(own[..., 1:])
            return self.node[1:](hidden), memory

        return step


class Recurrent(nn.Module):
    """Equations (rnn1)-(rnn4).

    Messages also read the present state (x_ij of equation gnn-1), so that no message is one step late.
    """

    def __init__(self, config: DecoderConfig, features: int, actions: int, edge_types: int) -> None:
        super().__init__()
        self.memory_size = config.hidden
        self.messages = EdgeNetworks(features + config.hidden, config.hidden, edge_types, config.none_is_silent)
        self.cell = nn.GRUCell(config.hidden + features - 1, config.hidden)
        self.out = mlp([config.hidden, config.hidden, actions], last_scale=0.1)

    def bind(self, graph: DenseGraph, detach_senders: bool = False) -> Act:
        """(scaled state, memory) -> (scaled action, memory for the next step) under one graph."""
        sender, receiver = self.messages.first_layer()
        sum_messages, driven = self.messages.bind(graph), graph.shape[2]

        def step(state: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
            # Vehicles that are not driven have no hidden state: they send zeros.
            hidden = torch.cat([memory, state.new_zeros(len(state), state.shape[1] - driven, self.memory_size)], 1)
            node = torch.cat([state, hidden], -1)
            sent = linear(node.detach() if detach_senders else node, sender, self.messages.sender.bias)
            messages = sum_messages(sent, linear(node[:, :driven], receiver))
            inputs = torch.cat([messages, state[:, :driven, 1:]], -1)
            memory = self.cell(inputs.flatten(0, 1), memory.flatten(0, 1)).unflatten(0, memory.shape[:2])
            return self.out(memory), memory

        return step
