"""Effects of drivers that decide at every third step."""

import numpy as np

from cosim.measures.relation_labels import NO_VEHICLE
from cosim.scenes.last_decisions import LastDecisions


def held(effects: list[float], causes: list[int], steps: int = 3) -> tuple[list[float], list[bool]]:
    """The effects in force and whether they are known, for one vehicle."""
    decisions, found = LastDecisions(), []
    for effect, cause in zip(effects, causes, strict=True):
        one = decisions.update(np.array([7]), np.array([cause]), np.array([effect]), np.array([steps]))
        found.append((float(one[0][0]), bool(one[1][0])))
    return [of for of, _ in found], [of for _, of in found]


def test_an_effect_lasts_until_the_next_decision():
    assert held([-1.0, 0.0, 0.0, -0.5, 0.0, 0.0], [9] * 6)[0] == [-1.0, -1.0, -1.0, -0.5, -0.5, -0.5]
    assert held([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [9] * 6)[0] == [-1.0, -1.0, -1.0, 0.0, 0.0, 0.0]


def test_an_early_decision_begins_a_new_interval():
    assert held([-1.0, 0.0, -3.0, 0.0, 0.0, 0.0], [9] * 6)[0] == [-1.0, -1.0, -3.0, -3.0, -3.0, 0.0]


def test_an_effect_ends_with_its_cause():
    assert held([-1.0, 0.0, 0.0, -2.0], [9, 8, NO_VEHICLE, 8])[0] == [-1.0, 0.0, 0.0, -2.0]


def test_the_decision_of_a_new_vehicle_is_unknown_until_it_decides():
    assert held([0.0, 0.0, 0.0, 0.0], [9] * 4)[1] == [False, False, True, True]
    assert held([0.0, -1.0, 0.0], [9] * 3)[1] == [False, True, True]


def test_drivers_that_decide_at_every_step_are_left_as_they_are():
    assert held([-1.0, 0.0, -0.5], [9] * 3, steps=1) == ([-1.0, 0.0, -0.5], [True] * 3)


def test_a_vehicle_that_left_is_forgotten():
    decisions = LastDecisions()
    one = np.array([1]), np.array([2]), np.array([-1.0]), np.array([3])
    decisions.update(*one)
    decisions.update(*(values[:0] for values in one))
    effect, known = decisions.update(one[0], one[1], np.array([0.0]), one[3])
    assert (effect[0], known[0]) == (0.0, False)
