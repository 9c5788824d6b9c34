import torch

from gri.core.graph import pairs
from gri.planning.edge_posterior import combinations, marginals, scene_prior
from gri.rewards.structured import RewardConfig, StructuredReward

REWARD = RewardConfig(temperature=0.1)


def test_combinations_enumerate_all_incoming_edges():
    masks, types = combinations(StructuredReward(REWARD), 2)
    assert masks.shape == (4, 7)
    assert masks[0].tolist() == [1, 1, 1, 0, 0, 0, 0]
    assert types.argmax(-1).tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]


def test_no_likelihood_outweighs_an_excluded_type():
    reward = StructuredReward(REWARD)
    prior = torch.tensor([[[0.5, 0.5]] * 6])
    edge = pairs(3).index((2, 0))
    prior[0, edge] = torch.tensor([1.0, 1e-37])
    follows = combinations(reward, 2)[1][..., 1]  # of both senders, in every combination
    likelihood = (1000.0 * follows.sum(-1)).expand(1, 2, -1)
    posterior = marginals(reward, likelihood, prior)[0, :, 1]
    assert posterior[edge] == 0
    assert posterior[pairs(3).index((1, 0))] == 1


def test_with_ahead_only_following_a_vehicle_behind_is_unlikely():
    state = torch.tensor([0.0, 6.0, 12.0])[None, :, None, None].expand(2, 3, 5, 3)
    prior = scene_prior(StructuredReward(REWARD), state, 0.9, ahead_only=True)
    for edge, (i, j) in enumerate(pairs(3)):
        expected = 0.1 if i > j else 0.0
        torch.testing.assert_close(prior[:, edge, 1], torch.full((2,), expected), atol=1e-6, rtol=0)
