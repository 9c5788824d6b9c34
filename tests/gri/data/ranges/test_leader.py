import torch

from gri.core.dynamics import POINT_MASS_1D, stop_at_standstill
from gri.data.ranges.car_following import US101
from gri.data.ranges.leader import LeaderConfig, leader_states


def states(generator: torch.Generator, config: LeaderConfig, count: int = 300, steps: int = 60) -> torch.Tensor:
    start = torch.zeros(count, 3)
    start[:, 1] = torch.linspace(0, 22, count)
    return leader_states(config, start, steps, 0.2, generator)


def test_without_phases_the_speed_is_constant(generator: torch.Generator):
    path = states(generator, LeaderConfig())
    assert torch.equal(path[:, :, 1], path[:, :1, 1].expand(-1, 60))
    assert path[..., 2].abs().max() == 0
    torch.testing.assert_close(path[:, -1, 0], path[:, 0, 1] * 59 * 0.2)


def test_phases_stay_within_their_limits(generator: torch.Generator):
    path = states(generator, US101.leader)
    x, v, a = path.unbind(-1)
    assert 0 <= v.min() <= v.max() <= 22 + 1e-4
    assert -4.5 <= a.min() <= a.max() <= 2.6
    assert (x.diff(dim=1) >= 0).all()


def test_positions_speeds_and_accelerations_agree(generator: torch.Generator):
    path = states(generator, US101.leader)
    jerk = path[:, 1:, 2:].sub(path[:, :-1, 2:]) / 0.2
    moved = stop_at_standstill(path[:, :-1], POINT_MASS_1D.step(path[:, :-1], jerk, 0.2))
    torch.testing.assert_close(moved[..., :2], path[:, 1:, :2], atol=1e-3, rtol=1e-4)


def test_leaders_stop_start_and_brake_hard(generator: torch.Generator):
    path = states(generator, US101.leader)
    stopped = path[..., 1] == 0
    assert 0.02 < stopped.float().mean() < 0.4
    assert (stopped[:, :-1] & ~stopped[:, 1:]).any()
    assert (path[..., 2] < -4).any(1).float().mean() > 0.1
