"""The policy decoder as the program runs it: the values of `gri.networks.decoder`, computed faster.

Begin with `bind` (torch, for training and roll-outs) and `bind_numpy` (for driving a few groups one step on). For the
feed-forward form, `fold` joins units, offsets and all layers that read a state into one matrix product. The recurrent
form is run as it is defined.

Two tests compare the values, up to rounding, in tests/gri/networks/test_fast_decoder.py:
`test_folding_changes_no_action` (folded against defined) and `test_numpy_drives_as_torch_does` (numpy against torch).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.array_functions import NUMPY, functions_for
from gri.networks.decoder import Act, Decoder, DenseGraph, EdgeNetworks, FeedForward, MessageSum

MOST_DENSE = 8  # vehicles; for more, messages are summed pair by pair


def bind(decoder: Decoder, graph: DenseGraph, detach_senders: bool = False) -> Act:
    """`Decoder.bind`, with everything that does not change from step to step computed once."""
    if not isinstance(decoder.body, FeedForward):
        return decoder.bind(graph, detach_senders)
    folded, unit = fold(decoder, decoder.body, graph), decoder.action_unit

    def act(state: Tensor, memory: Tensor) -> tuple[Tensor, Tensor]:
        return folded(state, state.detach() if detach_senders else state) * unit, memory

    return act


@dataclass(frozen=True)
class PairGraph:
    """One-hot edge types [B, E, K] of E candidate pairs among N vehicles, all of which are driven."""

    edges: Float[Tensor, "B E K"]
    pairs: Sequence[tuple[int, int]]
    """(sender, receiver) of each pair."""
    vehicles: int


def bind_numpy(decoder: Decoder, graph: DenseGraph | PairGraph) -> Callable[[np.ndarray], np.ndarray] | None:
    """The policy for states [B, N, D] in numpy; None for the recurrent form, which has a memory.

    For a few groups this takes a fraction of torch's time, which goes mostly into calls. Its cost grows with the number
    of pairs that have an edge.
    """
    if not isinstance(decoder.body, FeedForward):
        return None
    folded, unit = fold(decoder, decoder.body, graph).numpy(), decoder.action_unit.numpy()
    return lambda state: folded(state, state) * unit


def fold(decoder: Decoder, body: FeedForward, graph: DenseGraph | PairGraph) -> "FoldedPolicy":
    """Join units, both halves of the first edge layer and the layer of the own state into one product."""
    first, *later = [layer for layer in body.node if isinstance(layer, nn.Linear)]
    sender, receiver = body.messages.first_layer()
    own = nn.functional.pad(body.own.weight, (1, 0)) if body.own else 0 * sender[: len(first.bias)]
    weight = torch.cat([sender, receiver, own]) / decoder.unit
    edge_bias = body.messages.sender.bias
    bias = torch.cat([edge_bias, torch.zeros_like(edge_bias), first.bias]) - weight @ decoder.offset
    return FoldedPolicy(
        weight=weight,
        bias=bias,
        ends=(len(sender), len(sender) + len(receiver)),
        driven=graph.vehicles if isinstance(graph, PairGraph) else graph.shape[2],
        sum_messages=SparseMessageSum.of_pairs(body.messages, graph)
        if isinstance(graph, PairGraph)
        else body.messages.bind(graph),
        node_weight=first.weight,
        later_layers=tuple((layer.weight, layer.bias) for layer in later),
    )


@dataclass(frozen=True)
class FoldedPolicy:
    """The feed-forward policy under one graph, in torch or in numpy.

    `weight` and `bias` turn a state into three parts: what it adds to the hidden layer of an edge as sender, what it
    adds as receiver, and what it adds to the vehicle's own hidden layer. The first two parts end at `ends`.
    """

    weight: Any
    bias: Any
    ends: tuple[int, int]
    driven: int
    """Number of driven vehicles, R."""
    sum_messages: "MessageSum | SparseMessageSum"
    node_weight: Any
    """Weight [H, H] of the summed messages in the vehicle's first hidden layer."""
    later_layers: tuple[tuple[Any, Any], ...]
    """Weight and bias of the layers after the first."""

    def __call__(self, state: Any, senders: Any) -> Any:
        """Mean action [B, R, A] in units of the scale.

        `senders` [B, N, D] are the states that other vehicles see: `state` itself, or `state` without its gradient.
        """
        functions, (end_sender, end_receiver) = functions_for(state), self.ends
        parts = functions.linear(state, self.weight, self.bias)
        sent = parts[..., :end_sender]
        if senders is not state:
            sent = functions.linear(senders, self.weight[:end_sender], self.bias[:end_sender])
        messages = self.sum_messages(sent, parts[:, : self.driven, end_sender:end_receiver])
        hidden = functions.linear(messages, self.node_weight) + parts[:, : self.driven, end_receiver:]
        for layer in self.later_layers:
            hidden = functions.linear(functions.silu(hidden), *layer)
        return hidden

    def numpy(self) -> "FoldedPolicy":
        """The same policy in numpy."""
        messages = self.sum_messages
        return FoldedPolicy(
            weight=_array(self.weight),
            bias=_array(self.bias),
            ends=self.ends,
            driven=self.driven,
            sum_messages=SparseMessageSum.of(messages) if isinstance(messages, MessageSum) else messages,
            node_weight=_array(self.node_weight),
            later_layers=tuple((_array(weight), _array(bias)) for weight, bias in self.later_layers),
        )


