import pytest
import torch

from gri.data.lane_changing import LANE_CHANGING_SCENES
from gri.data.synthetic import Scenes, make_scenes, model_config, true_reward
from gri.decoder import DecoderConfig
from gri.laplace import expand, log_likelihood
from gri.model import RelationalModel
from gri.riccati import StepExpansion, derivatives, expand_steps, log_likelihood_by_steps


@pytest.fixture
def model() -> RelationalModel:
    torch.manual_seed(0)
    return RelationalModel(model_config(LANE_CHANGING_SCENES, DecoderConfig(hidden=16), None))


@pytest.fixture
def scenes(model: RelationalModel) -> Scenes:
    """What an untrained policy does, with noise on top."""
    lanes = LANE_CHANGING_SCENES
    made = make_scenes(model, lanes, lanes.mixed_graphs, 4, seed=3, action_noise=0.3)
    return Scenes(made.state[:, :, :13], made.action[:, :, :12], made.graph)


def test_it_equals_one_matrix_over_all_actions(model: RelationalModel, scenes: Scenes):
    reward = true_reward(LANE_CHANGING_SCENES)
    by_steps = log_likelihood_by_steps(reward, expand_steps(model, reward, scenes.state, scenes.action))
    at_once = log_likelihood(reward, expand(model, reward, scenes.state, scenes.action, horizon=12))
    assert by_steps.shape == (4, 2, 16)
    torch.testing.assert_close(by_steps, at_once, rtol=1e-3, atol=0.05)


def test_its_gradient_equals_that_of_one_matrix(model: RelationalModel, scenes: Scenes):
    slopes = []
    for by_steps in (True, False):
        reward = true_reward(LANE_CHANGING_SCENES).requires_grad_(True)
        if by_steps:
            value = log_likelihood_by_steps(reward, expand_steps(model, reward, scenes.state, scenes.action))
        else:
            value = log_likelihood(reward, expand(model, reward, scenes.state, scenes.action, horizon=12))
        slopes.append(torch.autograd.grad(value[..., 6].sum(), [reward.psi["node"], reward.log_alpha]))
    for ours, theirs in zip(*slopes, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-2, atol=0.05)


def test_derivatives_of_a_polynomial():
    point = torch.tensor([[2.0, 3.0]])
    first, second = derivatives(lambda p: torch.stack([p[..., 0] ** 2 * p[..., 1], 5 * p[..., 1]], -1), point)
    assert first.tolist() == [[[12.0, 4.0], [0.0, 5.0]]]
    assert second.tolist() == [[[[6.0, 4.0], [4.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]]]


def test_parts_join(model: RelationalModel, scenes: Scenes):
    reward = true_reward(LANE_CHANGING_SCENES)
    whole = expand_steps(model, reward, scenes.state, scenes.action)
    joined = StepExpansion.concatenate([whole[:1], whole[1:]])
    assert torch.equal(joined.hessian, whole.hessian)
    assert torch.equal(joined.moves, whole.moves)
