from dataclasses import replace

import pytest
import torch

from gri.core.dynamics import DUBINS
from gri.data.ranges.lane_changing import LANE_CHANGING_SCENES, sample_merge
from gri.data.synthetic.expert import true_reward
from gri.planning.ilqr import Task, climb_by_steps

STEPS = 8


@pytest.fixture
def task(generator: torch.Generator) -> Task:
    """Vehicle 0 follows the leader and cuts in front of vehicle 1, which keeps its speed."""
    start, leader = sample_merge(LANE_CHANGING_SCENES, 3, generator, STEPS)
    start, leader = start.double(), leader.double()
    time = 0.2 * torch.arange(STEPS, dtype=torch.double)
    lag = start[:, 1:2].repeat(1, STEPS, 1)
    lag[..., 0] = lag[..., 0] + lag[..., 2] * time
    kinds = [3, 1]  # cut in, follow
    reward = true_reward(LANE_CHANGING_SCENES).double()
    return Task(start[:, 0], torch.stack([lag, leader], 1), kinds, reward, DUBINS, 0.2)


def gradient(task: Task, action: torch.Tensor) -> torch.Tensor:
    action = action.clone().requires_grad_(True)
    value = task.value(task.simulate(action)[:, :-1], action)
    return torch.autograd.grad(value.sum(), action)[0]


def test_the_summit_is_flat(task: Task):
    start = torch.zeros(3, STEPS, 2, dtype=torch.double)
    summit = climb_by_steps(task, start, iterations=100, tolerance=1e-12)
    assert gradient(task, start).abs().max() > 1.0
    assert gradient(task, summit).abs().max() < 1e-2


def test_every_scene_climbs_by_itself(task: Task):
    start = torch.zeros(3, STEPS, 2, dtype=torch.double)
    together = climb_by_steps(task, start)
    alone = Task(task.start[1:2], task.others[1:2], task.kinds, task.reward, task.dynamics, task.dt)
    torch.testing.assert_close(climb_by_steps(alone, start[1:2]), together[1:2], atol=1e-2, rtol=1e-2)


def test_the_return_is_that_of_the_reward(task: Task):
    action = 0.1 * torch.ones(3, STEPS, 2, dtype=torch.double)
    state = task.simulate(action)[:, :-1]
    reward, kinds = task.reward, torch.tensor(task.kinds)
    paid = reward.of_edges(task.others, state[:, None].expand_as(task.others))
    expected = reward.of_vehicles(state[:, None], action[:, None]).sum((1, 2))
    expected = expected + paid.gather(-1, kinds[None, :, None, None].expand(3, 2, STEPS, 1)).sum((1, 2, 3))
    torch.testing.assert_close(task.value(state, action), expected)


def test_who_never_reverses_stands(task: Task):
    action = torch.zeros(3, STEPS, 2, dtype=torch.double)
    action[:, 0, 0] = -100.0  # brakes with 20 m/s² from 4 to 6 m/s
    free, standing = task.simulate(action), replace(task, never_reverse=True).simulate(action)
    assert (free[:, -1, 2] < 0).all()
    assert (standing[:, -1, [2, 4, 5]] == 0).all()
    assert (standing[..., 0].diff(dim=1) >= 0).all()
