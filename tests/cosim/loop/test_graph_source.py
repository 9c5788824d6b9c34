"""Who has the last word about the graph."""

import math
from dataclasses import replace

import pytest
import torch

from cosim.loop.graph_source import (
    graph_from_source,
    keep_where_unknown,
    on_same_pairs,
    reacting_in_doubt,
    smoothed,
    with_edges,
)
from cosim.spec.scenario import CarFollowing, Enforced, GroundTruth, Inferred, Merge
from gri.core.graph import FOLLOWING, LANE_CHANGING, EdgeType, InteractionGraph, pairs

RULE = Merge(lane="weave_0", zone=(0.0, 10.0))
INFERRED = InteractionGraph(torch.randn(2, 6, 4, generator=torch.Generator().manual_seed(1)), LANE_CHANGING)


def test_the_inferred_graph_stays_as_it_is():
    assert graph_from_source(INFERRED, Inferred(), RULE) is INFERRED


def test_ground_truth_is_what_the_rule_implies():
    true = {(2, 0): EdgeType.FOLLOW, (1, 0): EdgeType.CUT_IN, (0, 1): EdgeType.YIELD}
    for scene in (0, 1):
        edges = graph_from_source(INFERRED, GroundTruth(), RULE).edges(scene)
        assert {pair: kind for pair, (kind, _) in edges.items()} == true
        assert all(p > 0.999 for _, p in edges.values())


def test_enforced_edges_leave_the_others_alone_or_empty():
    graph = graph_from_source(INFERRED, Enforced(edges={"0->1": "none", "2->1": "follow"}), RULE)
    assert (0, 1) not in graph.edges()
    assert graph.edges()[2, 1][0] is EdgeType.FOLLOW
    torch.testing.assert_close(graph.logits[:, [1, 2, 3, 4]], INFERRED.logits[:, [1, 2, 3, 4]])
    alone = graph_from_source(INFERRED, Enforced(edges={"2->1": "follow"}, others="none"), RULE)
    assert set(alone.edges(1)) == {(2, 1)}


def test_the_last_graph_is_kept_only_where_the_scene_is_unknown_and_the_source_says_so():
    new = InteractionGraph(INFERRED.logits + 1, INFERRED.vocabulary, torch.linspace(0.5, 1.5, len(INFERRED)))
    last = InteractionGraph(INFERRED.logits - 1, INFERRED.vocabulary)
    assert keep_where_unknown(new, last, Inferred()) is new
    assert keep_where_unknown(INFERRED, last, Inferred(when_unknown="keep")) is INFERRED
    kept = keep_where_unknown(new, last, Inferred(when_unknown="keep"))
    assert new.unknown is not None
    for scene in range(len(new)):
        wanted = last if float(new.unknown[scene]) > 1 else new
        assert torch.equal(kept.logits[scene], wanted.logits[scene])


def following(p: float) -> InteractionGraph:
    """One pair that follows with probability p."""
    return InteractionGraph(torch.tensor([[[1 - p, p]]]).log(), FOLLOWING, candidates=((1, 0),))


def test_one_step_of_the_chain_by_hand():
    """Prior 0.9, of which 2 % changes in a second; a fifth of the evidence for 0.4."""
    new = smoothed(following(0.4), following(0.9), Inferred(switching_rate=0.02), elapsed=1.0, window=5.0)
    stay = math.exp(-0.02)
    prior = stay * 0.9 + (1 - stay) / 2
    odds = prior / (1 - prior) * (0.4 / 0.6) ** 0.2
    assert float(new.probs[0, 0, 1]) == pytest.approx(odds / (1 + odds), abs=1e-6)


def test_a_relation_that_is_not_visible_stays_and_one_that_is_refuted_goes():
    def most_probable_after(seconds: int, p: float, first: float) -> int:
        last = following(first)
        for _ in range(seconds):
            last = smoothed(following(p), last, Inferred(), elapsed=1.0, window=5.0)
        return int(last.map)

    assert most_probable_after(8, 0.4, first=0.95) == 1  # each inference alone says that nobody is followed
    assert most_probable_after(6, 0.01, first=0.95) == 0
    assert most_probable_after(6, 0.99, first=0.05) == 1  # and a new one appears


