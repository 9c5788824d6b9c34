from math import log, pi

import torch

from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph
from gri.core.policy import PolicyState
from gri.networks.model import ModelConfig, RelationalModel
from gri.networks.rollout import log_density, log_prob_of, rollout


def setup(generator: torch.Generator, never_reverse: bool = False, steps: int = 9):
    torch.manual_seed(0)
    model = RelationalModel(ModelConfig(encoder=None, never_reverse=never_reverse))
    start = torch.tensor([0.0, 2.0, 0.0]) + torch.randn(4, 3, 3, generator=generator)
    leader = torch.randn(4, steps, 3, generator=generator)
    leader[:, 0] = start[:, -1]
    graph = InteractionGraph.of_edges({(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW}, FOLLOWING, batch=4)
    return model, start, graph, leader


def test_the_leader_is_as_given_and_the_others_obey_the_dynamics(generator: torch.Generator):
    model, start, graph, leader = setup(generator)
    driven = rollout(model, start, graph.one_hot, leader)
    torch.testing.assert_close(driven.state[:, -1], leader)
    torch.testing.assert_close(driven.state[:, :, 0], start)
    moved = model.dynamics.step(driven.state[:, :-1, :-1], driven.action, model.dt)
    torch.testing.assert_close(driven.state[:, :-1, 1:], moved, atol=1e-5, rtol=1e-5)


def test_it_does_what_stepping_the_policy_does(generator: torch.Generator):
    model, start, graph, leader = setup(generator)
    driven = rollout(model, start, graph.one_hot, leader)
    state, memory = start, PolicyState(graph, model.memory(start))
    for t in range(1, leader.shape[1]):
        action, memory = model.act(memory, state)
        state = torch.cat([model.step(state, action)[:, :-1], leader[:, t : t + 1]], 1)
        torch.testing.assert_close(driven.state[:, :, t], state, atol=1e-5, rtol=1e-5)


def test_shared_displacement_of_everything_changes_nothing(generator: torch.Generator):
    model, start, graph, leader = setup(generator)
    offset = torch.tensor([1000.0, 0.0, 0.0])
    here = rollout(model, start, graph.one_hot, leader).state
    there = rollout(model, start + offset, graph.one_hot, leader + offset).state
    torch.testing.assert_close(there - offset, here, atol=1e-3, rtol=0)


def test_gradients_reach_the_policy_through_time(generator: torch.Generator):
    model, start, graph, leader = setup(generator)
    rollout(model, start, graph.one_hot, leader).state[:, 0, -1, 0].sum().backward()
    assert all(p.grad is not None for name, p in model.named_parameters() if "log_sigma" not in name)


def test_vehicles_do_not_reverse_where_told_so(generator: torch.Generator):
    model, start, graph, leader = setup(generator, never_reverse=True)
    start[:, :2, 1], start[:, :2, 2] = 0.5, -3.0
    driven = rollout(model, start, graph.one_hot, leader).state[:, :2]
    assert (driven[..., 1] >= 0).all()
    assert (driven[..., 0].diff(dim=-1) >= 0).all()


def test_log_density_by_hand():
    density = log_density(torch.tensor([[1.0, -2.0]]), torch.tensor([0.5, 2.0]))
    expected = -0.5 * (1 + 4) - log(0.5) - log(2.0) - log(2 * pi)
    torch.testing.assert_close(density, torch.tensor([expected]))


def test_density_of_own_samples_agrees_with_their_noise(generator: torch.Generator):
    model, start, graph, leader = setup(generator)
    noise = torch.randn(4, 2, 8, 1, generator=generator)
    driven = rollout(model, start, graph.one_hot, leader, noise)
    again = log_prob_of(model, driven.state, driven.action, graph.one_hot)
    torch.testing.assert_close(again, log_density(noise, model.decoder.sigma), atol=1e-4, rtol=1e-4)
