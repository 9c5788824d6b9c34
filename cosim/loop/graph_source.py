"""The graph that a policy uses: the inferred one, or what the scenario prescribes instead."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import torch

from cosim.spec.scenario import Enforced, GraphSource, GroundTruth, GroupRule, Inferred
from cosim.world.groups import expected_graph
from gri.core.graph import EdgeType, InteractionGraph, pairs

LEAST_DOUBT = 0.05
"""Probability of a reaction from which on it counts, where the alternative is to react to nobody."""


def graph_from_source(
    graph: InteractionGraph, source: GraphSource, rule: GroupRule, has_third_vehicle: bool = True
) -> InteractionGraph:
    """The inferred graph with the edges that the source prescribes.

    Without a third vehicle, no pair with it has an edge.
    """
    prescribed = dict(_prescribed(source, rule))
    if not has_third_vehicle:
        prescribed |= {pair: EdgeType.NONE for pair in pairs(rule.size) if 2 in pair}
    return with_edges(graph, prescribed, rule.size)


def with_edges(graph: InteractionGraph, prescribed: Mapping[tuple[int, int], EdgeType], size: int) -> InteractionGraph:
    """The graph of `size` vehicles with these types of pairs (sender, receiver), all of them certain."""
    if not prescribed:
        return graph
    needed = {pair for pair, kind in prescribed.items() if kind is not EdgeType.NONE}
    if not needed <= set(graph.pairs):
        graph = graph.on(tuple(sorted(needed | set(graph.pairs))))
    which = torch.tensor([pair in prescribed for pair in graph.pairs])
    certain = InteractionGraph.of_edges(
        prescribed, graph.vocabulary, size, batch=len(graph), candidates=graph.candidates
    )
    doubted = None if graph.in_doubt is None else graph.in_doubt & ~which
    return replace(graph, logits=torch.where(which[:, None], certain.logits, graph.logits), in_doubt=doubted)


def reacting_in_doubt(graph: InteractionGraph, source: GraphSource, driven: Sequence[int]) -> InteractionGraph:
    """The graph in which a driven vehicle reacts to nobody only if that is all but certain, if the source says so.

    To react without need costs little; to drive into a vehicle that was taken for none costs much. Also a vehicle that
    keeps its relations (see `smoothed`) becomes more careful in a scene that the model does not know.
    """
    if not isinstance(source, Inferred) or source.in_doubt == "ignore":
        return graph
    return graph.reacting_in_doubt(driven, LEAST_DOUBT)


def keep_where_unknown(graph: InteractionGraph, last: InteractionGraph, source: GraphSource) -> InteractionGraph:
    """The new graph, or the last one for groups whose scene the model does not know, if the source says `keep`."""
    if graph.unknown is None or not isinstance(source, Inferred) or source.when_unknown == "use":
        return graph
    keep = (graph.unknown > 1)[:, None, None]
    graph, last = on_same_pairs([graph, last])
    return replace(graph, logits=torch.where(keep, last.logits, graph.logits))


def on_same_pairs(graphs: Sequence[InteractionGraph]) -> list[InteractionGraph]:
    """The graphs on all pairs that are candidates in one of them."""
    every = tuple(sorted({pair for graph in graphs for pair in graph.pairs}))
    return [graph.on(every) for graph in graphs]


def smoothed(
    graph: InteractionGraph,
    last: InteractionGraph,
    source: GraphSource,
    elapsed: float,
    window: float,
    driven: Collection[int] = (),
) -> InteractionGraph:
    """The new graph as evidence for what the last one says: one forward step of a hidden Markov chain per pair.

    Between two inferences, which are `elapsed` [s] apart, a relation changes to any other one with the source's
    switching rate. Each graph is inferred from a history of `window` [s], so histories overlap, and the new graph
    counts as `elapsed`/`window` of an observation: every moment is evidence once (docs/decisions/058).

    A vehicle of `driven`, the roles that the policy drives, keeps its relations: it moves as the policy wants under the
    last graph, so that its motion is no evidence for another one (docs/decisions/070).
    """
    if not isinstance(source, Inferred) or not source.smoothing:
        return graph
    graph, last = on_same_pairs([graph, last])
    stay = math.exp(-source.switching_rate * elapsed)
    expected = stay * last.probs + (1 - stay) / last.logits.shape[-1]
    logits = expected.clamp_min(1e-9).log() + min(elapsed / window, 1.0) * graph.logits.log_softmax(-1)
    kept = torch.tensor([not source.own_motion and receiver in driven for _, receiver in graph.pairs])
    return replace(graph, logits=torch.where(kept[:, None], last.logits, logits.log_softmax(-1)))


def _prescribed(source: GraphSource, rule: GroupRule) -> Mapping[tuple[int, int], EdgeType]:
    """Type of every pair (sender, receiver) that the policy does not infer itself."""
    none = dict.fromkeys(pairs(rule.size), EdgeType.NONE)
    if isinstance(source, GroundTruth):
        return none | expected_graph(rule)
    if not isinstance(source, Enforced):
        return {}
    named = {(int(pair[0]), int(pair[-1])): EdgeType(kind) for pair, kind in source.edges.items()}
    return named if source.others == "inferred" else none | named
