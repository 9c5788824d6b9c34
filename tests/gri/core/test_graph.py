from dataclasses import replace

import pytest
import torch

from gri.core.graph import FOLLOWING, LANE_CHANGING, EdgeType, InteractionGraph, pairs, vehicle_count


def test_edges_stand_in_lexicographic_order():
    assert pairs(3) == [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]


@pytest.mark.parametrize("n", [2, 3, 4, 7])
def test_agents_of_inverts_the_number_of_pairs(n: int):
    assert vehicle_count(len(pairs(n))) == n


def test_named_edges_reach_their_place():
    graph = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}, FOLLOWING, batch=2)
    assert graph.map.tolist() == [[0, 0, 1, 0, 0, 1]] * 2
    assert set(graph.edges(1)) == {(1, 0), (2, 1)}
    assert graph.edges()[(1, 0)][0] is EdgeType.FOLLOW


def test_samples_follow_the_probabilities(generator: torch.Generator):
    probs = torch.tensor([0.6, 0.3, 0.07, 0.03])
    graph = InteractionGraph(probs.log().expand(4000, 6, 4), LANE_CHANGING)
    sample = graph.sample(generator)
    assert ((sample - sample.round()).abs() < 1e-5).all()
    torch.testing.assert_close(sample.mean((0, 1)), probs, atol=0.01, rtol=0)


def test_samples_carry_a_gradient(generator: torch.Generator):
    logits = torch.zeros(5, 6, 2, requires_grad=True)
    InteractionGraph(logits, FOLLOWING).sample(generator)[..., 1].sum().backward()
    assert logits.grad is not None
    assert (logits.grad[..., 1] > 0).all()


def test_who_would_react_to_nobody_reacts_to_the_most_probable_one_if_that_is_likely_enough():
    """By hand: P(follow) of the pairs into 0 is .3 and .2, into 1 it is .04 and .02."""
    follows = {(1, 0): 0.3, (2, 0): 0.2, (0, 1): 0.02, (2, 1): 0.04, (0, 2): 0.4, (1, 2): 0.1}
    p = torch.tensor([follows[pair] for pair in pairs(3)])
    graph = InteractionGraph(torch.stack([1 - p, p], -1).log()[None], FOLLOWING)
    cautious = graph.reacting_in_doubt([0, 1], 0.05)
    assert cautious.edges() == {(1, 0): (EdgeType.FOLLOW, pytest.approx(0.3))}  # 1 is sure enough, 2 is not asked
    torch.testing.assert_close(cautious.probs, graph.probs)
    assert cautious.one_hot[0, pairs(3).index((1, 0))].tolist() == [0.0, 1.0]
    assert graph.reacting_in_doubt([1], 0.05).in_doubt is None
    unknown = replace(graph, unknown=torch.tensor([1.2])).reacting_in_doubt([1], 0.05)
    assert set(unknown.edges()) == {(2, 1)}  # nothing is certain in a scene that the model does not know


def test_who_reacts_to_somebody_is_in_no_doubt_and_a_cut_in_is_no_reaction():
    graph = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, LANE_CHANGING)
    assert graph.reacting_in_doubt([0], 0.0).in_doubt is None
    logits = torch.zeros(1, 6, 4)
    logits[0, pairs(3).index((1, 0))] = torch.tensor([0.0, -1.0, -3.0, 5.0])  # cut in, or else follow rather than yield
    logits[0, pairs(3).index((2, 0))] = torch.tensor([5.0, -3.0, 0.0, -3.0])
    cautious = InteractionGraph(logits, LANE_CHANGING).reacting_in_doubt([0], 0.001)
    assert {pair: kind for pair, (kind, _) in cautious.edges().items() if pair[1] == 0} == {
        (1, 0): EdgeType.CUT_IN,
        (2, 0): EdgeType.YIELD,
    }


def test_doubt_moves_with_its_pairs_and_its_scenes():
    logits = torch.tensor([[0.1, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 0.0]])
    graph = InteractionGraph(torch.stack([logits, logits.flip(0)]), FOLLOWING).reacting_in_doubt([1], 0.05)
    assert graph.in_doubt is not None
    assert graph.in_doubt.nonzero().tolist() == [[0, pairs(3).index((0, 1))], [1, pairs(3).index((2, 1))]]
    sparse = graph.on(((0, 1), (1, 3)))
    assert sparse.in_doubt is not None
    assert sparse.in_doubt.tolist() == [[True, False], [False, False]]
    assert sparse.map.tolist() == [[1, 0], [0, 0]]
    assert graph[1:].map.equal(graph.map[1:])
