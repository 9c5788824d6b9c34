"""The relational policy: an encoder that infers the graph, and a decoder that drives under it (Sec. V-A, Appendix A).

GRI, NRI and their ablations are this class with an encoder. The Supervised baseline is this class with a given graph.
They differ in how they are trained (`gri.training`).
"""

from collections.abc import Callable

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from gri.core.dynamics import Dynamics, DynamicsName, dynamics_named
from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.core.policy import PolicyState
from gri.core.scale import CAR_FOLLOWING_PAPER, Scale
from gri.core.trajectory import Trajectory
from gri.networks.decoder import Act, Decoder, DecoderConfig, dense
from gri.networks.encoder import Encoder, EncoderConfig


class Edge(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`sender` affects `receiver` in the way `type` says: vehicle 0 follows vehicle 1 is 1 → 0."""

    sender: int
    receiver: int
    type: EdgeType


CHAIN = (
    Edge(sender=1, receiver=0, type=EdgeType.FOLLOW),
    Edge(sender=2, receiver=1, type=EdgeType.FOLLOW),
)


MERGE = (
    Edge(sender=2, receiver=0, type=EdgeType.FOLLOW),
    Edge(sender=1, receiver=0, type=EdgeType.CUT_IN),
    Edge(sender=0, receiver=1, type=EdgeType.YIELD),
)


MERGE_BEHIND = (
    Edge(sender=1, receiver=0, type=EdgeType.YIELD),
    Edge(sender=2, receiver=1, type=EdgeType.FOLLOW),
)
"""Recorded lane changes, the reading H1: 0 merges behind 1."""
MERGE_BETWEEN = (
    Edge(sender=2, receiver=0, type=EdgeType.YIELD),
    Edge(sender=0, receiver=1, type=EdgeType.YIELD),
    Edge(sender=2, receiver=1, type=EdgeType.FOLLOW),
)
"""Recorded lane changes, the reading H2: 0 merges between 1 and 2."""


class ModelConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """All there is to know to rebuild a model from its tensors."""

    dynamics: DynamicsName = DynamicsName.POINT_MASS_1D
    vocabulary: tuple[EdgeType, ...] = FOLLOWING
    dt: float = 0.2
    history_steps: int = 20
    """States the encoder is shown before it decides on the graph."""
    never_reverse: bool = False
    """Roll-outs stop at v = 0, where the dynamics say how."""
    scale: Scale = CAR_FOLLOWING_PAPER
    decoder: DecoderConfig = DecoderConfig()
    encoder: EncoderConfig | None = EncoderConfig()
    """Without an encoder the model believes in `graph`, whatever it sees."""
    graph: tuple[Edge, ...] = CHAIN
    told_graph: bool = True
    """Without an encoder, evaluation tells the model each scene's true graph (Supervised); else it keeps `graph`."""


Drive = Callable[[Tensor, PolicyState], tuple[Tensor, PolicyState]]
"""(state, memory) -> (mean action, memory)."""


class RelationalModel(nn.Module):
    """A `Policy` that acts by the graph in its `PolicyState`; replace that graph to overrule the inferred one."""

    def __init__(self, config: ModelConfig) -> None:
        super().__init__()
        self.config = config
        types = len(config.vocabulary)
        self.decoder = Decoder(config.decoder, config.scale, types)
        self.encoder = Encoder(config.encoder, config.scale, types, config.dt) if config.encoder else None
        self._bound: tuple[InteractionGraph, Drive] | None = None  # the graph `act` last went by, and how

    @property
    def dynamics(self) -> Dynamics:
        return dynamics_named(self.config.dynamics)

    @property
    def dt(self) -> float:
        return self.config.dt

    @property
    def history_steps(self) -> int:
        return self.config.history_steps

    def infer(self, state: Float[Tensor, "B N T D"]) -> InteractionGraph:
        """The graph the model believes in after it has seen these states."""
        if self.encoder is not None:
            return InteractionGraph(self.encoder(state), self.config.vocabulary)
        edges = {(edge.sender, edge.receiver): edge.type for edge in self.config.graph}
        return InteractionGraph.of_edges(edges, self.config.vocabulary, n=state.shape[1], batch=state.shape[0])

    @torch.no_grad()
    def begin(self, history: Trajectory) -> PolicyState:
        """Infer the graph from the last `history_steps` states; complete trajectories only."""
        missing = int((~history.valid).sum())
        if missing:
            raise ValueError(
                f"got a history with {missing} missing states, wanted all N x T to exist; "
                "leave out groups in which a vehicle was not seen"
            )
        if abs(history.dt - self.dt) > 1e-6:
            raise ValueError(f"got a history sampled every {history.dt} s, the model wants {self.dt} s; resample it")
        return PolicyState(self.infer(history.state[:, :, -self.history_steps :]), self.memory(history.initial))

    def memory(self, state: Float[Tensor, "B N D"]) -> Float[Tensor, "B N H"]:
        """The empty memory a roll-out starts with."""
        return state.new_zeros(*state.shape[:2], self.decoder.memory_size)

    def act(self, memory: PolicyState, state: Float[Tensor, "B N D"]) -> tuple[Float[Tensor, "B N A"], PolicyState]:
        """Mean action under the most probable graph."""
        assert memory.graph is not None, "begin() gives a PolicyState with a graph"
        if self.training or self._bound is None or self._bound[0] is not memory.graph:
            self._bound = memory.graph, self._bind(memory.graph)
        return self._bound[1](state, memory)

    @torch.no_grad()
    def _bind(self, graph: InteractionGraph) -> Drive:
        """How to act by a graph: in numpy, where that is possible."""
        edges = dense(graph.one_hot)
        lean = self.decoder.bind_numpy(edges)
        if lean is None:
            return self._by_torch(self.decoder.bind(edges))

        def act(state: Tensor, memory: PolicyState) -> tuple[Tensor, PolicyState]:
            counted = state.detach().numpy().copy()
            counted[..., 0] -= counted[:, -1:, 0]  # as `relative`
            return torch.from_numpy(lean(counted)), memory

        return act

    def _by_torch(self, bound: Act) -> Drive:
        @torch.no_grad()
        def act(state: Tensor, memory: PolicyState) -> tuple[Tensor, PolicyState]:
            action, recurrent = bound(relative(state), memory.memory)
            return action, PolicyState(memory.graph, recurrent)

        return act

    def step(self, state: Float[Tensor, "*batch D"], action: Float[Tensor, "*batch A"]) -> Float[Tensor, "*batch D"]:
        """The next state under the model's dynamics."""
        moved = self.dynamics.step(state, action, self.dt)
        stop = self.dynamics.stop if self.config.never_reverse else None
        return moved if stop is None else stop(state, moved)


def relative(state: Float[Tensor, "B N D"]) -> Float[Tensor, "B N D"]:
    """Positions counted from the last vehicle: the decoder needs differences only, and float32 keeps its digits."""
    return torch.cat([state[..., :1] - state[:, -1:, :1], state[..., 1:]], -1)
