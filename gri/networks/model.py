"""The relational policy: an encoder that infers the graph, and a decoder that drives under it (Sec. V-A, Appendix A).

GRI, NRI and their ablations are this class with an encoder. The Supervised baseline is this class with a given graph.
They differ in how they are trained (`gri.training`).
"""

from collections.abc import Callable

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.candidate_pairs import candidate_pairs
from gri.core.dynamics import Dynamics, DynamicsName, dynamics_named
from gri.core.graph import FOLLOWING, MOST_COMPLETE, EdgeType, InteractionGraph
from gri.core.policy import PolicyState
from gri.core.scale import CAR_FOLLOWING_PAPER, Scale
from gri.core.trajectory import Trajectory
from gri.networks import fast_decoder
from gri.networks.decoder import Decoder, DecoderConfig, dense
from gri.networks.encoder import Encoder, EncoderConfig
from gri.networks.fast_pair_encoder import explain_pairs
from gri.networks.novelty import Novelty
from gri.networks.pair_encoder import LENGTH, PairEncoder, PairEncoderConfig


class Edge(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An edge of a true graph: the receiver reacts to the sender. "Vehicle 0 follows vehicle 1" is the edge 1 → 0."""

    sender: int
    receiver: int
    type: EdgeType


CHAIN = (
    Edge(sender=1, receiver=0, type=EdgeType.FOLLOW),
    Edge(sender=2, receiver=1, type=EdgeType.FOLLOW),
)
"""Car following (Sec. VI-C): 0 follows 1, and 1 follows 2."""
MERGE = (
    Edge(sender=2, receiver=0, type=EdgeType.FOLLOW),
    Edge(sender=1, receiver=0, type=EdgeType.CUT_IN),
    Edge(sender=0, receiver=1, type=EdgeType.YIELD),
)
"""Synthetic lane changing (Sec. VI-C): 0 follows the leader 2 and cuts in front of 1, which yields to 0."""
MERGE_BEHIND = (
    Edge(sender=1, receiver=0, type=EdgeType.YIELD),
    Edge(sender=2, receiver=1, type=EdgeType.FOLLOW),
)
"""Recorded lane changes (Sec. VI-D), reading H1 of the paper: 0 merges behind 1."""
MERGE_BETWEEN = (
    Edge(sender=2, receiver=0, type=EdgeType.YIELD),
    Edge(sender=0, receiver=1, type=EdgeType.YIELD),
    Edge(sender=2, receiver=1, type=EdgeType.FOLLOW),
)
"""Recorded lane changes (Sec. VI-D), reading H2 of the paper: 0 merges between 1 and 2."""


class ModelConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Everything that is needed to rebuild a model from its tensors."""

    dynamics: DynamicsName = DynamicsName.POINT_MASS_1D
    vocabulary: tuple[EdgeType, ...] = FOLLOWING
    dt: float = 0.2
    """Time between two states [s]."""
    history_steps: int = 20
    """Number of states from which the encoder infers the graph."""
    never_reverse: bool = False
    """Vehicles stop at v = 0 in roll-outs, by the `stop` of the dynamics."""
    scale: Scale = CAR_FOLLOWING_PAPER
    decoder: DecoderConfig = DecoderConfig()
    encoder: EncoderConfig | None = EncoderConfig()
    """None: the model always uses `graph`, unless it has a `pair_encoder`."""
    pair_encoder: PairEncoderConfig | msgspec.UnsetType = msgspec.UNSET
    """Infer the graph by comparing explanations of each vehicle's motion, instead of by the paper's `encoder`."""
    graph: tuple[Edge, ...] = CHAIN
    """The graph of a model without an encoder."""
    told_graph: bool = True
    """For a model without an encoder: evaluation gives it the true graph of each scene (Supervised). False: it keeps
    `graph`.
    """


Drive = Callable[[Tensor, PolicyState], tuple[Tensor, PolicyState]]
"""(state [B, N, D], memory) -> (mean action [B, N, A], memory)."""


class RelationalModel(nn.Module):
    """A `Policy` that drives under the graph in its `PolicyState`. Replace that graph to overrule the inferred one."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        types = len(config.vocabulary)
        self.decoder = Decoder(config.decoder, config.scale, types)
        self.encoder = _encoder(config)
        speed = self.dynamics.speed
        self.novelty = None if config.pair_encoder is msgspec.UNSET else Novelty(REFERENCE, speed, config.dt)
        # The graph of the last `act`, its driver, and what that is made of.
        self._bound: tuple[InteractionGraph, Drive, fast_decoder.FewVehicles | None] | None = None

    @property
    def dynamics(self) -> Dynamics:
        """Layout and units of states and actions."""
        return dynamics_named(self.config.dynamics)

    @property
    def dt(self) -> float:
        """Time between two actions [s]."""
        return self.config.dt

    @property
    def history_steps(self) -> int:
        """Number of states from which the encoder infers the graph."""
        return self.config.history_steps

    def infer(
        self, state: Float[Tensor, "B N T D"], candidates: tuple[tuple[int, int], ...] | None = None
    ) -> InteractionGraph:
        """The graph that the encoder infers from these states; without an encoder, the graph of the configuration.

        It is complete, or has the given candidate pairs (sender, receiver), in lexicographic order. The cost then grows
        with the pairs, for a model with a pair encoder: many vehicles are one group. Other encoders need the complete
        graph.

        Raises `ValueError` if a state is not finite, if the encoder needs a longer history, or if it cannot infer
        candidate pairs.
        """
        if candidates is not None:
            return self._infer_candidates(state, candidates)
        if self.encoder is not None:
            _check_history(state, self.encoder.least_steps)
            unknown = None if self.novelty is None else self.novelty(state)
            return InteractionGraph(self.encoder(state), self.config.vocabulary, unknown)
        n, edges = state.shape[1], {(edge.sender, edge.receiver): edge.type for edge in self.config.graph}
        if self.config.graph == CHAIN:
            edges = {(j + 1, j): EdgeType.FOLLOW for j in range(n - 1)}
        return InteractionGraph.of_edges(edges, self.config.vocabulary, n, len(state))

    def _infer_candidates(
        self, state: Float[Tensor, "B N T D"], candidates: tuple[tuple[int, int], ...]
    ) -> InteractionGraph:
        if not isinstance(self.encoder, PairEncoder):
            raise ValueError("got candidate pairs for a model without a pair encoder; infer the complete graph")
        _check_history(state, self.encoder.least_steps)
        b, n, _, _ = state.shape
        ends = torch.tensor(candidates, dtype=torch.long).reshape(-1, 2)
        ends = (ends + n * torch.arange(b)[:, None, None]).flatten(0, 1)
        x, v = state[..., 0].flatten(0, 1), state[..., self.dynamics.speed].flatten(0, 1)
        _, follow = explain_pairs(self.encoder, x, v, ends)
        logits = torch.stack([1 - follow, follow], -1).clamp(min=1e-13).log().reshape(b, len(candidates), 2)
        return InteractionGraph(logits.to(state.dtype), self.config.vocabulary, candidates=candidates)

    @torch.no_grad()
    def begin(self, history: Trajectory) -> PolicyState:
        """Infer the graph from the last `history_steps` states.

        It is complete on up to three vehicles; on more, a pair encoder is asked about those that are next to each other
        in one lane (`gri.core.candidate_pairs`).

        Raises `ValueError` if a state is missing (`valid` is False) or not finite, or if the history has another
        sampling time. A model with an encoder also raises it for a history that is too short.
        """
        missing = int((~history.valid).sum())
        if missing:
            raise ValueError(
                f"got a history with {missing} missing states, wanted all N x T states; "
                "leave out groups in which a vehicle is missing at some instant"
            )
        if abs(history.dt - self.dt) > 1e-6:
            raise ValueError(f"got a history sampled every {history.dt} s, the model wants {self.dt} s; resample it")
        got = history.state.shape[2]
        if self.encoder is not None and got < self.history_steps:
            raise ValueError(f"got a history of {got} states, the model wants {self.history_steps}; give a longer one")
        states = history.state[:, :, -self.history_steps :]
        sparse = states.shape[1] > MOST_COMPLETE and isinstance(self.encoder, PairEncoder)
        graph = self.infer(states, candidates_in_lane(states[:, :, -1]) if sparse else None)
        return PolicyState(graph, self.memory(history.initial))

    def memory(self, state: Float[Tensor, "B N D"]) -> Float[Tensor, "B N H"]:
        """The hidden state at the start of a roll-out: zeros."""
        return state.new_zeros(*state.shape[:2], self.decoder.memory_size)

    def act(self, memory: PolicyState, state: Float[Tensor, "B N D"]) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        """Mean action under the most probable graph."""
        assert memory.graph is not None, "begin() gives a PolicyState with a graph"
        if self.training or self._bound is None or self._bound[0] is not memory.graph:
            self._bound = memory.graph, *self._bind(memory.graph, state.shape[1])
        return self._bound[1](state, memory)

    def few_vehicles(self, memory: PolicyState) -> fast_decoder.FewVehicles | None:
        """What `act` computed last, for states relative to the last vehicle, as numbers that other code can read.

        None where the policy has not acted under this graph, has a memory, or drives groups of many vehicles.
        """
        if self._bound is None or self._bound[0] is not memory.graph:
            return None
        return self._bound[2]

    @torch.no_grad()
    def _bind(self, graph: InteractionGraph, vehicles: int) -> tuple[Drive, fast_decoder.FewVehicles | None]:
        """How to drive under a graph: in numpy for the feed-forward decoder, else in torch."""
        edges, pairs = graph.one_hot, graph.candidates
        edges = dense(edges) if pairs is None else fast_decoder.PairGraph(edges, pairs, vehicles)
        by_numpy = fast_decoder.bind_numpy(self.decoder, edges)
        if by_numpy is None:
            by_torch = fast_decoder.bind(self.decoder, dense(graph.one_hot, pairs, vehicles))

            @torch.no_grad()
            def act(state: Tensor, memory: PolicyState) -> tuple[Tensor, PolicyState]:
                action, hidden = by_torch(relative(state), memory.memory)
                return action, PolicyState(memory.graph, hidden)
        else:

            def act(state: Tensor, memory: PolicyState) -> tuple[Tensor, PolicyState]:
                shifted = state.detach().numpy().copy()
                shifted[..., 0] -= shifted[:, -1:, 0]  # as `relative`
                return torch.from_numpy(by_numpy(shifted)), memory

        return act, by_numpy if isinstance(by_numpy, fast_decoder.FewVehicles) else None

    def step(self, state: Float[Tensor, "*batch D"], action: Float[Tensor, "*batch A"]) -> Float[Tensor, "*batch D"]:
        """The next state under the model's dynamics, with the stop at v = 0 if `never_reverse` is set."""
        moved = self.dynamics.step(state, action, self.dt)
        stop = self.dynamics.stop if self.config.never_reverse else None
        return moved if stop is None else stop(state, moved)


REFERENCE = 2000  # vehicles of training scenes that new scenes are compared with


def _encoder(config: ModelConfig) -> Encoder | PairEncoder | None:
    if config.pair_encoder is not msgspec.UNSET:
        assert config.vocabulary == FOLLOWING, f"a pair encoder infers {FOLLOWING}, got {config.vocabulary}"
        return PairEncoder(config.pair_encoder, dynamics_named(config.dynamics).speed, config.dt)
    return Encoder(config.encoder, config.scale, len(config.vocabulary), config.dt) if config.encoder else None


def _check_history(state: Float[Tensor, "B N T D"], least_steps: int) -> None:
    if not bool(torch.isfinite(state).all()):
        raise ValueError(
            "got states that are not finite, wanted numbers; leave out vehicles that were not seen throughout"
        )
    if state.shape[2] < least_steps:
        raise ValueError(f"got a history of {state.shape[2]} states, wanted at least {least_steps}; give a longer one")


def candidates_in_lane(state: Float[Tensor, "B N D"]) -> tuple[tuple[int, int], ...]:
    """The pairs that are candidates in at least one of B groups, each in one lane, of vehicles 5 m long."""
    x = state[..., 0].double().numpy()
    lanes, length = np.zeros((x.shape[1], 2), dtype=np.int64), np.full(x.shape[1], LENGTH)
    found = [candidate_pairs(s, lanes, length, adjacent=False) for s in x]
    return tuple((i, j) for i, j in np.unique(np.concatenate(found), axis=0).tolist())


def relative(state: Float[Tensor, "B N D"]) -> Float[Tensor, "B N D"]:
    """States with positions relative to the last vehicle.

    The decoder needs differences only, and small positions keep the digits of float32.
    """
    return torch.cat([state[..., :1] - state[:, -1:, :1], state[..., 1:]], -1)
