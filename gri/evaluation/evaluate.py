"""How well does a model infer graphs and reproduce scenes? (Sec. VI-B)"""

from dataclasses import dataclass

import torch
from jaxtyping import Int
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.core.graph import FOLLOWING, YIELDING, InteractionGraph, Vocabulary, pairs
from gri.core.scenes import Scenes
from gri.evaluation import graph_scores, metrics
from gri.evaluation.metrics import Summary
from gri.networks.model import CHAIN, MERGE, MERGE_BEHIND, RelationalModel
from gri.networks.rollout import rollout


@dataclass(frozen=True)
class Evaluation:
    """A row of the paper's tables, and what it leaves out."""

    rmse: dict[str, Summary]
    """Of positions [m] and speeds [m/s], one roll-out of mean actions under the MAP graph."""
    accuracy: Summary
    """Over all six edges; the empty graph already scores 2/3 on the chain, 1/2 on the merge."""
    driven_accuracy: Summary
    """Over the four edges that enter driven vehicles."""
    chain_accuracy: Summary | None
    """Over all edges, in scenes whose true graph is the paper's (chain or merge); None where there are none."""
    edge_accuracy: dict[str, float]
    """Of every ordered pair "i->j"."""
    f1: dict[str, float]
    """Of every edge type that is true or inferred somewhere, over the edges into driven vehicles."""


@torch.no_grad()
def evaluate(model: RelationalModel, scenes: Scenes) -> Evaluation:
    """Infer each scene's graph from its first `history_steps` states, then roll out from the start."""
    graph = driving_graph(model, scenes)
    n = scenes.state.shape[1]
    driven = rollout(model, scenes.start, graph.one_hot, scenes.leader)
    right = (graph.map == scenes.graph).float()
    chain = (scenes.graph == graph_of_paper(model.config.vocabulary)).all(-1)
    return Evaluation(
        rmse={
            name: metrics.summary(metrics.rmse(driven.state, scenes.state, place))
            for name, place in scored_features(model.dynamics).items()
        },
        accuracy=metrics.summary(metrics.accuracy(graph.map, scenes.graph)),
        driven_accuracy=metrics.summary(metrics.driven_accuracy(graph.map, scenes.graph)),
        chain_accuracy=metrics.summary(right[chain].mean(-1)) if bool(chain.any()) else None,
        edge_accuracy={f"{i}->{j}": float(right[:, e].mean()) for e, (i, j) in enumerate(pairs(n))},
        f1=f1_by_type(graph, scenes),
    )


def scored_features(dynamics: Dynamics) -> dict[str, int]:
    """Places of what the tables score: x, y where there is one, and the speed v."""
    return {name: dynamics.index(name) for name in ("x", "y") if name in dynamics.state} | {"v": dynamics.speed}


def f1_by_type(graph: InteractionGraph, scenes: Scenes) -> dict[str, float]:
    """F1 of each type that occurs, over the edges into driven vehicles."""
    inferred, true = graph_scores.edges_into_driven(graph.map), graph_scores.edges_into_driven(scenes.graph)
    scores = {str(kind): graph_scores.f1(inferred, true, k) for k, kind in enumerate(graph.vocabulary)}
    return {kind: score for kind, score in scores.items() if score is not None}


def driving_graph(model: RelationalModel, scenes: Scenes) -> InteractionGraph:
    """The graph a model drives by: inferred, or the true one where it is told (Supervised)."""
    if model.encoder is None and model.config.told_graph:
        return InteractionGraph.certain(scenes.graph, model.config.vocabulary)
    return model.infer(scenes.seen[:, :, : model.history_steps])


def graph_of_paper(vocabulary: Vocabulary) -> Int[Tensor, " E"]:
    """Types of the one true graph of the paper's scene: the chain of followers, or the merge."""
    graph = {FOLLOWING: CHAIN, YIELDING: MERGE_BEHIND}.get(vocabulary, MERGE)
    edges = {(e.sender, e.receiver): e.type for e in graph}
    return InteractionGraph.of_edges(edges, vocabulary).map[0]
