import pytest
import torch

from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.evaluation import metrics


def test_rmse_divides_by_the_driven_vehicles_and_counts_the_start():
    recorded = torch.zeros(1, 3, 4, 3)
    state = recorded.clone()
    state[0, 0, :, 0] = torch.tensor([0.0, 1.0, 2.0, 3.0])
    # 14 / ((3 − 1)·4)
    assert metrics.rmse(state, recorded, 0).tolist() == pytest.approx([(14 / 8) ** 0.5])


def test_the_empty_graph_scores_two_thirds_on_the_chain():
    chain = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}, FOLLOWING).map
    empty = InteractionGraph.of_edges({}, FOLLOWING).map
    assert metrics.accuracy(empty, chain).tolist() == pytest.approx([4 / 6])
    assert metrics.driven_accuracy(empty, chain).tolist() == pytest.approx([2 / 4])


def test_an_edge_into_the_leader_counts_in_one_accuracy_only():
    chain = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, FOLLOWING).map
    other = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW, (0, 2): EdgeType.FOLLOW}, FOLLOWING).map
    assert metrics.accuracy(other, chain).tolist() == pytest.approx([5 / 6])
    assert metrics.driven_accuracy(other, chain).tolist() == [1.0]


def test_frequencies_are_printed_with_receivers_as_rows():
    graph = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW}, FOLLOWING).map
    frequency = metrics.edge_frequency(graph, 2)
    assert frequency[1, 0, 1] == 1.0
    assert frequency[1].sum() == 1.0
    assert frequency.sum() == 6.0


def test_success_needs_the_margin_at_the_end():
    final = torch.tensor([[[0.0, 0, 0], [2.0, 0, 0]], [[0.0, 0, 0], [1.9, 0, 0]]])
    assert metrics.success(final).tolist() == [True, False]


def test_collision_is_the_least_distance_of_the_two():
    state = torch.zeros(2, 2, 3, 3)
    state[0, 1, :, 0] = torch.tensor([9.0, 1.0, 9.0])
    state[1, 1, :, 0] = torch.tensor([9.0, 3.0, -3.0])
    assert metrics.collision(state).tolist() == [True, False]
    assert metrics.smallest_headway(state)[:, 0].tolist() == [1.0, -3.0]


def test_summary_by_hand():
    result = metrics.summary(torch.tensor([1.0, 3.0]))
    assert result.mean == 2.0
    assert result.std == pytest.approx(2**0.5)
    assert result.half_width == pytest.approx(1.96)


def test_a_proportion_of_one_still_has_an_interval():
    result = metrics.proportion(torch.ones(100, dtype=torch.bool))
    assert result.mean == 1.0
    assert 0.01 < result.half_width < 0.03