def test_a_driven_vehicle_keeps_its_relations_and_others_do_not():
    """1 → 0 and 0 → 1 were both followed; new inferences say that nobody follows. The policy drives vehicle 0."""
    pair = ((0, 1), (1, 0))
    last = InteractionGraph(torch.tensor([[[0.1, 0.9], [0.1, 0.9]]]).log(), FOLLOWING, candidates=pair)
    new = InteractionGraph(torch.tensor([[[0.99, 0.01], [0.99, 0.01]]]).log(), FOLLOWING, candidates=pair)
    for _ in range(8):
        found = smoothed(new, last, Inferred(), 1.0, 5.0, driven=(0,))
        assert torch.equal(found.logits[:, 1], last.logits[:, 1])
        last = found
    assert last.map.tolist() == [[0, 1]]  # 1 does not follow 0 any more
    with_own = smoothed(new, last, Inferred(own_motion=True), 1.0, 5.0, driven=(0,))
    assert torch.equal(with_own.logits, smoothed(new, last, Inferred(), 1.0, 5.0).logits)
    assert not torch.equal(with_own.logits[:, 1], last.logits[:, 1])


def test_without_smoothing_and_with_prescribed_edges_the_new_graph_counts_alone():
    new, last = following(0.4), following(0.9)
    assert smoothed(new, last, Inferred(smoothing=False), 1.0, 5.0) is new
    assert smoothed(new, last, Enforced(edges={"1->0": "follow"}), 1.0, 5.0) is new


def test_a_sparse_graph_gets_the_pairs_that_are_enforced():
    """Five vehicles in a lane: pairs of neighbours are candidates, and 4->0 becomes one."""
    rule, neighbours = CarFollowing(size=5), tuple((i, j) for i, j in pairs(5) if abs(i - j) == 1)
    logits = torch.randn(2, len(neighbours), 2, generator=torch.Generator().manual_seed(2))
    graph = InteractionGraph(logits, FOLLOWING, candidates=neighbours)
    true = graph_from_source(graph, GroundTruth(), rule)
    assert set(true.edges()) == {(j + 1, j) for j in range(4)}
    enforced = graph_from_source(graph, Enforced(edges={"4->0": "follow", "1->0": "none"}), rule)
    assert set(enforced.pairs) == {*neighbours, (4, 0)}
    assert enforced.edges()[4, 0][0] is EdgeType.FOLLOW
    assert (1, 0) not in enforced.edges()
    torch.testing.assert_close(enforced.logits[:, enforced.pairs.index((2, 1))], logits[:, neighbours.index((2, 1))])
    same = on_same_pairs([enforced, graph])
    assert same[0].pairs == same[1].pairs
    assert same[1].edges().keys() == graph.edges().keys()


def test_in_doubt_only_driven_vehicles_react_and_only_where_the_graph_is_inferred():
    graph = InteractionGraph(torch.tensor([[[0.1, 0.0]] * 6]), FOLLOWING)
    assert reacting_in_doubt(graph, Inferred(in_doubt="ignore"), [0, 1]) is graph
    assert reacting_in_doubt(graph, GroundTruth(), [0, 1]) is graph
    assert {receiver for _, receiver in reacting_in_doubt(graph, Inferred(), [0]).edges()} == {0}


def test_a_scene_that_is_not_known_makes_kept_relations_more_careful_but_not_those_that_are_sure():
    """P(follow) of the take-over is 1 % or 0.01 %; a later scene is not known."""
    for odds, careful in ((99.0, True), (9999.0, False)):
        first = InteractionGraph(torch.tensor([[[math.log(odds), 0.0]] * 6]), FOLLOWING, torch.tensor([0.5]))
        assert not reacting_in_doubt(first, Inferred(), [0, 1]).edges()
        later = smoothed(replace(first, unknown=torch.tensor([3.0])), first, Inferred(), 1.0, 5.0, [0, 1])
        assert bool(reacting_in_doubt(later, Inferred(), [0, 1]).edges()) is careful


def test_what_is_prescribed_is_in_no_doubt():
    graph = reacting_in_doubt(InteractionGraph(torch.tensor([[[0.1, 0.0]] * 6]), FOLLOWING), Inferred(), [0])
    ((pair, _),) = graph.edges().items()
    assert not with_edges(graph, {pair: EdgeType.NONE}, 3).edges()
