"""How well a model infers graphs and reproduces scenes (Sec. VI-B)."""

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
    """The metrics of a row of the paper's tables, and more scores of the graphs."""

    rmse: dict[str, Summary]
    """RMSE of positions x, y [m] and speed v [m/s] for one roll-out of mean actions under the MAP graph."""
    accuracy: Summary
    """Accuracy over all E edges. The empty graph has an accuracy of 2/3 on the chain and 1/2 on the merge."""
    driven_accuracy: Summary
    """Accuracy over the edges into driven vehicles."""
    chain_accuracy: Summary | None
    """Accuracy over all edges in scenes with the paper's true graph (chain or merge); None without such scenes."""
    edge_accuracy: dict[str, float]
    """Accuracy of every ordered pair "i->j"."""
    f1: dict[str, float]
    """F1 of every edge type that occurs or is inferred, over the edges into driven vehicles."""


@torch.no_grad()
def evaluate(model: RelationalModel, scenes: Scenes) -> Evaluation:
    """Infer each scene's graph from its first `history_steps` states, and roll the model out from the start."""
    graph = driving_graph(model, scenes)
    n = scenes.state.shape[1]
    driven = rollout(model, scenes.start, graph.one_hot, scenes.leader)
    correct = (graph.map == scenes.graph).float()
    chain = (scenes.graph == graph_of_paper(model.config.vocabulary)).all(-1)
    return Evaluation(
        rmse={
            name: metrics.summary(metrics.rmse(driven.state, scenes.state, index))
            for name, index in scored_features(model.dynamics).items()
        },
        accuracy=metrics.summary(metrics.accuracy(graph.map, scenes.graph)),
        driven_accuracy=metrics.summary(metrics.driven_accuracy(graph.map, scenes.graph)),
        chain_accuracy=metrics.summary(correct[chain].mean(-1)) if bool(chain.any()) else None,
        edge_accuracy={f"{i}->{j}": float(correct[:, e].mean()) for e, (i, j) in enumerate(pairs(n))},
        f1=f1_by_type(graph, scenes),
    )


def scored_features(dynamics: Dynamics) -> dict[str, int]:
    """Names and positions on the last axis of the scored features: x, y if the dynamics have it, and the speed v."""
    return {name: dynamics.index(name) for name in ("x", "y") if name in dynamics.state} | {"v": dynamics.speed}


def f1_by_type(graph: InteractionGraph, scenes: Scenes) -> dict[str, float]:
    """F1 of each type that occurs or is inferred, over the edges into driven vehicles."""
    inferred, true = graph_scores.edges_into_driven(graph.map), graph_scores.edges_into_driven(scenes.graph)
    scores = {str(kind): graph_scores.f1(inferred, true, k) for k, kind in enumerate(graph.vocabulary)}
    return {kind: score for kind, score in scores.items() if score is not None}


def driving_graph(model: RelationalModel, scenes: Scenes) -> InteractionGraph:
    """The graph that a model drives by: the inferred one, or the true one for the Supervised baseline."""
    if model.encoder is None and model.config.told_graph:
        return InteractionGraph.certain(scenes.graph, model.config.vocabulary)
    return model.infer(scenes.observed[:, :, : model.history_steps])


def graph_of_paper(vocabulary: Vocabulary) -> Int[Tensor, " E"]:
    """Edge types of the paper's true graph for a vocabulary: the chain of followers, or the merge."""
    graph = {FOLLOWING: CHAIN, YIELDING: MERGE_BEHIND}.get(vocabulary, MERGE)
    edges = {(e.sender, e.receiver): e.type for e in graph}
    return InteractionGraph.of_edges(edges, vocabulary).map[0]
