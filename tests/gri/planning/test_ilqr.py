from dataclasses import replace

import pytest
import torch

from gri.core.dynamics import DUBINS
from gri.data.ranges.lane_changing import LANE_CHANGING_SCENES, sample_merge
from gri.data.synthetic.expert import true_reward
from gri.planning.ilqr import ControlProblem, maximise_ilqr

STEPS = 8


@pytest.fixture
def problem(generator: torch.Generator) -> ControlProblem:
    """Vehicle 0 follows the leader and cuts in front of vehicle 1, which keeps its speed."""
    start, leader = sample_merge(LANE_CHANGING_SCENES, 3, generator, STEPS)
    start, leader = start.double(), leader.double()
    time = 0.2 * torch.arange(STEPS, dtype=torch.double)
    lag = start[:, 1:2].repeat(1, STEPS, 1)
    lag[..., 0] = lag[..., 0] + lag[..., 2] * time
    kinds = [3, 1]  # cut in, follow
    reward = true_reward(LANE_CHANGING_SCENES).double()
    return ControlProblem(start[:, 0], torch.stack([lag, leader], 1), kinds, reward, DUBINS, 0.2)


def gradient(problem: ControlProblem, action: torch.Tensor) -> torch.Tensor:
    action = action.clone().requires_grad_(True)
    value = problem.value(problem.simulate(action)[:, :-1], action)
    return torch.autograd.grad(value.sum(), action)[0]


def test_the_return_is_flat_at_the_maximum(problem: ControlProblem):
    start = torch.zeros(3, STEPS, 2, dtype=torch.double)
    maximum = maximise_ilqr(problem, start, iterations=100, tolerance=1e-12)
    assert gradient(problem, start).abs().max() > 1.0
    assert gradient(problem, maximum).abs().max() < 1e-2


def test_every_scene_is_optimised_separately(problem: ControlProblem):
    start = torch.zeros(3, STEPS, 2, dtype=torch.double)
    together = maximise_ilqr(problem, start)
    alone = ControlProblem(
        problem.start[1:2], problem.others[1:2], problem.edge_types, problem.reward, problem.dynamics, problem.dt
    )
    torch.testing.assert_close(maximise_ilqr(alone, start[1:2]), together[1:2], atol=1e-2, rtol=1e-2)


def test_the_return_is_that_of_the_reward(problem: ControlProblem):
    action = 0.1 * torch.ones(3, STEPS, 2, dtype=torch.double)
    state = problem.simulate(action)[:, :-1]
    reward, kinds = problem.reward, torch.tensor(problem.edge_types)
    paid = reward.of_edges(problem.others, state[:, None].expand_as(problem.others))
    expected = reward.of_vehicles(state[:, None], action[:, None]).sum((1, 2))
    expected = expected + paid.gather(-1, kinds[None, :, None, None].expand(3, 2, STEPS, 1)).sum((1, 2, 3))
    torch.testing.assert_close(problem.value(state, action), expected)


def test_a_vehicle_that_never_reverses_stops(problem: ControlProblem):
    action = torch.zeros(3, STEPS, 2, dtype=torch.double)
    action[:, 0, 0] = -100.0  # brakes with 20 m/s² from 4 to 6 m/s
    free, standing = problem.simulate(action), replace(problem, never_reverse=True).simulate(action)
    assert (free[:, -1, 2] < 0).all()
    assert (standing[:, -1, [2, 4, 5]] == 0).all()
    assert (standing[..., 0].diff(dim=1) >= 0).all()
