"""The sequential test: its error under optional stopping on simulated null runs, and its power."""

import numpy as np
import pytest

from cosim.measures.sequential_test import capital, decide

RUNS, CLUSTERS, SIZE = 10_000, 120, 4


def correlated(rng: np.random.Generator, p_a: float, p_b: float, correlation: float) -> np.ndarray:
    """Differences of two shares [runs, clusters, starts]; each seed has its own traffic, good for one or the other."""
    shape = (1 - correlation) / correlation
    failing = [rng.beta(p * shape, (1 - p) * shape, (RUNS, CLUSTERS, 1)) for p in (p_a, p_b)]
    a, b = (rng.uniform(size=(RUNS, CLUSTERS, SIZE)) < p for p in failing)
    return a.astype(float) - b


def lopsided(rng: np.random.Generator) -> np.ndarray:
    """Equal means, but not symmetric: a fails in all starts of a few seeds, b now and then in the others."""
    bad = rng.uniform(size=(RUNS, CLUSTERS, 1)) < 0.1
    b = rng.uniform(size=(RUNS, CLUSTERS, SIZE)) < 1 / 9
    return np.where(bad, 1.0, -b.astype(float))


def first_decisions(differences: np.ndarray, error: float) -> np.ndarray:
    """For each run whether the test decides at any of the clusters; like `decide`, for many runs at once."""
    decided = np.zeros(len(differences), dtype=bool)
    for k, run in enumerate(differences):
        decided[k] = ((capital(run) + capital(-run)) / 2 >= 1 / error).any()
    return decided


@pytest.mark.parametrize("error", [0.05, 0.2])
@pytest.mark.parametrize("kind", ["correlated", "lopsided"])
def test_at_most_the_stated_share_of_10000_null_runs_is_ever_decided(rng, kind, error):
    """Looking after every cluster and stopping at the first decision. All bounds are without a margin."""
    starts = correlated(rng, 0.2, 0.2, 0.3) if kind == "correlated" else lopsided(rng)
    assert first_decisions(starts.mean(-1), error).mean() <= error


def test_p_values_that_are_looked_at_again_and_again_decide_too_often(rng):
    """What the test is for: a t-test of the same clusters, looked at after every one from the tenth on."""
    x = correlated(rng, 0.2, 0.2, 0.3)[:2000].mean(-1)
    n = np.arange(1, CLUSTERS + 1)
    mean = x.cumsum(1) / n
    spread = np.sqrt(np.maximum((x**2).cumsum(1) / n - mean**2, 1e-12) / n)
    assert (np.abs(mean / spread)[:, 9:] > 1.98).any(1).mean() > 0.2


def test_starts_of_one_cluster_may_not_be_bet_on_one_after_the_other(rng):
    """Each start taken as a cluster decides more than 5 % of null runs, because the first tells about the next."""
    starts = correlated(rng, 0.2, 0.2, 0.9)[:1000]
    assert first_decisions(starts.reshape(len(starts), -1), 0.05).mean() > 0.1


def test_a_known_difference_is_found(rng):
    """30 % against 10 % failures: decided within 120 clusters of 4 starts in nine of ten runs, for the right policy."""
    x = correlated(rng, 0.3, 0.1, 0.1)[:500].mean(-1)
    found = [decide(run, 0.05) for run in x]
    assert np.mean([decision.better == 1 for decision in found]) > 0.9
    assert np.mean([decision.better == -1 for decision in found]) < 0.01
    assert np.median([decision.clusters for decision in found]) < 50


def test_capital_by_hand():
    """One cluster of difference 1 multiplies the capital of the stake λ by 1 + λ: 1.5 on average."""
    assert capital(np.array([1.0])) == pytest.approx([1.5])
    assert capital(np.array([-1.0])) == pytest.approx([0.5])
    assert capital(np.array([1.0, -1.0]))[-1] < 1, "nothing is won by a draw"
    assert decide(np.array([]), 0.05).better == 0


def test_a_decision_stands_whatever_comes_later():
    clear = np.ones(12)
    found = decide(clear, 0.05)
    assert (found.better, found.mean_difference) == (1, 1.0)
    assert found.clusters < 12
    assert decide(np.append(clear, -np.ones(50)), 0.05) == found
    assert decide(-clear, 0.05).better == -1
    assert decide(clear[: found.clusters - 1], 0.05).better == 0


def test_evidence_by_hand():
    """Stakes λ = 0.05, 0.10, …, 0.95; their squares are 0.325 on average.

    After one cluster of difference 1 it is ((1 + λ) + (1 − λ))/2 = 1; after two ((1 + λ)² + (1 − λ)²)/2 = 1 + λ². The
    second cluster of difference −1 leaves 1 − λ² of both.
    """
    assert decide(np.array([1.0]), 0.05).e_value == pytest.approx(1.0)
    assert decide(np.array([1.0, 1.0]), 0.05).e_value == pytest.approx(1.325)
    assert decide(np.array([1.0, -1.0]), 0.05).e_value == pytest.approx(0.675)
    undecided = decide(np.array([1.0, 0.5]), 0.05)
    assert (undecided.better, undecided.clusters, undecided.mean_difference) == (0, 2, 0.75)
    decided = decide(np.array([0.5, 1.0, 1.0, -1.0]), 1 / 1.6)  # 1 + λ²·(0.5 + 0.5 + 1) = 1.65 after three
    assert (decided.better, decided.clusters) == (1, 3)
    assert decided.e_value == pytest.approx(1.65)
    assert decided.mean_difference == pytest.approx(2.5 / 3)


def test_without_clusters_there_is_no_evidence():
    found = decide(np.array([]), 0.05)
    assert (found.better, found.e_value, found.clusters) == (0, 1.0, 0)
    assert np.isnan(found.mean_difference)


def test_values_out_of_range_are_refused():
    with pytest.raises(AssertionError, match=r"in \[−1, 1\]"):
        capital(np.array([1.5]))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(18)
