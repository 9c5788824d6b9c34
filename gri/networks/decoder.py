"""The policy decoders: what each vehicle does, given the state of all and the graph (Appendix A).

Feed-forward (equations policy1-3):  h_ij = Σ_k 1(z_ij = k) f_e^k(x_i, x_j),  μ_j = f_v(Σ_i h_ij),  a_j ~
N(μ_j, σ²) Recurrent (equations rnn1-4):  the messages also read a memory h, and a GRU cell carries it from
step to step.

Longitudinal positions enter as differences only. The paper's literal form sums messages of type 0 ("no
interaction") as well and gives f_v no own state, so that a vehicle sees its neighbours even over edges of
type 0. By default (`none_is_silent`) type 0 sends nothing and f_v reads the vehicle's own state instead.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.array_functions import NUMPY, arrays_of
from gri.core.graph import agents_of
from gri.core.layers import edge_ends, mlp
from gri.core.scale import Scale

DenseGraph = Float[Tensor, "B N R K"]
"""One-hot types over sender and receiver; the receivers are the first R vehicles, those that are to be
driven.
"""
Act = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""(state [B, N, D], memory [B, R, H]) -> (mean action [B, R, A], memory)."""


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
    """Gaussian policy: mean action of every driven vehicle, and a standard deviation that is the same everywhere."""

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
        return self.body.memory_size

    @property
    def sigma(self) -> Float[Tensor, " A"]:
        """Standard deviation of the action, in SI units."""
        return self.log_sigma.clamp(-5, 2).exp() * self.action_unit

    def bind(self, graph: DenseGraph, selfish: bool = False) -> Act:
        """The policy under one graph, with all that does not change from step to step computed once.

        `selfish` cuts the gradient through the states of senders: a vehicle's action then is not blamed for
        what it makes others do.
        """
        step, unit = self.body.bind(graph, self.offset, self.unit, selfish), self.action_unit

        def act(state: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
            action, memory = step(state, memory)
            return action * unit, memory

        return act

    def bind_numpy(self, graph: DenseGraph) -> Callable[[np.ndarray], np.ndarray] | None:
        """The same for states in numpy, of few groups several times as fast; None for a policy with a memory."""
        if not isinstance(self.body, FeedForward):
            return None
        folded, unit = self.body.fold(graph, self.offset, self.unit).numpy(), self.action_unit.numpy()
        return lambda state: folded(state, state) * unit


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

    def first_layer(self) -> tuple[Tensor, Tensor]:
        """Weights of the sender's and of the receiver's share; the first feature enters as a difference."""
        weight = self.sender.weight
        return weight, torch.cat([-weight[:, :1], self.receiver.weight], 1)

    def bind(self, graph: DenseGraph) -> "Receive":
        """What a graph makes of the shares of senders and receivers."""
        z = graph[..., self.first_type :]
        mask = z.repeat_interleave(self.hidden, -1)
        return Receive(mask, (z @ self.second_bias).flatten(0, 2), self.second.weight.T)


@dataclass(frozen=True)
class Receive:
    """Shares of sender [B, N, types·H] and receiver [B, R, types·H] -> sum of messages [B, R, H]; torch or numpy."""

    mask: Any
    bias: Any
    second: Any

    def __call__(self, sender: Any, receiver: Any) -> Any:
        arrays, (b, n, r, width) = arrays_of(sender), self.mask.shape
        hidden = arrays.silu(sender[:, :, None] + receiver[:, None]) * self.mask
        messages = arrays.silu(arrays.add_product(self.bias, hidden.reshape(b * n * r, width), self.second))
        return messages.reshape(b, n, r, -1).sum(1)


@dataclass(frozen=True)
class ReceiveSent:
    """The same in numpy for a graph of few edges: pairs that send nothing, which add nothing, are left out.

    `ends` are scene, sender and receiver of the pairs that send; `mask` and `bias` are theirs.
    """

    ends: tuple[np.ndarray, np.ndarray, np.ndarray]
    mask: np.ndarray
    bias: np.ndarray
    second: np.ndarray
    shape: tuple[int, int, int]
    """Scenes, senders and receivers."""

    @classmethod
    def of(cls, receive: Receive) -> "ReceiveSent":
        mask, bias, second = map(_array, (receive.mask, receive.bias, receive.second))
        scene, sender, receiver = np.nonzero(mask.any(-1))
        of_pair = bias.reshape(*mask.shape[:3], -1)[scene, sender, receiver]
        b, n, r, _ = mask.shape
        return cls((scene, sender, receiver), mask[scene, sender, receiver], of_pair, second, (b, n, r))

    def __call__(self, sender: np.ndarray, receiver: np.ndarray) -> np.ndarray:
        (scene, who, to), (scenes, senders, receivers) = self.ends, self.shape
        hidden = NUMPY.silu(sender[scene, who] + receiver[scene, to]) * self.mask
        messages = np.zeros((senders, scenes, receivers, self.second.shape[1]), dtype=hidden.dtype)
        messages[who, scene, to] = NUMPY.silu(NUMPY.add_product(self.bias, hidden, self.second))
        return messages.sum(0)


class FeedForward(nn.Module):
    """Equations (policy1)-(policy3)."""

    memory_size = 0

    def __init__(self, config: DecoderConfig, features: int, actions: int, edge_types: int) -> None:
        super().__init__()
        self.messages = Messages(features, config.hidden, edge_types, config.none_is_silent)
        self.own = nn.Linear(features - 1, config.hidden, bias=False) if config.none_is_silent else None
        self.node = mlp([config.hidden, config.hidden, config.hidden, actions], last_scale=0.1)

    def bind(self, graph: DenseGraph, offset: Tensor, unit: Tensor, selfish: bool) -> Act:
        folded = self.fold(graph, offset, unit)
        return lambda state, memory: (folded(state, state.detach() if selfish else state), memory)

    def fold(self, graph: DenseGraph, offset: Tensor, unit: Tensor) -> "Folded":
        """Folds units, both shares of the first edge layer and the own state's layer into one product."""
        first, *later = [layer for layer in self.node if isinstance(layer, nn.Linear)]
        sender, receiver = self.messages.first_layer()
        own = nn.functional.pad(self.own.weight, (1, 0)) if self.own else 0 * sender[: len(first.bias)]
        weight = torch.cat([sender, receiver, own]) / unit
        edge_bias = self.messages.sender.bias
        bias = torch.cat([edge_bias, torch.zeros_like(edge_bias), first.bias]) - weight @ offset
        return Folded(
            shares=(weight, bias),
            ends=(len(sender), len(sender) + len(receiver)),
            vehicles=graph.shape[2],
            receive=self.messages.bind(graph),
            summed=first.weight,
            later=tuple((layer.weight, layer.bias) for layer in later),
        )


@dataclass(frozen=True)
class Folded:
    """The feed-forward policy under one graph: what each step multiplies its states with; torch or numpy.

    `shares` are the weight and bias of a state's shares in what senders, receivers and the vehicle's own hidden layer
    add up; they end at `ends`. `summed` is the weight of the messages in that layer, `later` are the layers behind it.
    """

    shares: tuple[Any, Any]
    ends: tuple[int, int]
    vehicles: int
    """How many are driven."""
    receive: Receive | ReceiveSent
    summed: Any
    later: tuple[tuple[Any, Any], ...]

    def __call__(self, state: Any, senders: Any) -> Any:
        """Mean action [B, R, A] in units of the action; `senders` is the state that others are told of."""
        arrays, (sent, received) = arrays_of(state), self.ends
        shares, vehicles = arrays.linear(state, *self.shares), self.vehicles
        told = shares[..., :sent]
        if senders is not state:
            told = arrays.linear(senders, self.shares[0][:sent], self.shares[1][:sent])
        hidden = self.receive(told, shares[:, :vehicles, sent:received])
        hidden = arrays.linear(hidden, self.summed) + shares[:, :vehicles, received:]
        for layer in self.later:
            hidden = arrays.linear(arrays.silu(hidden), *layer)
        return hidden

    def numpy(self) -> "Folded":
        """The same in numpy."""
        shares, later = tuple(map(_array, self.shares)), tuple((_array(w), _array(b)) for w, b in self.later)
        assert isinstance(self.receive, Receive), "it is in numpy already"
        sent = ReceiveSent.of(self.receive)
        return Folded((shares[0], shares[1]), self.ends, self.vehicles, sent, _array(self.summed), later)


def _array(value: Tensor) -> np.ndarray:
    return value.detach().numpy()


class Recurrent(nn.Module):
    """Equations (rnn1)-(rnn4); messages also read the relative state (x_ij of gnn-1): none is late."""

    def __init__(self, config: DecoderConfig, features: int, actions: int, edge_types: int) -> None:
        super().__init__()
        self.memory_size = config.hidden
        self.messages = Messages(features + config.hidden, config.hidden, edge_types, config.none_is_silent)
        self.cell = nn.GRUCell(config.hidden + features - 1, config.hidden)
        self.out = mlp([config.hidden, config.hidden, actions], last_scale=0.1)

    def bind(self, graph: DenseGraph, offset: Tensor, unit: Tensor, selfish: bool) -> Act:
        sender, receiver = self.messages.first_layer()
        receive, vehicles = self.messages.bind(graph), graph.shape[2]

        def step(state: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
            scaled = (state - offset) / unit
            silent = state.new_zeros(len(state), state.shape[1] - vehicles, self.memory_size)
            node = torch.cat([scaled, torch.cat([memory, silent], 1)], -1)
            sent = nn.functional.linear(node.detach() if selfish else node, sender, self.messages.sender.bias)
            messages = receive(sent, nn.functional.linear(node[:, :vehicles], receiver))
            inputs = torch.cat([messages, scaled[:, :vehicles, 1:]], -1)
            memory = self.cell(inputs.flatten(0, 1), memory.flatten(0, 1)).unflatten(0, memory.shape[:2])
            return self.out(memory), memory

        return step
