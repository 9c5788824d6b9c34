"""Rules that hand-made candidates violate: vehicles 20 m apart at 10 m/s, 30 steps."""

import numpy as np
import pytest

from cosim.measures.relation_labels import CUT_IN, FOLLOW, NONE, YIELD, PairLabels
from cosim.scenes.scene_filters import violations
from cosim.scenes.scene_rules import Rules
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
