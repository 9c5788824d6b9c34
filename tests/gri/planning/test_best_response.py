import pytest
import torch

from gri.core.dynamics import POINT_MASS_1D, constant_speed
from gri.data.ranges.car_following import PAPER
from gri.data.synthetic.expert import true_reward
from gri.planning.best_response import ResponseProblem, best_response, maximise_bfgs


def test_bfgs_finds_the_maximum_of_every_scene_separately():
    maximum = torch.tensor([[1.0, -2.0], [300.0, 0.5]], dtype=torch.double)
    steepness = torch.tensor([[1.0, 50.0], [0.02, 3.0]], dtype=torch.double)

    def value(point: torch.Tensor) -> torch.Tensor:
        return -(steepness * (point - maximum) ** 2).sum(-1)

    found = maximise_bfgs(value, torch.zeros(2, 2, dtype=torch.double))
    torch.testing.assert_close(found, maximum, atol=1e-4, rtol=1e-5)


def test_a_vehicle_at_the_speed_limit_on_an_empty_road_does_nothing():
    start = torch.tensor([[0.0, PAPER.reward.constants.speed_limit, 0.0]])
    ahead = constant_speed(start + 50, 10, POINT_MASS_1D, 0.2)
    state = best_response(ResponseProblem(start, ahead[:, None], (0,)), true_reward(PAPER), POINT_MASS_1D, 0.2)
    torch.testing.assert_close(state, constant_speed(start, 10, POINT_MASS_1D, 0.2), atol=1e-4, rtol=0)


@pytest.mark.slow
def test_the_optimum_falls_in_behind_from_ahead():
    start = torch.tensor([[4.0, 5.0, 0.0], [-6.0, 5.0, 0.0]])
    front = constant_speed(torch.tensor([[0.0, 5.0, 0.0]]).expand(2, 3), 20, POINT_MASS_1D, 0.2)
    state = best_response(
        ResponseProblem(start, front[:, None], (1,)), true_reward(PAPER), POINT_MASS_1D, 0.2, iterations=40
    )
    headway = front[:, -1, 0] - state[:, -1, 0]
    assert headway[0] > 2
    assert headway[1] == pytest.approx(6.0, abs=0.5)  # s0 + T_h v
