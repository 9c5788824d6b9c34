"""The graph a policy goes by: what it infers, or what a scenario says instead."""

from collections.abc import Mapping

import torch

from cosim.spec.scenario import Enforced, GraphSource, GroundTruth, GroupRule
from cosim.world.groups import expected_graph
from gri.core.graph import EdgeType, InteractionGraph, pairs


def graph_from_source(
    graph: InteractionGraph, source: GraphSource, rule: GroupRule, third: bool = True
) -> InteractionGraph:
    """The inferred graph with the edges that the source knows better; without a `third` vehicle none with it."""
    known = {**_known(source, rule), **({} if third else {pair: EdgeType.NONE for pair in pairs(3) if 2 in pair})}
    if not known:
        return graph
    which = torch.tensor([pair in known for pair in pairs(3)])
    certain = InteractionGraph.of_edges(known, graph.vocabulary, batch=len(graph))
    return InteractionGraph(torch.where(which[:, None], certain.logits, graph.logits), graph.vocabulary)


def _known(source: GraphSource, rule: GroupRule) -> Mapping[tuple[int, int], EdgeType]:
    """Type of every pair (sender, receiver) that is not left to the policy."""
    none = dict.fromkeys(pairs(3), EdgeType.NONE)
    if isinstance(source, GroundTruth):
        return none | expected_graph(rule)
    if not isinstance(source, Enforced):
        return {}
    named = {(int(pair[0]), int(pair[-1])): EdgeType(kind) for pair, kind in source.edges.items()}
    return named if source.others == "inferred" else none | named
