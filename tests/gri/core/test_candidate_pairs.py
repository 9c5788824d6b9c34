"""Candidate pairs: the rule by hand, against a slow form, and its cost."""

import numpy as np
import pytest

from gri.core.candidate_pairs import candidate_pairs, lanes_touched


def in_lanes(*lanes: int) -> np.ndarray:
    return np.array(lanes)[:, None].repeat(2, 1)


def test_own_lane_has_the_next_ahead_and_the_next_behind():
    s, length = np.array([0.0, 30.0, 60.0, 200.0]), np.full(4, 5.0)
    found = candidate_pairs(s, in_lanes(0, 0, 0, 0), length)
    assert found.tolist() == [[0, 1], [1, 0], [1, 2], [2, 1]]  # 3 is 135 m ahead of 2


def test_adjacent_lanes_have_everyone_alongside_and_no_lane_beyond():
    s, length = np.array([50.0, 10.0, 38.0, 46.0, 80.0, 95.0, 50.0]), np.array([20.0, 5, 5, 5, 5, 5, 5])
    lanes = in_lanes(1, 2, 2, 2, 2, 2, 3)
    senders = [i for i, j in candidate_pairs(s, lanes, length).tolist() if j == 0]
    assert senders == [1, 2, 3, 4]  # behind, both beside the truck, ahead; not the second ahead, not lane 3
    assert candidate_pairs(s, lanes, length, adjacent=False)[:, 1].tolist().count(0) == 0


def test_a_vehicle_between_two_lanes_is_in_both():
    d, width = np.array([0.0, 1.75, 3.5, 3.5]), np.full(4, 1.8)
    lanes = lanes_touched(d, width, 3.5)
    assert lanes.tolist() == [[0, 0], [0, 1], [1, 1], [1, 1]]
    found = candidate_pairs(np.array([0.0, 20.0, 40.0, 0.0]), lanes, np.full(4, 5.0), adjacent=False)
    assert {(1, 0), (2, 1), (1, 3)} <= {tuple(pair) for pair in found.tolist()}


def slow(s: np.ndarray, lanes: np.ndarray, length: np.ndarray, reach: float) -> set[tuple[int, int]]:
    """The rule in words, over all pairs."""
    found = set()
    for j in range(len(s)):
        for lane in {side + own for own in range(lanes[j, 0], lanes[j, 1] + 1) for side in (-1, 0, 1)}:
            others = [k for k in range(len(s)) if k != j and lanes[k, 0] <= lane <= lanes[k, 1]]
            ahead = [k for k in others if s[k] - length[k] > s[j]]
            behind = [k for k in others if s[k] < s[j] - length[j]]
            picked = {k for k in others if k not in ahead and k not in behind}
            picked |= {min(ahead, key=lambda k: s[k])} if ahead else set()
            picked |= {max(behind, key=lambda k: s[k])} if behind else set()
            found |= {(k, j) for k in picked if max(s[k] - length[k] - s[j], s[j] - length[j] - s[k]) <= reach}
    return found


@pytest.mark.parametrize("seed", range(40))
def test_the_rule_in_words(seed: int):
    """Vehicles that overlap in one lane may add pairs, never lose one."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 40))
    s, length = rng.uniform(0, 400, count), rng.choice([4.0, 5.0, 16.0], count)
    lanes = lanes_touched(rng.uniform(-1, 12, count), np.full(count, 1.8), 3.5)
    found = [(i, j) for i, j in candidate_pairs(s, lanes, length).tolist()]
    assert found == sorted(set(found))
    assert slow(s, lanes, length, 100.0) <= set(found)
    assert len(found) <= 3 * 3 * 5 * count


def test_pairs_grow_linearly_with_the_vehicles():
    rng = np.random.default_rng(0)
    for count in (500, 5000):
        s, lanes = rng.uniform(0, 12 * count, count), in_lanes(*rng.integers(0, 5, count))
        assert len(candidate_pairs(s, lanes, np.full(count, 5.0))) < 9 * count
