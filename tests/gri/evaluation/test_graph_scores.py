from itertools import permutations
from math import log

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from gri.evaluation.graph_scores import (
    best_label_matching,
    edge_budget,
    edges_into_driven,
    f1,
    renamed,
    shuffled,
    unshuffled,
)
from gri.evaluation.metrics import proportion
from gri.training.optimisation import categorical_kl

TRUE = torch.tensor([[0, 0, 1, 0, 0, 1], [0, 0, 1, 0, 0, 1]])


def test_f1_by_hand():
    inferred = torch.tensor([[0, 0, 1, 0, 0, 0], [1, 0, 1, 0, 0, 1]])
    # "follow": 3 of 4 found, 1 false: 2*3 / (2*3 + 1 + 1)
    assert f1(inferred, TRUE, 1) == pytest.approx(6 / 8)
    assert f1(inferred, TRUE, 0) == pytest.approx(14 / 16)
    assert f1(inferred, TRUE, 2) is None


def test_edges_into_driven_vehicles_leave_out_those_into_the_leader():
    assert edges_into_driven(torch.arange(6)[None]).tolist() == [[0, 2, 4, 5]]  # 0->1, 1->0, 2->0, 2->1


def test_swapped_labels_are_renamed_only_where_label_0_may_move():
    swapped = 1 - TRUE
    assert best_label_matching(swapped, TRUE, 2, move_none=True) == (1, 0)
    assert (renamed(swapped, (1, 0)) == TRUE).all()
    assert best_label_matching(swapped, TRUE, 2, move_none=False) == (0, 1)


def test_the_best_naming_is_one_for_the_whole_data_set():
    true = torch.tensor([[1, 2, 3], [1, 2, 3]])
    assert best_label_matching(torch.tensor([[2, 3, 1], [2, 3, 1]]), true, 4, move_none=False) == (0, 3, 1, 2)


@given(st.integers(2, 4), st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=12))
def test_the_mean_over_all_namings_is_one_over_k_and_the_best_no_less(k: int, edges: list[tuple[int, int]]):
    inferred, true = (torch.tensor([[edge[side] % k for edge in edges]]) for side in (0, 1))
    shares = [float((renamed(inferred, order) == true).double().mean()) for order in permutations(range(k))]
    assert sum(shares) / len(shares) == pytest.approx(1 / k)
    best = best_label_matching(inferred, true, k, move_none=True)
    assert float((renamed(inferred, best) == true).double().mean()) >= 1 / k - 1e-9


def test_edge_budget_is_the_kl_of_a_certain_graph():
    prior = torch.tensor([0.9, 0.1])
    certain = (torch.nn.functional.one_hot(TRUE[:1], 2).float() - 1) * 60
    assert edge_budget(2, 6, 0.9) == pytest.approx((-4 * log(0.9) - 2 * log(0.1)) / 6)  # 0.84 nats for the chain
    assert float(categorical_kl(certain, prior).mean()) == pytest.approx(edge_budget(2, 6, 0.9), abs=1e-5)
    # four types, three of six edges: 1.80 nats at p0 = 0.91
    assert edge_budget(3, 6, 0.91, types=4) == pytest.approx(1.80, abs=0.005)


def test_wilson_interval_by_hand():
    none = proportion(torch.zeros(10, dtype=torch.bool))
    # centre z^2/(2n) / (1 + z^2/n), half width z * sqrt(z^2 / 4n^2) / (1 + z^2/n), both z^2 / (2 (n + z^2))
    assert none.half_width == pytest.approx(1.96**2 / (2 * (10 + 1.96**2)))
    half = proportion(torch.arange(100) < 50)
    assert half.half_width == pytest.approx(1.96 * (0.25 / 100 + 1.96**2 / 40000) ** 0.5 / (1 + 1.96**2 / 100))


def test_edges_come_back_to_their_pairs_after_a_shuffle():
    order = torch.tensor([2, 0, 1])
    state = torch.arange(3.0)[None, :, None, None]
    assert shuffled(state, order).flatten().tolist() == [2, 0, 1]
    # places 0,1,2 hold vehicles 2,0,1: the pair 1->0 stands at places 2->1, the last of the edge axis
    found = unshuffled(torch.tensor([[10, 11, 12, 13, 14, 15]]), order)
    assert found[0, 2] == 15
    assert sorted(found[0].tolist()) == list(range(10, 16))
