"""A policy that drives many vehicles at once, each behind the next vehicle ahead of it, whoever that is.

Every driven vehicle is vehicle 0 of a scene with two vehicles, and the vehicle ahead is vehicle 1. All scenes are one
batch. A scene begins when the vehicle ahead is another one than before.

`RelationalPairs` is for models with a graph. A new vehicle ahead counts as followed until the pair has been together
for a whole history; then the graph is inferred from that history. `PlainPairs` is for every other policy: it reads a
history, filled up at constant speed, as soon as a scene begins.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from cosim.loop.graph_source import keep_where_unknown, smoothed
from cosim.spec.scenario import Enforced, GraphSource, GroundTruth
from gri.core.graph import EdgeType, InteractionGraph, pairs
from gri.core.policy import Policy, PolicyState
from gri.core.trajectory import Trajectory
from gri.networks import fast_decoder
from gri.networks.decoder import dense
from gri.networks.model import RelationalModel

_PAIRS = pairs(2)
_ON_FOLLOWER = _PAIRS.index((1, 0))  # the edge on the driven vehicle
_FOLLOWS = {(1, 0): EdgeType.FOLLOW}


@dataclass(frozen=True)
class Inference:
    """What was inferred of some scenes: their numbers, the probability that 0 reacts to 1, and how unknown they are."""

    scenes: Int[np.ndarray, " P"]
    follows: Float[np.ndarray, " P"]
    unknown: Float[np.ndarray, " P"]


class PairPolicy(ABC):
    """Drives the scenes of a share of the traffic; scenes have fixed numbers, and `capacity` of them have room."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy

    @property
    def history_steps(self) -> int:
        """Number of instants of a history, with the present one."""
        return self.policy.history_steps

    @abstractmethod
    def begin(self, scenes: Int[np.ndarray, " P"], capacity: int) -> Bool[np.ndarray, " P"]:
        """Begin scenes anew. Returns which of them need `read` with their history at once."""

    @abstractmethod
    def read(self, scenes: Int[np.ndarray, " P"], history: Trajectory, elapsed: float) -> Inference | None:
        """Read the histories of scenes; the graphs that are used from now on, if the policy infers any.

        `elapsed` [s] is the time between two inferences.
        """

    @abstractmethod
    def act(self, scenes: Int[np.ndarray, " P"], state: Float[np.ndarray, "P 2 3"]) -> Float[np.ndarray, " P"]:
        """The jerk [m/s³] of vehicle 0 of each scene, from the states (x, v, a) of both; x is 0 at vehicle 1."""


class PlainPairs(PairPolicy):
    """Scenes of any policy for the 1-D point mass."""

    def __init__(self, policy: Policy) -> None:
        super().__init__(policy)
        self._state: PolicyState | None = None
        self._row: dict[int, int] = {}  # of each scene in the policy's state

    def begin(self, scenes: Int[np.ndarray, " P"], capacity: int) -> Bool[np.ndarray, " P"]:
        return np.ones(len(scenes), dtype=bool)

    def read(self, scenes: Int[np.ndarray, " P"], history: Trajectory, elapsed: float) -> Inference | None:
        new = self.policy.begin(history)
        again = set(scenes.tolist())
        kept = [scene for scene in self._row if scene not in again]
        if self._state is None or not kept:
            self._state = new
        else:
            rows = torch.tensor([self._row[scene] for scene in kept])
            self._state = PolicyState.concatenate([self._state[rows], new])
        self._row = {scene: row for row, scene in enumerate([*kept, *scenes.tolist()])}
        return None if new.graph is None else _inference(scenes, new.graph)

    def act(self, scenes: Int[np.ndarray, " P"], state: Float[np.ndarray, "P 2 3"]) -> Float[np.ndarray, " P"]:
        assert self._state is not None, "read() gives the state"
        if [*self._row] != scenes.tolist():
            rows = torch.tensor([self._row[scene] for scene in scenes.tolist()])
            self._state, self._row = self._state[rows], {scene: row for row, scene in enumerate(scenes.tolist())}
        action, self._state = self.policy.act(self._state, torch.from_numpy(state.astype(np.float32)))
        return action[:, 0, 0].numpy().astype(float)


