"""Rules that hand-made candidates violate: vehicles 20 m apart at 10 m/s, 30 steps."""

import numpy as np
import pytest

from cosim.measures.relation_labels import CUT_IN, FOLLOW, NONE, YIELD, PairLabels
from cosim.scenes.scene_filters import following_in_words, violations
from cosim.scenes.scene_rules import TRIPLE_SHARES, Rules
from gri.core.graph import pairs

T = 30


def violated(types: np.ndarray, d: np.ndarray, gap: float = 20.0) -> list[str]:
    """Names of the rules that a following chain violates."""
    s = np.arange(3.0)[None, :, None] * gap + 2.0 * np.arange(T + 1)
    found = violations("car_following", Rules(), s, d, PairLabels(types, np.zeros(types.shape)))
    return [name for name, scenes in found if scenes[0]]


def chain() -> np.ndarray:
    types = np.full((1, 6, T), NONE)
    types[0, [pairs(3).index((1, 0)), pairs(3).index((2, 1))]] = FOLLOW
    return types


def test_a_chain_of_followers_violates_no_rule():
    assert violated(chain(), np.zeros((1, 3, T + 1))) == []
    assert violated(chain(), np.zeros((1, 3, T + 1)), gap=55.0) == ["too far apart"]


@pytest.mark.parametrize("kind", [YIELD, CUT_IN])
def test_a_chain_with_another_relation_than_following_is_rejected(kind: int):
    types = chain()
    types[0, pairs(3).index((1, 0)), :5] = kind
    assert violated(types, np.zeros((1, 3, T + 1))) == ["another relation than following"]


def test_lane_changes_and_a_lack_of_interaction_are_rejected():
    over = np.zeros((1, 3, T + 1))
    over[0, 1, 12:] = 3.5
    assert violated(chain(), over) == ["a vehicle changes lanes"]
    assert violated(np.full((1, 6, T), NONE), np.zeros((1, 3, T + 1))) == ["too little interaction"]


def test_triples_may_have_no_interaction_but_keep_their_distances():
    none = np.full((1, 6, T), NONE)

    def triple(gap: float) -> list[str]:
        s = np.arange(3.0)[None, :, None] * gap + 2.0 * np.arange(T + 1)
        found = violations("triple", Rules(), s, np.zeros((1, 3, T + 1)), PairLabels(none, np.zeros(none.shape)))
        return [name for name, scenes in found if scenes[0]]

    assert triple(60.0) == []
    assert triple(5.0) == ["too close or in another order"]
    assert triple(120.0) == ["too far apart"]


def test_a_graph_in_words_is_a_name_of_the_wanted_shares():
    graph = np.full(6, NONE)
    assert following_in_words(graph) == "nobody follows"
    graph[[pairs(3).index((1, 0)), pairs(3).index((2, 1))]] = FOLLOW
    assert following_in_words(graph) == "0 follows 1, 1 follows 2"
    assert abs(sum(TRIPLE_SHARES.values()) - 1) < 1e-9


def test_the_shares_of_triples_leave_no_constant_graph_right_in_more_than_60_percent():
    edges = {"0 follows 1": 0, "0 follows 2": 1, "1 follows 2": 2}
    true = np.zeros(3)
    for name, share in TRIPLE_SHARES.items():
        for part in name.split(", "):
            if part in edges:
                true[edges[part]] += share
    assert np.maximum(true, 1 - true).mean() <= 0.6
