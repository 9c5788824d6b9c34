"""Scores, worked by hand."""

import numpy as np
import pytest

from gri.bench.scores import (
    COVERAGES,
    abstention_area,
    auc,
    balanced_accuracy,
    calibration_error,
    false_follow,
    macro_f1,
    reliability,
    risk_curve,
    score,
    unknown_auc,
)

P = np.array([[0.9, 0.2], [0.6, 0.4], [0.3, 0.8]])
TRUTH = np.array([[True, False], [False, True], [False, True]])


def test_balanced_accuracy():
    """Found: .9 and .8 of three edges; left out: .2 and .3 of three. (2/3 + 2/3) / 2."""
    assert balanced_accuracy(P, TRUTH) == pytest.approx(2 / 3)


@pytest.mark.parametrize("constant", [0.0, 0.4, 1.0])
def test_a_constant_answer_is_worth_one_half(constant):
    p = np.full_like(P, constant)
    assert balanced_accuracy(p, TRUTH) == 0.5
    assert auc(p, TRUTH) == 0.5


def test_auc_counts_pairs_of_an_edge_and_a_missing_one():
    """Edges .9 .4 .8, missing .2 .6 .3: of nine pairs only .4 against .6 is wrong."""
    assert auc(P, TRUTH) == pytest.approx(8 / 9)


def test_macro_f1():
    """Follow: 2·2/(3 + 3); none the same."""
    assert macro_f1(P, TRUTH) == pytest.approx(2 / 3)


def test_false_follow():
    assert false_follow(P, TRUTH) == pytest.approx(1 / 3)
    assert np.isnan(false_follow(P, np.ones_like(TRUTH)))


def test_calibration_error():
    """Answers at .9 right, .8 right, .6 wrong, .6 wrong, .7 right, .8 right; bins are .5–.55 … .95–1.

    .9: |1 − .9| = .1; both .8: |2 − 1.6| = .4; both .6: |0 − 1.2| = 1.2; .7: |1 − .7| = .3; (.1 + .4 + 1.2 + .3) / 6.
    """
    assert calibration_error(P, TRUTH) == pytest.approx(2.0 / 6)


def test_without_any_edge_only_false_follow_has_a_value():
    nothing = np.zeros_like(TRUTH)
    assert np.isnan(score("balanced_accuracy", P, nothing).value)
    assert np.isnan(score("balanced_accuracy", P, nothing).low)
    assert score("false_follow", P, nothing).value == pytest.approx(0.5)


def test_intervals_cover_what_is_known():
    """Scenes whose pairs agree: the interval is as wide as that of scenes, not of pairs."""
    rng = np.random.default_rng(0)
    right = rng.permutation(400) < 320
    truth = np.tile(rng.random(400)[:, None] < 0.5, (1, 3))
    p = np.where(right[:, None], truth, ~truth).astype(float)
    found = score("balanced_accuracy", p, truth)
    assert found.low < 0.8 < found.high
    assert 0.06 < found.high - found.low < 0.1


def test_reliability():
    """Bins of P(follow): .2, .3, .4, .6, .8, .9 with the truths 0, 0, 1, 0, 1, 1."""
    found = reliability(P, TRUTH)
    assert found["pairs"] == [0, 0, 1, 1, 1, 0, 1, 0, 1, 1]
    assert found["true"] == [0, 0, 0, 0, 1, 0, 0, 0, 1, 1]
    assert sum(found["p"]) == pytest.approx(P.sum())


def test_abstention_area():
    """Wrong are .4 and .6, which are trusted least: risks 0, 0, 0, 0, 1/5, 2/6. The other way round: 1, 1, 2/3 …"""
    doubt = 1 - np.maximum(P, 1 - P)
    assert abstention_area(P, TRUTH, doubt) == pytest.approx((1 / 5 + 2 / 6) / 6)
    assert abstention_area(P, TRUTH, -doubt) == pytest.approx((1 + 1 + 2 / 3 + 2 / 4 + 2 / 5 + 2 / 6) / 6)


def test_trust_that_says_nothing_gives_the_share_of_wrong_answers():
    same = np.zeros_like(P)
    assert abstention_area(P, TRUTH, same) == pytest.approx(2 / 6)
    assert risk_curve(P, TRUTH, same) == pytest.approx([2 / 6] * len(COVERAGES))


def test_risk_at_full_coverage_is_the_share_of_wrong_answers():
    doubt = 1 - np.maximum(P, 1 - P)
    curve = risk_curve(P, TRUTH, doubt)
    assert (curve[0], curve[-1]) == pytest.approx((0, 2 / 6))


def test_unknown_auc():
    """Unknown .7 and .2 against known .5 and .1: three of four pairs are in order."""
    assert unknown_auc(np.array([0.7, 0.2, 0.5, 0.1]), np.array([True, True, False, False])) == pytest.approx(0.75)
