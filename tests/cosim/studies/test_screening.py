"""Elementary effects of functions whose effects are known."""

import numpy as np
import pytest

from cosim.studies.screening import STEP, effects, paths, scaled

NAMES = ("strong", "weak", "idle", "coupled")


def results_of(points: np.ndarray) -> np.ndarray:
    """3·strong − weak/2 + coupled·strong."""
    strong, weak, _, coupled = np.moveaxis(points, -1, 0)
    return 3 * strong - weak / 2 + coupled * strong


def test_each_path_changes_each_parameter_once_within_its_range():
    points = paths(4, 50, np.random.default_rng(0))
    moved = np.diff(points, axis=1)
    assert points.shape == (50, 5, 4)
    assert points.min() >= 0.0
    assert points.max() <= 1.0
    assert np.allclose(np.abs(moved).sum(1), STEP)
    assert ((np.abs(moved) > 1e-9).sum(-1) == 1).all()
    assert set(np.sign(moved[moved != 0])) == {-1.0, 1.0}


def test_effects_of_a_known_function():
    points = paths(4, 200, np.random.default_rng(1))
    found = {effect.parameter: effect for effect in effects(NAMES, points, results_of(points))}
    assert [effect.parameter for effect in effects(NAMES, points, results_of(points))][::3] == ["strong", "idle"]
    assert found["weak"].mu == pytest.approx(-0.5)
    assert found["weak"].mu_star == pytest.approx(0.5)
    assert found["weak"].sigma == pytest.approx(0.0, abs=1e-9)
    assert found["idle"].mu_star == pytest.approx(0.0, abs=1e-9)
    assert found["strong"].mu == pytest.approx(3.5, abs=0.1)  # 3 and the mean of `coupled`
    assert found["coupled"].sigma > 0.3  # depends on `strong`


def test_an_unknown_result_counts_for_nothing():
    points = paths(4, 3, np.random.default_rng(2))
    results = results_of(points)
    results[0] = np.nan
    found = {effect.parameter: effect for effect in effects(NAMES, points, results)}
    assert found["weak"].mu == pytest.approx(-0.5)
    assert np.isnan(effects(NAMES, points, np.full((3, 5), np.nan))[0].mu_star)


def test_points_become_values_around_the_initial_ones():
    assert scaled((2.0, 10.0), 0.25, np.array([0.0, 1.0])) == (1.5, 12.5)
    assert scaled((2.0, 10.0), 0.25, np.array([0.5, 0.5])) == (2.0, 10.0)
