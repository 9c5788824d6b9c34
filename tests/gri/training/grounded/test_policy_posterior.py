import torch

from gri.core.graph import pairs
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import PAPER
from gri.data.synthetic.expert import sample_starts
from gri.networks.model import ModelConfig, RelationalModel
from gri.networks.rollout import rollout
from gri.planning.edge_posterior import scene_prior
from gri.rewards.structured import StructuredReward
from gri.training.grounded.augmentation import Augmentation, Shifts, augment_histories, random_graphs, shift_starts
from gri.training.grounded.policy_posterior import incoming_graph, posterior_by_policy


def test_incoming_types_reach_the_same_senders_of_every_vehicle():
    types = torch.tensor([[1.0, 0.0], [0.0, 1.0]])  # the first other vehicle: none, the second: follow
    graph = incoming_graph(types, 3)[0, :, 1]
    followed = [pair for pair, value in zip(pairs(3), graph.tolist(), strict=True) if value]
    assert followed == [(1, 2), (2, 0), (2, 1)]


def test_a_policy_recognises_the_graphs_it_drove_by(generator: torch.Generator):
    torch.manual_seed(2)
    model = RelationalModel(ModelConfig(encoder=None))
    with torch.no_grad():
        model.decoder.body.node[-1].weight.mul_(30)  # an untrained policy hardly reacts
    start, leader = sample_starts(PAPER, 40, generator)
    graph = random_graphs(40, 3, 2, generator)
    with torch.no_grad():
        driven = rollout(model, start, graph, leader)
    scenes = Scenes(driven.state, driven.action, graph.argmax(-1))
    reward = StructuredReward(PAPER.reward)
    posterior = posterior_by_policy(model, reward, scenes, scene_prior(reward, scenes.state, 0.5))
    driven_edges = [edge for edge, (_, j) in enumerate(pairs(3)) if j < 2]
    right = (posterior.argmax(-1) == scenes.graph)[:, driven_edges].float().mean()
    assert right > 0.97
    torch.testing.assert_close(posterior.sum(-1), torch.ones(40, 6))


def test_shifts_move_half_of_the_driven_vehicles(generator: torch.Generator):
    start, _ = sample_starts(PAPER, 50, generator)
    shifts = Shifts(position=(1.0, 2.0), speed=(-20.0, -10.0), acceleration=(3.0, 3.0))
    moved = shift_starts(start, shifts, generator) - start
    assert (moved[25:] == 0).all()
    assert (moved[:, 2] == 0).all()
    assert (moved[:25, :2, 0] >= 1.0).all()
    assert (moved[:25, :2, 2] == 3.0).all()
    assert ((start + moved)[..., 1] >= 0).all()


def test_augmentation_stretches_headways_and_keeps_the_rest(generator: torch.Generator):
    state = torch.zeros(6, 3, 30, 3)
    state[..., 0] = torch.tensor([0.0, 10.0, 30.0])[:, None] + torch.arange(30.0)
    seen = augment_histories(state, Augmentation(stretch=(2.0, 2.0)), 20, generator)
    headway = seen[:, 1:, :, 0] - seen[:, :-1, :, 0]
    torch.testing.assert_close(headway[:, 0], torch.full((6, 30), 20.0))
    torch.testing.assert_close(headway[:, 1], torch.full((6, 30), 40.0))
    torch.testing.assert_close(seen[:, 2], state[:, 2])


def test_headways_are_those_to_the_next_vehicle_ahead_in_whatever_order_they_are_numbered(generator: torch.Generator):
    state = torch.zeros(6, 3, 30, 3)
    state[..., 0] = torch.tensor([10.0, 0.0, 30.0])[:, None] + torch.arange(30.0)
    seen = augment_histories(state, Augmentation(stretch=(2.0, 2.0)), 30, generator)
    torch.testing.assert_close(seen[0, :, 0, 0], torch.tensor([-10.0, -30.0, 30.0]))


def test_augmentation_shows_faster_traffic_with_headways_to_match(generator: torch.Generator):
    # 0 comes in between 1 and 2; all drive at 5 m/s. Headways get 1.3 s of the added speed, whoever is ahead of whom.
    state = torch.zeros(6, 3, 30, 3)
    state[..., 0] = torch.tensor([20.0, 8.0, 30.0])[:, None] + 0.2 * 5.0 * torch.arange(30.0)
    state[..., 1] = 5.0
    seen = augment_histories(state, Augmentation(faster=12.0), 30, generator)
    added = seen[:, :, 0, 1] - 5.0
    assert float(added.amin()) >= 0
    assert 5 < float(added.amax()) <= 12
    torch.testing.assert_close(seen[..., 0].diff(dim=2), 0.2 * seen[:, :, 1:, 1], atol=1e-4, rtol=0)
    headways = seen[:, [2, 0], 0, 0] - seen[:, [0, 1], 0, 0]
    torch.testing.assert_close(headways, torch.tensor([10.0, 12.0]) + 1.3 * added[:, :2])


def test_augmentation_cuts_a_window(generator: torch.Generator):
    state = torch.arange(30.0)[None, None, :, None].expand(2, 3, 30, 3)
    seen = augment_histories(state, Augmentation(window=True), 20, generator)
    assert seen.shape == (2, 3, 20, 3)
    assert (seen[..., 2].diff(dim=2) == 1).all()