@dataclass(frozen=True)
class SparseMessageSum:
    """`MessageSum` in numpy for a graph with few edges: pairs that send nothing are left out.

    `pairs` holds the scene, sender and receiver of every pair that sends; `mask` and `bias` have one row per such pair.
    """

    pairs: tuple[np.ndarray, np.ndarray, np.ndarray]
    mask: np.ndarray
    bias: np.ndarray
    second: np.ndarray
    shape: tuple[int, int, int]
    """Numbers of scenes, senders and receivers."""

    @classmethod
    def of(cls, messages: MessageSum) -> "SparseMessageSum":
        """The sparse form of a sum over all pairs."""
        mask, bias, second = _array(messages.mask), _array(messages.bias), _array(messages.second)
        scene, sender, receiver = np.nonzero(mask.any(-1))
        pairs, (b, n, r, _) = (scene, sender, receiver), mask.shape
        return cls(pairs, mask[pairs], bias.reshape(b, n, r, -1)[pairs], second, (b, n, r))

    @classmethod
    def of_pairs(cls, networks: EdgeNetworks, graph: PairGraph) -> "SparseMessageSum":
        """The sum over candidate pairs, without a matrix of all pairs."""
        z = graph.edges[..., networks.first_type :]
        scene, edge = (z != 0).any(-1).nonzero(as_tuple=True)
        z = z[scene, edge]
        ends = np.array(graph.pairs, dtype=np.int64).reshape(-1, 2)[edge.numpy()]
        mask, bias = z.repeat_interleave(networks.hidden, -1), z @ networks.second_bias
        shape = len(graph.edges), graph.vehicles, graph.vehicles
        pairs = scene.numpy(), ends[:, 0], ends[:, 1]
        return cls(pairs, _array(mask), _array(bias), _array(networks.second.weight.T), shape)

    def __call__(self, sender: np.ndarray, receiver: np.ndarray) -> np.ndarray:
        (scene, i, j), (scenes, senders, receivers) = self.pairs, self.shape
        hidden = NUMPY.silu(sender[scene, i] + receiver[scene, j]) * self.mask
        if senders > MOST_DENSE:
            sums = np.zeros((scenes, receivers, self.second.shape[1]), dtype=hidden.dtype)
            np.add.at(sums, (scene, j), NUMPY.silu(self.bias + hidden @ self.second))
            return sums
        messages = np.zeros((senders, scenes, receivers, self.second.shape[1]), dtype=hidden.dtype)
        messages[i, scene, j] = NUMPY.silu(self.bias + hidden @ self.second)
        return messages.sum(0)


def _array(value: Tensor) -> np.ndarray:
    return value.detach().numpy()
