"""The policy decoder as the program runs it: the values of `gri.networks.decoder`, computed faster.

Begin with `bind` (torch, for training and roll-outs) and `bind_numpy` (for driving a few groups one step on). For the
feed-forward form, `fold` joins units, offsets and all layers that read a state into one matrix product. The recurrent
form is run as it is defined.

Two tests compare the values, up to rounding, in tests/gri/networks/test_fast_decoder.py:
`test_folding_changes_no_action` (folded against defined) and `test_numpy_drives_as_torch_does` (numpy against torch).
"""

import copy
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
    assert isinstance(folded.sum_messages, SparseMessageSum)
    if folded.sum_messages.shape[1] <= MOST_DENSE:
        return FewVehicles(folded, unit)
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


class FewVehicles:
    """A folded policy in numpy, times `unit`: the same numbers, bit for bit, with as few calls of numpy as possible.

    What goes into x·σ(x) = h + h·tanh(h) is computed as h = x/2 right away, with half the weights and biases: halving
    is exact in floating point. Results are written into the same arrays in every call, except the last one.

    Its numbers can be read, for other code that computes the same. Each of `read`, `edge`, `last` and `inner` is a
    weight [I, O] with its bias. `senders` and `receivers` are the rows of the P pairs, in the order of `turns`.
    `vehicles` is the number of rows.
    """

    def __init__(self, policy: FoldedPolicy, unit: np.ndarray) -> None:
        sums, self.ends, self.unit = policy.sum_messages, policy.ends, unit
        assert isinstance(sums, SparseMessageSum), "the policy is to be in numpy"
        (scene, sender, receiver), (scenes, vehicles, driven) = sums.pairs, sums.shape
        order, self.turns = _by_turns(scene * driven + receiver)
        self.senders, self.receivers = ((scene * vehicles + of)[order] for of in (sender, receiver))
        self.mask = None if sums.mask.all() else sums.mask[order]
        rows = np.arange(scenes)[:, None] * vehicles + np.arange(driven)
        self.driven = rows.ravel()
        self._all_driven = driven == vehicles
        *inner, last = policy.later_layers
        self.read, self.edge = (policy.weight.T / 2, policy.bias / 2), (sums.second / 2, sums.bias[order] / 2)
        self.node = policy.node_weight.T / 2
        self.inner, self.last = [(weight.T / 2, bias / 2) for weight, bias in inner], (last[0].T, last[1])
        self.shape, kind = (scenes, driven, len(last[1])), policy.weight.dtype
        self.vehicles = scenes * vehicles
        self._parts = np.empty((scenes * vehicles, len(policy.bias)), kind)
        self._sent = np.empty((len(order), policy.ends[0]), kind)
        self._messages = np.empty((len(order), sums.second.shape[1]), kind)
        self._sums = np.zeros((scenes * driven, sums.second.shape[1]), kind)  # receivers without a sender keep the 0
        self._layers = [
            np.empty((scenes * driven, len(of)), kind) for of in (policy.node_weight, *(b for _, b in inner))
        ]

    def first(self, scenes: int) -> "FewVehicles":
        """The same for the first scenes only, where every receiver has one sender; it writes into the same arrays."""
        assert len(self.turns) == 1, "pairs are in the order of scenes where they are all in one turn"
        few, (whole, *of_one) = copy.copy(self), self.shape
        few.shape, few.vehicles = (scenes, *of_one), self.vehicles // whole * scenes
        pairs, driven = len(self.senders) // whole * scenes, len(self.driven) // whole * scenes
        few.senders, few.receivers = self.senders[:pairs], self.receivers[:pairs]
        few.turns = [(slice(0, pairs), self.turns[0][1][:pairs])]
        few.mask = None if self.mask is None else self.mask[:pairs]
        few.edge, few.driven = (self.edge[0], self.edge[1][:pairs]), self.driven[:driven]
        few._parts, few._sums = self._parts[: few.vehicles], self._sums[:driven]
        few._sent, few._messages = self._sent[:pairs], self._messages[:pairs]
        few._layers = [layer[:driven] for layer in self._layers]
        return few

    def __call__(self, state: np.ndarray) -> np.ndarray:
        """Mean action [B, R, A] for states [B, N, D]."""
        parts, sent, messages, sums = self._parts, self._sent, self._messages, self._sums
        end_sender, end_receiver = self.ends
        _product(state.reshape(len(parts), -1), *self.read, parts)
        np.add(parts[self.senders, :end_sender], parts[self.receivers, end_sender:end_receiver], out=sent)
        _silu_of_half(sent)
        if self.mask is not None:
            sent *= self.mask
        _product(sent, *self.edge, messages)
        _silu_of_half(messages)
        for turn, (pairs, receivers) in enumerate(self.turns):
            sums[receivers] = messages[pairs] if turn == 0 else sums[receivers] + messages[pairs]
        hidden = np.matmul(sums, self.node, out=self._layers[0])
        hidden += parts[:, end_receiver:] if self._all_driven else parts[self.driven, end_receiver:]
        _silu_of_half(hidden)
        for (weight, bias), layer in zip(self.inner, self._layers[1:], strict=True):
            _product(hidden, weight, bias, layer)
            _silu_of_half(layer)
            hidden = layer
        action = hidden @ self.last[0]
        action += self.last[1]
        action *= self.unit
        return action.reshape(self.shape)


def _by_turns(receivers: np.ndarray) -> tuple[np.ndarray, list[tuple[slice, np.ndarray]]]:
    """An order of pairs in which the first pairs of all receivers come first, then the second ones, and so on.

    Also, for each of these turns, where its pairs are and their receivers: a receiver has one pair in a turn at most.
    """
    turn = np.zeros(len(receivers), dtype=int)
    seen: dict[int, int] = {}
    for row, receiver in enumerate(receivers.tolist()):
        turn[row] = seen[receiver] = seen.get(receiver, -1) + 1
    order = np.argsort(turn, kind="stable")
    ends = np.cumsum(np.bincount(turn)).tolist() if len(turn) else []
    return order, [(slice(a, b), receivers[order][a:b]) for a, b in zip([0, *ends], ends, strict=False)]


def _product(x: np.ndarray, weight: np.ndarray, bias: np.ndarray, out: np.ndarray) -> None:
    np.matmul(x, weight, out=out)
    out += bias


def _silu_of_half(half: np.ndarray) -> None:
    """x·σ(x) in the place of x/2."""
    curve = np.tanh(half)
    curve *= half
    half += curve


def _array(value: Tensor) -> np.ndarray:
    return value.detach().numpy()
