from dataclasses import replace

import msgspec
import pytest
import torch

from gri.core.dynamics import POINT_MASS_1D
from gri.core.graph import EdgeType
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import PAPER
from gri.data.synthetic.expert import make_scenes, model_config, true_reward
from gri.evaluation import diagnostics
from gri.evaluation.diagnostics import (
    Flip,
    fitted_sigma,
    flip_agreement,
    optimal_change,
    sampled_states,
    shuffle_agreement,
    std_along_horizon,
)
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import ModelConfig, RelationalModel
from gri.rewards.structured import StructuredReward


@pytest.fixture(scope="module")
def model() -> RelationalModel:
    torch.manual_seed(0)
    return RelationalModel(model_config(PAPER, DecoderConfig(hidden=8), EncoderConfig(hidden=8))).eval()


@pytest.fixture(scope="module")
def scenes() -> Scenes:
    torch.manual_seed(0)
    expert = RelationalModel(model_config(PAPER, DecoderConfig(hidden=8), None)).requires_grad_(False)
    return make_scenes(expert, PAPER, PAPER.one_graph, 6, 0)


def test_an_encoder_that_reads_no_numbers_agrees_with_itself_when_vehicles_are_renumbered(model, scenes):
    assert shuffle_agreement(model, scenes, seed=1) == 1.0


def test_sigma_is_the_spread_of_recorded_actions_about_the_means(model, scenes):
    expert = RelationalModel(without_encoder(model))
    driven = diagnostics.reconstruct(expert, scenes)
    copied = Scenes(driven, scenes.action, scenes.graph)
    means = diagnostics.mean_actions(expert, driven, expert.infer(driven).one_hot, 2)
    shifted = Scenes(copied.state, means + 0.3, copied.graph)
    torch.testing.assert_close(fitted_sigma(expert, shifted), torch.tensor([0.3]), atol=1e-5, rtol=0)


def without_encoder(model: RelationalModel) -> ModelConfig:
    return msgspec.structs.replace(model.config, encoder=None, told_graph=False)


def test_spread_of_states_follows_from_that_of_the_actions(model, scenes):
    sigma = torch.tensor([0.5])
    std = std_along_horizon(sampled_states(model, scenes, sigma, samples=400))
    assert std.shape == (20, 3)
    assert float(std[0].max()) == 0
    assert float(std[1, 2]) == pytest.approx(0.5 * 0.2, rel=0.05)  # a' = a + jerk * dt
    assert float(std[2, 1]) == pytest.approx(0.5 * 0.2 * 0.2, rel=0.05)


def test_weights_are_compared_as_ratios_to_that_of_the_jerk():
    true = true_reward(PAPER)
    learned = StructuredReward(PAPER.reward)
    found = diagnostics.weights_beside_truth(learned, true)
    assert found["follow.idm"] == (pytest.approx(1.0), pytest.approx(2.5 / 1.5))
    assert found["node.jerk"] == (1.0, 1.0)


def test_flips_are_judged_where_the_optimum_moves(model, scenes, monkeypatch):
    flip = Flip(1, 0, EdgeType.NONE, EdgeType.FOLLOW, "headway")
    moves = {0: 0.0, 1: 2.0}

    def optimum(given, reward, dynamics, dt):
        state = given.others[:, 0].clone()
        state[:, -1, 0] -= moves[given.edge_types[0]] * torch.tensor([1.0, 1.0, -1.0, 0.0, 0.0, 0.0])
        return state

    def driven(model, start, graph, leader):
        state = scenes.state.clone()
        state[:, 0, -1, 0] -= graph[:, 2, 1] * torch.tensor([1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
        return replace(probes_rollout, state=state)

    probes_rollout = diagnostics.rollout(model, scenes.start, scenes.one_hot(2), scenes.leader)
    monkeypatch.setattr(diagnostics, "best_response", optimum)
    monkeypatch.setattr(diagnostics, "rollout", driven)
    wanted = optimal_change(scenes, true_reward(PAPER), POINT_MASS_1D, 0.2, flip)
    torch.testing.assert_close(wanted, torch.tensor([2.0, 2.0, -2.0, 0.0, 0.0, 0.0]))
    found = flip_agreement(model, scenes, flip, wanted)
    assert found is not None
    assert found.scenes == 3
    assert found.mean == pytest.approx(2 / 3)


def test_order_changes_where_the_headway_changes_its_sign():
    state = torch.zeros(3, 2, 2, 3)
    state[:, 1, -1, 0] = torch.tensor([4.0, -1.0, 0.5])
    ahead, order = (
        diagnostics._effect(Flip(1, 0, EdgeType.NONE, EdgeType.FOLLOW, name), state, POINT_MASS_1D)
        for name in ("headway", "order")
    )
    assert ahead.tolist() == [4.0, -1.0, 0.5]
    assert order.tolist() == [1.0, -1.0, 1.0]
