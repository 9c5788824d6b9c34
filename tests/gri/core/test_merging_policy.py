"""The merging driver: whom it follows, when it moves over, and where it ends."""

from dataclasses import replace

import pytest
import torch

from gri.core.dynamics import DUBINS
from gri.core.merging_policy import MergingDriver
from gri.core.policy import IntelligentDriver, Policy
from gri.core.trajectory import Trajectory

DRIVER = MergingDriver(IntelligentDriver(0.2))


def scene(lag: float, leader: float, v: float = 10.0) -> torch.Tensor:
    """Merger at x = 0 on the lane to the right, lag vehicle and leader at these headways in the target lane."""
    state = torch.zeros(1, 3, 6)
    state[0, :, 0] = torch.tensor([0.0, -lag, leader])
    state[0, :, 1] = torch.tensor([-3.66, 0.0, 0.0])
    state[..., 2] = v
    return state


def drive(state: torch.Tensor, steps: int, driver: MergingDriver = DRIVER) -> torch.Tensor:
    memory = driver.begin(Trajectory.complete(state[:, :, None], driver.dt))
    states = [state]
    for _ in range(steps):
        action, memory = driver.act(memory, states[-1])
        moved = DUBINS.step(states[-1], action, driver.dt)
        moved[:, 2, 2:] = state[:, 2, 2:]  # the leader keeps its speed
        states.append(moved)
    return torch.stack(states, 2)


def test_it_is_a_policy():
    assert isinstance(DRIVER, Policy)


def test_a_merger_with_room_ends_in_the_middle_of_the_target_lane():
    path = drive(scene(lag=25.0, leader=25.0), 60)
    assert abs(float(path[0, 0, -1, 1])) < 0.1
    assert float(path[0, 0, :, 1].max()) < 0.3  # it does not swing out on the other side
    assert float(path[0, 0, :, 3].abs().max()) < 0.21
    assert (path[0, 2, :, 0] - path[0, 0, :, 0]).min() > 5.0


@pytest.mark.parametrize("dt", [0.05, 0.1, 0.4, 0.5, 1.0])
def test_it_does_not_swing_however_rarely_it_acts(dt: float):
    driver = replace(DRIVER, driver=replace(DRIVER.driver, dt=dt))
    path = drive(scene(lag=60.0, leader=60.0, v=20.0), round(20 / dt), driver)
    assert float(path[0, 0, :, 1].max()) < 0.3
    assert abs(float(path[0, 0, -1, 1])) < 0.1


def test_a_merger_without_room_stays_in_its_lane():
    path = drive(scene(lag=3.0, leader=4.0), 5)
    torch.testing.assert_close(path[0, 0, :, 1], torch.full((6,), -3.66), atol=1e-4, rtol=0)


def test_the_lag_vehicle_makes_room_within_courtesy_only():
    far, near = scene(lag=25.0, leader=60.0), scene(lag=6.0, leader=60.0, v=15.0)
    behind = DRIVER.driver.target_acceleration(torch.tensor(10.0), torch.tensor(10.0), torch.tensor(25.0))
    memory = DRIVER.begin(Trajectory.complete(far[:, :, None], 0.2))
    torch.testing.assert_close(DRIVER.act(memory, far)[0][0, 1, 0] * 0.2, behind)
    assert float(DRIVER.act(memory, near)[0][0, 1, 0]) * 0.2 == -DRIVER.courtesy
