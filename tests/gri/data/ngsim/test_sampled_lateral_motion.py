import numpy as np
import pytest

from gri.data.ngsim import sampled_lateral_motion


@pytest.fixture
def y() -> np.ndarray:
    return sampled_lateral_motion.sample_lateral_motion(1000, 40, 0.2, (8, 32), np.random.default_rng(0))["y"]


def test_lateral_offsets_in_one_lane_are_as_large_as_recorded_ones(y: np.ndarray):
    mean = y.mean(2)
    assert (mean[:, 1] - mean[:, 2]).std() == pytest.approx(0.43, rel=0.1)  # US-101, for training: 0.41 to 0.45 m


def test_vehicle_0_comes_from_either_adjacent_lane(y: np.ndarray):
    change = y[:, 0, -1] - y[:, 0, 0]
    assert np.abs(change).mean() == pytest.approx(sampled_lateral_motion.LANE_WIDTH, abs=0.3)
    assert (change > 0).mean() == pytest.approx(0.5, abs=0.1)
    assert np.abs(np.diff(y[:, 1:], axis=2)).max() < 0.1  # the others keep their lane