class RelationalPairs(PairPolicy):
    """Scenes of a model with a graph. All scenes have a place in one batch, so that it is bound to its graph seldom."""

    def __init__(self, model: RelationalModel, source: GraphSource) -> None:
        super().__init__(model)
        self._model, self._vocabulary = model, model.config.vocabulary
        self._source, self._first = source, self._prescribed(source)
        self._logits = np.zeros((0, len(_PAIRS), len(self._vocabulary)), dtype=np.float32)
        self._state: PolicyState | None = None
        self._fast: Callable[[np.ndarray], np.ndarray] | None = None  # the policy of vehicle 0, if it has no memory

    def _prescribed(self, source: GraphSource) -> Float[np.ndarray, "E K"]:
        """The graph of a new scene."""
        edges = dict(_FOLLOWS)
        if isinstance(source, Enforced):
            given = source.edges.get("1->0")
            edges = {(1, 0): EdgeType(given)} if given else edges if source.others == "inferred" else {}
        return InteractionGraph.of_edges(edges, self._vocabulary, n=2).logits[0].numpy()

    @property
    def _infers(self) -> bool:
        """Whether the edge on the driven vehicle is inferred, not given."""
        if isinstance(self._source, Enforced):
            return self._source.others == "inferred" and "1->0" not in self._source.edges
        return not isinstance(self._source, GroundTruth)

    def begin(self, scenes: Int[np.ndarray, " P"], capacity: int) -> Bool[np.ndarray, " P"]:
        if capacity > len(self._logits):
            more = np.broadcast_to(self._first, (capacity - len(self._logits), *self._first.shape))
            self._logits = np.concatenate([self._logits, more])
        self._logits[scenes] = self._first
        self._bind(scenes)
        return np.zeros(len(scenes), dtype=bool)

    def read(self, scenes: Int[np.ndarray, " P"], history: Trajectory, elapsed: float) -> Inference | None:
        if not self._infers:
            return None
        last = InteractionGraph(torch.from_numpy(self._logits[scenes]), self._vocabulary)
        graph, window = self._model.infer(history.state), self.history_steps * history.dt
        graph = keep_where_unknown(smoothed(graph, last, self._source, elapsed, window), last, self._source)
        self._logits[scenes] = graph.logits.numpy()
        self._bind(scenes[:0])
        return _inference(scenes, graph)

    def _bind(self, begun: Int[np.ndarray, " P"]) -> None:
        """Use the graphs as they are now; scenes that have `begun` forget their memory."""
        size = self._model.decoder.memory_size
        memory = torch.zeros(len(self._logits), 2, size)
        if size and self._state is not None:
            memory[: len(self._state)] = self._state.memory
            memory[begun] = 0
        graph = InteractionGraph(torch.from_numpy(self._logits.copy()), self._vocabulary)
        if self._state is not None and (bound := self._state.graph) is not None and len(bound) == len(graph):
            graph = bound if torch.equal(bound.map, graph.map) else graph
        if self._state is None or self._state.graph is not graph:
            self._fast = fast_decoder.bind_numpy(self._model.decoder, dense(graph.one_hot)[:, :, :1])
        self._state = PolicyState(graph, memory)

    def act(self, scenes: Int[np.ndarray, " P"], state: Float[np.ndarray, "P 2 3"]) -> Float[np.ndarray, " P"]:
        assert self._state is not None, "begin() gives the state"
        everywhere = np.zeros((len(self._logits), 2, 3), dtype=np.float32)
        everywhere[scenes] = state
        if self._fast is not None:
            return self._fast(everywhere)[scenes, 0, 0].astype(float)
        action, self._state = self._model.act(self._state, torch.from_numpy(everywhere))
        return action[scenes, 0, 0].numpy().astype(float)


def pair_policy(policy: Policy, source: GraphSource) -> PairPolicy:
    """The scenes of a policy for the 1-D point mass."""
    return RelationalPairs(policy, source) if isinstance(policy, RelationalModel) else PlainPairs(policy)


def _inference(scenes: Int[np.ndarray, " P"], graph: InteractionGraph) -> Inference:
    none = graph.vocabulary.index(EdgeType.NONE)
    follows = 1 - graph.probs[:, _ON_FOLLOWER, none]
    unknown: Tensor = torch.full_like(follows, np.nan) if graph.unknown is None else graph.unknown
    return Inference(scenes, follows.numpy().astype(float), unknown.numpy().astype(float))
