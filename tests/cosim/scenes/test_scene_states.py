"""States of scene files from positions along lanes."""

import numpy as np
import pytest
import torch

from cosim.scenes.scene_states import scene_features
from cosim.scenes.trajectory_buffer import Lane
from gri.core.dynamics import POINT_MASS_1D, POINT_MASS_2D


def driven(steps: int = 41, step: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """s and v of one vehicle as SUMO moves it: x' = x + v'·h."""
    a = np.random.default_rng(1).uniform(-2, 2, steps * round(0.2 / step))
    v = 10 + np.cumsum(a) * step
    s = 100 + np.cumsum(v) * step
    every = round(0.2 / step)
    return s[None, None, ::every], v[None, None, ::every]


@pytest.mark.parametrize("dynamics", [POINT_MASS_1D, POINT_MASS_2D])
def test_states_obey_the_papers_point_mass(dynamics):
    s, v = driven()
    d = np.where(np.arange(41) < 20, -3.5, 0.0)[None, None]
    found = scene_features(s, d, v, 0.2, 3.0)
    state = torch.from_numpy(np.stack([found[name] for name in dynamics.state], -1))
    action = dynamics.inverse(state[..., :-1, :], state[..., 1:, :], 0.2)
    torch.testing.assert_close(dynamics.step(state[..., :-1, :], action, 0.2), state[..., 1:, :])


def test_with_a_finer_step_positions_are_off_by_little():
    s, v = driven(step=0.05)
    found = scene_features(s, np.zeros_like(s), v, 0.05, 3.0)
    x = found["x"][0, 0]
    predicted = x[:-1] + 0.2 * found["v"][0, 0, :-1] + 0.02 * found["a"][0, 0, :-1]
    assert np.abs(predicted - x[1:]).max() < 0.03


def test_a_lane_change_begins_where_sumo_makes_it_and_takes_three_seconds():
    s, v = driven()
    d = np.where(np.arange(41) < 20, -3.5, 0.0)[None, None]
    y = scene_features(s, d, v, 0.2, 3.0)["y"][0, 0]
    assert np.abs(y[:19] + 3.5).max() < 0.02
    assert np.abs(y[36:]).max() < 0.02
    assert (np.diff(y) > -1e-9).all()
    assert y[26] == pytest.approx(-1.75, abs=0.3)
    heading = scene_features(s, d, v, 0.2, 3.0)["heading"][0, 0]
    assert heading.max() == pytest.approx(np.arctan2(1.875 * 3.5 / 3.0, 10), rel=0.1)
    assert (np.diff(scene_features(s, d, v, 0.2, 0.0)["y"][0, 0]) != 0).sum() <= 3


def test_a_lane_change_after_the_last_step_does_not_show():
    s, v = driven()
    d = np.where(np.arange(41) < 40, -3.5, 0.0)[None, None]
    found = scene_features(s, d, v, 0.2, 3.0)
    assert np.abs(found["y"] + 3.5).max() == 0
    assert np.abs(found["ay"]).max() == 0


def test_positions_along_a_lane_become_points_of_its_centre():
    lane = Lane("road", np.array([[0.0, 0.0], [30.0, 40.0], [30.0, 90.0]]), 200.0, 0.0)  # the shape is 100 m long
    np.testing.assert_allclose(lane.points(np.array([0.0, 100.0, 150.0])), [[0, 0], [30, 40], [30, 65]])
