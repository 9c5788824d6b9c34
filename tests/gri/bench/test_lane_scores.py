"""Scores of typed relations, worked by hand."""

import numpy as np
import pytest

from gri.bench.lane_scores import (
    accuracy,
    calibration_counts,
    calibration_error,
    confusion_counts,
    false_relation,
    macro_f1,
    recall,
    scores_of,
    with_interval,
)

TRUTH = np.array([[[0], [0], [1], [2]], [[0], [1], [1], [2]]])
CALLED = np.array([[[0], [1], [1], [0]], [[0], [1], [2], [2]]])
EVERY = np.ones_like(TRUTH, bool)
NAMES = ("none", "follow", "yield", "cut_in")


def sums(scored: np.ndarray = EVERY) -> np.ndarray:
    return confusion_counts(CALLED, TRUTH, scored, 4).sum(0, keepdims=True)


def test_counts_by_hand():
    """none: 2 of 3 found, called 3; follow: 2 of 3, called 3; yield: 1 of 2, called 2; cut-in does not occur."""
    assert accuracy(sums())[0] == pytest.approx(5 / 8)
    assert macro_f1(sums())[0] == pytest.approx((4 / 6 + 4 / 6 + 2 / 4) / 3)
    assert recall(2)(sums())[0] == pytest.approx(1 / 2)
    assert np.isnan(recall(3)(sums())[0])
    assert false_relation(sums())[0] == pytest.approx(1 / 3)


def test_only_scored_steps_count():
    scored = EVERY.copy()
    scored[CALLED != TRUTH] = False
    assert accuracy(sums(scored))[0] == 1.0
    assert sums(scored).sum() == 5


def test_calibration_error():
    """Answers at .9 right, .9 wrong, .5 right, .5 wrong: |1 − 1.8| + |1 − 1.0| of four."""
    p = np.array([[[[0.9, 0.1]], [[0.9, 0.1]]], [[[0.5, 0.5]], [[0.5, 0.5]]]])
    truth = np.array([[[0], [1]], [[0], [1]]])
    counts = calibration_counts(p, truth, np.ones_like(truth, bool)).sum(0, keepdims=True)
    assert calibration_error(counts)[0] == pytest.approx(0.8 / 4)


def test_intervals_are_over_scenes_not_steps():
    """400 scenes, each wholly right or wrong: as wide as 400 draws, whatever the number of steps."""
    right = np.random.default_rng(0).permutation(400) < 320
    truth = np.zeros((400, 30, 2), int)
    called = np.where(right[:, None, None], truth, 1)
    found = with_interval(accuracy, confusion_counts(called, truth, np.ones_like(truth, bool), 4))
    assert found.value == pytest.approx(0.8)
    assert 0.06 < found.high - found.low < 0.1


def test_nothing_scored_has_no_value():
    found = scores_of(np.eye(4)[CALLED], TRUTH, ~EVERY, NAMES)
    assert set(found) == {"accuracy", "macro_f1", "calibration_error", *(f"recall_{name}" for name in NAMES)}
    assert all(np.isnan(score.value) for score in found.values())
