from math import log

import pytest
import torch
from torch import nn

from gri.core.dynamics import POINT_MASS_1D, POINT_MASS_2D
from gri.training.optimisation import (
    LATERAL_WEIGHT,
    MAX_SKIPPED_UPDATES,
    Descent,
    action_error,
    batches,
    categorical_kl,
    reconstruction_loss,
)


def test_scenes_are_drawn_as_often_as_they_weigh():
    weight = torch.tensor([0.0, 1.0, 3.0])
    drawn = torch.cat(list(batches(3, 3, 1000, torch.Generator().manual_seed(0), weight)))
    assert drawn.shape == (3000,)
    assert (drawn.bincount(minlength=3) / 3000).tolist() == pytest.approx([0.0, 0.25, 0.75], abs=0.03)


def test_kl_by_hand():
    logits = torch.tensor([[[0.0, log(3.0)]]])  # q = (1/4, 3/4)
    prior = torch.tensor([0.9, 0.1])
    expected = 0.25 * log(0.25 / 0.9) + 0.75 * log(0.75 / 0.1)
    torch.testing.assert_close(categorical_kl(logits, prior), torch.tensor([[expected]]))


def test_kl_of_a_certain_edge_is_its_price():
    prior = torch.tensor([0.9, 0.1])
    certain = torch.tensor([[[-30.0, 30.0], [30.0, -30.0]]])
    torch.testing.assert_close(categorical_kl(certain, prior), torch.tensor([[-log(0.1), -log(0.9)]]))


def test_reconstruction_counts_positions_and_speeds_of_driven_vehicles():
    recorded = torch.zeros(1, 3, 2, 3)
    state = recorded.clone()
    state[0, 0, 1] = torch.tensor([2.0, 1.0, 100.0])  # 4 + 1; the acceleration does not count
    state[0, 2] = 7.0  # nor does the leader
    torch.testing.assert_close(reconstruction_loss(state, recorded, POINT_MASS_1D), torch.tensor(5.0 / 4))


def test_errors_across_the_road_count_more():
    recorded = torch.zeros(1, 2, 1, 6)
    state = recorded.clone()
    state[0, 0, 0] = torch.tensor([2.0, 0.5, 1.0, 0.2, 9.0, 9.0])  # x, y, vx, vy; no accelerations
    expected = 2.0**2 + (0.5 * LATERAL_WEIGHT) ** 2 + 1.0**2 + (0.2 * LATERAL_WEIGHT) ** 2
    torch.testing.assert_close(reconstruction_loss(state, recorded, POINT_MASS_2D), torch.tensor(expected))


def test_actions_count_in_their_units():
    recorded = torch.zeros(1, 1, 2, 2)
    action = torch.tensor([[[[3.0, 0.0], [0.0, 0.2]]]])
    error = action_error(action, recorded, torch.tensor([1.5, 0.1]))
    torch.testing.assert_close(error, torch.tensor((4.0 + 4.0) / 4))


def test_descent_leaves_other_parameters_alone():
    mine, other = torch.nn.Parameter(torch.ones(2)), torch.nn.Parameter(torch.ones(2))
    Descent([mine], 0.1, 10).step((mine * other).sum())
    assert (mine < 1).all()
    assert other.grad is None
    assert torch.equal(other.data, torch.ones(2))


def test_an_update_without_a_finite_gradient_is_left_out():
    weight = nn.Parameter(torch.tensor([1.0, 2.0]))
    descent = Descent([weight], 0.1, 100)
    descent.step(weight.square().sum() * torch.nan)
    assert weight.tolist() == [1.0, 2.0]
    descent.step(weight.square().sum())
    assert (weight < torch.tensor([1.0, 2.0])).all()


def test_training_that_ran_away_for_good_is_an_error():
    weight = nn.Parameter(torch.ones(2))
    descent = Descent([weight], 0.1, 100)
    for _ in range(MAX_SKIPPED_UPDATES):
        descent.step(weight.square().sum() * torch.inf)
    with pytest.raises(FloatingPointError, match="lower the rates"):
        descent.step(weight.square().sum() * torch.inf)
