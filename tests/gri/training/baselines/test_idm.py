from dataclasses import replace

import numpy as np
import pytest
import torch

from gri.core.dynamics import POINT_MASS_1D
from gri.core.policy import IntelligentDriver
from gri.core.scenes import Scenes
from gri.training.baselines import idm
from gri.training.optimisation import reconstruction_loss

DRIVER = IntelligentDriver(
    0.2, desired_speed=20.0, time_headway=1.5, minimum_gap=2.0, acceleration=1.0, deceleration=4.0
)


def leader(states: int, speed: float, place: float = 25.0, scenes: int = 1) -> torch.Tensor:
    """[S, T, 3] at constant speed."""
    x = place + speed * 0.2 * torch.arange(states)
    return torch.stack([x, torch.full_like(x, speed), torch.zeros_like(x)], -1).expand(scenes, -1, -1)


def test_the_first_steps_are_those_of_the_model():
    # Gap 25 − 5 = 20 m, closing at 2 m/s: s* = 22 m, a = 1 − (10/20)⁴ − (22/20)² = −0.2725 from the next step on.
    ahead = leader(3, 8.0)
    start = torch.stack([torch.tensor([[0.0, 10.0, 0.0]]), ahead[:, 0]], 1)
    state = idm.drive(DRIVER, start, ahead)
    torch.testing.assert_close(state[:, 1], ahead)
    torch.testing.assert_close(state[0, 0, 1], torch.tensor([2.0, 10.0, -0.2725]))
    torch.testing.assert_close(state[0, 0, 2, :2], torch.tensor([2.0 + 2.0 - 0.5 * 0.2725 * 0.04, 10 - 0.0545]))


def test_behind_a_standing_vehicle_nobody_reverses_or_hits_it():
    ahead = leader(150, 0.0, place=40.0)
    start = torch.stack([torch.tensor([[0.0, 8.0, 0.0]]), ahead[:, 0]], 1)
    state = idm.drive(DRIVER, start, ahead)
    assert (state[0, 0, :, 1] >= 0).all()
    assert (state[0, 0, 1:, 0] >= state[0, 0, :-1, 0]).all()
    assert float(state[0, 0, -1, 0]) < 40.0 - DRIVER.length


def recorded(driver: IntelligentDriver, count: int = 12, steps: int = 25) -> Scenes:
    """Scenes that the driver itself has driven behind leaders of different speeds."""
    generator = torch.Generator().manual_seed(3)
    ahead = torch.cat([leader(steps, float(v), 60.0) for v in torch.linspace(2, 14, count)])
    row = torch.tensor([0.0, 25.0]) + 6 * torch.rand(count, 2, generator=generator)
    speed = ahead[:, :1, 1] + 2 * torch.rand(count, 2, generator=generator)
    driven = torch.stack([row, speed, torch.zeros_like(row)], -1)
    state = idm.drive(driver, torch.cat([driven, ahead[:, :1]], 1), ahead)
    action = POINT_MASS_1D.inverse(state[:, :-1, :-1], state[:, :-1, 1:], 0.2)
    return Scenes(state, action, torch.zeros(count, 6, dtype=torch.int64))


@pytest.mark.slow
def test_calibration_finds_the_driver_that_made_the_scenes():
    truth = replace(DRIVER, time_headway=0.9, acceleration=1.6)
    scenes = recorded(truth)
    found = idm.calibrate(scenes, 0.2)

    def loss(driver: IntelligentDriver) -> float:
        return float(reconstruction_loss(idm.drive(driver, scenes.start, scenes.leader), scenes.state, driver.dynamics))

    assert loss(found) < 0.02 * loss(IntelligentDriver(0.2))
    assert found.time_headway == pytest.approx(0.9, abs=0.15)
    for name, (low, high) in idm.FITTED.items():
        assert low * 0.999 <= getattr(found, name) <= high * 1.001


def test_parameters_are_set_and_reported_by_name():
    changed = idm.with_parameters(DRIVER, np.array([30.0, 1.0, 3.0, 1.5, 2.0]))
    assert idm.parameters(changed) == {
        "desired_speed": 30.0, "time_headway": 1.0, "minimum_gap": 3.0, "acceleration": 1.5, "deceleration": 2.0
    }  # fmt: skip
    assert changed.length == DRIVER.length
