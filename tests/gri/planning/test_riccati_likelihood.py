from math import log, pi

import pytest
import torch

from gri.core.scenes import Scenes
from gri.data.ranges.lane_changing import LANE_CHANGING_SCENES
from gri.data.synthetic.expert import make_scenes, model_config, true_reward
from gri.networks.decoder import DecoderConfig
from gri.networks.model import RelationalModel
from gri.planning.edge_posterior import combinations
from gri.planning.laplace_likelihood import sensitivities
from gri.planning.riccati_likelihood import StepExpansion, derivatives_of_squares, expand_steps, log_likelihood_by_steps
from gri.rewards.structured import StructuredReward


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


def at_once(model: RelationalModel, reward: StructuredReward, scenes: Scenes, expansion: StepExpansion) -> torch.Tensor:
    """The same quadratic model as one matrix over all actions of each vehicle."""
    weights = torch.cat([reward.weights("node"), *[reward.weights(k) for k in reward.terms.edge] * 2])
    chosen = reward.log_alpha.exp() * weights * combinations(reward, 2)[0]
    results = []
    for j in range(2):
        moves = sensitivities(model, scenes.state[:, j, :-1], scenes.action[:, j])
        gradient = torch.einsum("cm,btmp,btpn->bcn", chosen, expansion.gradient[:, j], moves)
        residual = torch.einsum("btmp,btpn->btmn", expansion.residual[:, j], moves)
        precision = 2 * torch.einsum("cm,btmn,btmk->bcnk", chosen, residual, residual)
        solved = torch.linalg.solve(precision, gradient[..., None])[..., 0]
        size = gradient.shape[-1]
        value = -0.5 * (gradient * solved).sum(-1) + 0.5 * torch.logdet(precision) - 0.5 * size * log(2 * pi)
        results.append(value)
    return torch.stack(results, 1)


def test_it_equals_one_matrix_over_all_actions(model: RelationalModel, scenes: Scenes):
    reward = true_reward(LANE_CHANGING_SCENES)
    expansion = expand_steps(model, reward, scenes.state, scenes.action)
    by_steps = log_likelihood_by_steps(reward, expansion)
    assert by_steps.shape == (4, 2, 16)
    torch.testing.assert_close(by_steps, at_once(model, reward, scenes, expansion), rtol=1e-3, atol=0.05)


def test_its_gradient_equals_that_of_one_matrix(model: RelationalModel, scenes: Scenes):
    reward = true_reward(LANE_CHANGING_SCENES).requires_grad_(True)
    expansion = expand_steps(model, reward, scenes.state, scenes.action)
    learned = [reward.psi["node"], reward.psi["cut_in"], reward.log_alpha]
    ours = torch.autograd.grad(log_likelihood_by_steps(reward, expansion).sum(), learned)
    theirs = torch.autograd.grad(at_once(model, reward, scenes, expansion).sum(), learned)
    for mine, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-2, atol=0.05)


def test_slopes_of_squares_and_of_their_roots():
    """f = (x²·y, (5y)²) = r² with r = (x·√y, 5y)."""
    point = torch.tensor([[2.0, 4.0], [1.0, 1.0]])
    slope, residual = derivatives_of_squares(
        lambda p: torch.stack([p[..., 0] ** 2 * p[..., 1], 25 * p[..., 1] ** 2], -1), point
    )
    assert slope[0].tolist() == [[16.0, 4.0], [0.0, 200.0]]
    torch.testing.assert_close(residual[0], torch.tensor([[2.0, 0.5], [0.0, 5.0]]), rtol=1e-3, atol=1e-3)


def test_a_feature_of_zero_still_has_a_curvature():
    slope, residual = derivatives_of_squares(lambda p: (3 * p[..., :1]) ** 2, torch.zeros(1, 2))
    assert slope.tolist() == [[[0.0, 0.0]]]
    torch.testing.assert_close(residual, torch.tensor([[[3.0, 0.0]]]))


def test_one_sided_features_have_no_curvature_where_they_are_zero():
    _, residual = derivatives_of_squares(lambda p: (p[..., :1] - 5).clamp(min=0) ** 2, torch.zeros(1, 2))
    assert residual.tolist() == [[[0.0, 0.0]]]


def test_parts_join(model: RelationalModel, scenes: Scenes):
    reward = true_reward(LANE_CHANGING_SCENES)
    whole = expand_steps(model, reward, scenes.state, scenes.action)
    joined = StepExpansion.concatenate([whole[:1], whole[1:]])
    assert torch.equal(joined.residual, whole.residual)
    assert torch.equal(joined.moves, whole.moves)
