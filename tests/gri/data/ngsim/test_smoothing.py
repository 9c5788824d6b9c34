import numpy as np
import pytest
import torch

from gri.core.dynamics import POINT_MASS_1D, POINT_MASS_2D
from gri.data.ngsim.defects import Tracks
from gri.data.ngsim.smoothing import Smoothing, smooth_axis, smoothed

DT = 0.2


def tracks(x: np.ndarray, y: np.ndarray) -> Tracks:
    ones = np.ones(len(x), int)
    frame = np.arange(5, 5 + len(x))
    return Tracks(ones, 0 * ones, frame, x, y, 4.0 * ones, 2.0 * ones, 2 * ones, ones)


def test_states_obey_the_models_dynamics_exactly():
    time = np.arange(100) * 0.1
    rng = np.random.default_rng(0)
    noisy = 8 * time + np.sin(time) + rng.normal(0, 0.2, 100)
    motion = smoothed(tracks(noisy, np.cos(time) + rng.normal(0, 0.1, 100)), Smoothing())
    state = torch.tensor(np.stack([motion.x, motion.y, motion.vx, motion.vy, motion.ax, motion.ay], -1))
    action = POINT_MASS_2D.inverse(state[:-1], state[1:], DT)
    torch.testing.assert_close(POINT_MASS_2D.step(state[:-1], action, DT), state[1:])
    along = state[:, [0, 2, 4]]
    action = POINT_MASS_1D.inverse(along[:-1], along[1:], DT)
    torch.testing.assert_close(POINT_MASS_1D.step(along[:-1], action, DT), along[1:])
    assert (motion.step == np.arange(3, 53)[: len(motion)]).all()  # frames 6, 8, ...


def test_polynomials_of_the_filters_degree_pass_unchanged():
    time = np.arange(60) * 0.1
    kept = np.arange(0, 60, 2)
    x, v, a, deviation = smooth_axis(3 + 10 * time + 0.5 * time**2, kept, Smoothing())
    np.testing.assert_allclose(v, 10 + time[kept], atol=1e-8)
    np.testing.assert_allclose(a, 1.0, atol=1e-7)
    np.testing.assert_allclose(x, 3 + 10 * time[kept] + 0.5 * time[kept] ** 2, atol=1e-8)
    assert deviation < 1e-8


def test_noise_becomes_smaller_and_nobody_reverses():
    rng = np.random.default_rng(1)
    standing = rng.normal(0, 0.05, 200)
    motion = smoothed(tracks(standing, standing), Smoothing())
    assert motion.vx.min() >= 0
    assert motion.vy.std() < 0.1 * (np.diff(standing) / 0.1).std()
    assert motion.deviation < 0.3


def test_tracks_shorter_than_the_window_are_left_out():
    assert len(smoothed(tracks(np.arange(15.0), np.zeros(15)), Smoothing())) == 0
    assert Smoothing().dt == pytest.approx(DT)
