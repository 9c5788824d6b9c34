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
