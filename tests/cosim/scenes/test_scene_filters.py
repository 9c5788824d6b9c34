"""Which hand-made candidates break which rule: vehicles 20 m apart at 10 m/s, 30 steps."""

import numpy as np
import pytest

from cosim.measures.relation_labels import CUT_IN, FOLLOW, NOBODY, NONE, YIELD, DriverRecords, PairLabels
from cosim.scenes.rules import Rules
from cosim.scenes.scene_filters import SceneFilter
from cosim.scenes.trajectory_buffer import RoadSection
from gri.core.graph import pairs

T = 30


def broken(types: np.ndarray, d: np.ndarray, gap: float = 20.0) -> list[str]:
    """Names of the rules that a row of three breaks."""
    shape = (1, 3, T)
    v, nobody, never = np.full(shape, 10.0), np.full(shape, NOBODY), np.full(shape, np.inf)
    told = DriverRecords(
        vehicle=np.array([[0, 1, 2]]), v=v, v_next=v, free=v, behind=never, beside=never, noise=v * 0, leader=nobody,
        asker=nobody, target=nobody, gave_way=v < 0, cut=nobody, room=never, dt=0.2,
    )  # fmt: skip
    s = np.arange(3.0)[None, :, None] * gap + 2.0 * np.arange(T + 1)
    sieve = SceneFilter(Rules(), RoadSection.__new__(RoadSection), 0.2, 1, 5, False)
    found = sieve._broken("car_following", told, s, d, PairLabels(types, np.zeros(types.shape)))
    return [name for name, scenes in found if scenes[0]]


def chain() -> np.ndarray:
    types = np.full((1, 6, T), NONE)
    types[0, [pairs(3).index((1, 0)), pairs(3).index((2, 1))]] = FOLLOW
    return types


def test_a_row_of_followers_breaks_no_rule():
    assert broken(chain(), np.zeros((1, 3, T + 1))) == []
    assert broken(chain(), np.zeros((1, 3, T + 1)), gap=55.0) == ["too far apart"]


@pytest.mark.parametrize("kind", [YIELD, CUT_IN])
def test_a_row_in_which_somebody_does_not_follow_only_is_none(kind: int):
    types = chain()
    types[0, pairs(3).index((1, 0)), :5] = kind
    assert broken(types, np.zeros((1, 3, T + 1))) == ["another relation than following"]


def test_who_changes_lanes_or_reacts_to_nobody_is_told():
    over = np.zeros((1, 3, T + 1))
    over[0, 1, 12:] = 3.5
    assert broken(chain(), over) == ["a vehicle changes lanes"]
    assert broken(np.full((1, 6, T), NONE), np.zeros((1, 3, T + 1))) == ["too little interaction"]
