from math import log, pi

import pytest
import torch
from torch import Tensor

from gri.core.graph import FOLLOWING, EdgeType, InteractionGraph, pairs
from gri.networks.model import ModelConfig, RelationalModel
from gri.planning.edge_posterior import combinations, edge_prior, marginals, scene_prior
from gri.planning.laplace_likelihood import expand, log_likelihood, sensitivities
from gri.rewards.structured import RewardConfig, StructuredReward

REWARD = RewardConfig(temperature=0.1)


@pytest.fixture
def model() -> RelationalModel:
    return RelationalModel(ModelConfig(encoder=None))


def scene(generator: torch.Generator, steps: int = 6) -> tuple[Tensor, Tensor]:
    """Consistent states and actions of three vehicles in a row."""
    model = RelationalModel(ModelConfig(encoder=None))
    start = torch.tensor([[0.0, 5.0, 0.0], [6.0, 5.0, 0.0], [12.0, 5.0, 0.0]])
    states, actions = [start[None].expand(2, -1, -1)], []
    for _ in range(steps - 1):
        actions.append(0.5 * torch.randn(2, 3, 1, generator=generator))
        states.append(model.step(states[-1], actions[-1]))
    return torch.stack(states, 2), torch.stack(actions, 2)[:, :2]


def own_return(model: RelationalModel, reward: StructuredReward, state: Tensor, j: int, graph: Tensor, u: Tensor):
    """Return of vehicle j when it alone changes its actions."""
    own = [state[0, j, 0]]
    for action in u[:-1]:
        own.append(model.step(own[-1], action[None]))
    moved = state[:, :, :-1].clone()
    moved[0, j] = torch.stack(own)
    action = torch.zeros(1, 3, len(u), 1)
    action[0, j, :, 0] = u
    return reward(moved, action, graph)[0, j].sum()


@pytest.mark.parametrize("j", [0, 1])
def test_expansion_equals_automatic_differentiation(model: RelationalModel, generator: torch.Generator, j: int):
    state, action = (part[:1] for part in scene(generator))
    reward = StructuredReward(REWARD)
    edges = {(0, 1): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW, (2, 0): EdgeType.FOLLOW}
    graph = InteractionGraph.of_edges(edges, FOLLOWING)

    def value(u: Tensor) -> Tensor:
        return own_return(model, reward, state, j, graph.one_hot, u)

    u = action[0, j, :, 0]
    gradient = torch.autograd.functional.jacobian(value, u)
    hessian = torch.autograd.functional.hessian(value, u)
    expansion = expand(model, reward, state, action)
    masks, types = combinations(reward, 2)
    senders = [i for i in range(3) if i != j]
    wanted = torch.stack([graph.one_hot[0, pairs(3).index((i, j))] for i in senders])
    mask = masks[(types == wanted).all(-1).all(-1)][0]
    weights = mask * torch.cat([reward.weights("node"), *[reward.weights("follow")] * 2])
    torch.testing.assert_close(-weights @ expansion.gradient[0, 0, j], gradient, atol=1e-4, rtol=1e-4)
    combined = -torch.einsum("m,mkn->kn", weights, expansion.hessian[0, 0, j])
    torch.testing.assert_close(combined, hessian, atol=1e-4, rtol=1e-4)


def test_sensitivities_equal_automatic_differentiation(generator: torch.Generator):
    model = RelationalModel(ModelConfig(encoder=None, never_reverse=True))
    start, actions = torch.tensor([0.0, 0.5, -1.0]), torch.randn(5, 1, generator=generator)

    def states(u: Tensor) -> Tensor:
        visited = [start]
        for action in u[:-1]:
            visited.append(model.step(visited[-1], action))
        return torch.stack(visited)

    exact = torch.autograd.functional.jacobian(states, actions)[..., 0]  # Shape: (T, D, n)
    ours = sensitivities(model, states(actions)[None], actions[None])[0, :, :3]
    torch.testing.assert_close(ours, exact, atol=1e-5, rtol=1e-5)


def test_likelihood_of_a_quadratic_reward_is_the_gaussian_density(model: RelationalModel, generator: torch.Generator):
    """Without edges R is quadratic in the jerks, so Laplace is exact: u ~ N(u*, (−H)⁻¹)."""
    state, action = scene(generator)
    reward = StructuredReward(REWARD)
    expansion = expand(model, reward, state, action)
    weights = reward.weights("node")
    precision = torch.einsum("m,mkn->kn", weights, expansion.hessian[0, 0, 0, :3]).double()
    slope = -(weights @ expansion.gradient[0, 0, 0, :3]).double()
    deviation = -torch.linalg.solve(precision, slope)  # u − u*
    n = len(slope)
    density = -0.5 * deviation @ precision @ deviation + 0.5 * torch.logdet(precision) - 0.5 * n * log(2 * pi)
    torch.testing.assert_close(log_likelihood(reward, expansion)[0, 0, 0].double(), density, atol=1e-3, rtol=1e-3)


def test_posterior_separates_a_follower_from_a_free_driver(model: RelationalModel, generator: torch.Generator):
    """Vehicle 0 brakes hard behind a slow vehicle 1, vehicle 1 drives on towards the limit through vehicle 2."""
    time = torch.arange(20) * 0.2
    slow = torch.stack([6 + 2 * time, torch.full_like(time, 2.0), torch.zeros(20)], -1)
    state = torch.stack([slow, slow, slow + torch.tensor([3.0, 0.0, 0.0])])[None].clone()
    u = torch.full((20, 1), 0.0)
    u[:4] = -3.0
    own = [torch.tensor([0.0, 6.0, 0.0])]
    free = [torch.tensor([6.0, 6.0, 0.5])]
    for t in range(19):
        own.append(model.step(own[-1], u[t] if own[-1][2] > -1.5 else torch.tensor([1.0])))
        free.append(model.step(free[-1], torch.tensor([0.0])))
    state[0, 0], state[0, 1] = torch.stack(own), torch.stack(free)
    action = model.dynamics.inverse(state[:, :2, :-1], state[:, :2, 1:], 0.2)
    reward = StructuredReward(RewardConfig(temperature=1.0))
    prior = scene_prior(reward, state, 0.9)
    posterior = marginals(reward, log_likelihood(reward, expand(model, reward, state, action)), prior)[0, :, 1]
    assert posterior[pairs(3).index((2, 1))] < 0.5


def test_edges_into_the_leader_keep_the_prior(model: RelationalModel, generator: torch.Generator):
    reward = StructuredReward(REWARD)
    state, action = scene(generator)
    prior = scene_prior(reward, state, 0.9)
    posterior = marginals(reward, log_likelihood(reward, expand(model, reward, state, action)), prior)
    for sender in (0, 1):
        torch.testing.assert_close(posterior[:, pairs(3).index((sender, 2))], edge_prior(2, 0.9).expand(2, -1))
    torch.testing.assert_close(posterior.sum(-1), torch.ones(2, 6))


def test_windows_count_as_scenes_of_their_own(model: RelationalModel, generator: torch.Generator):
    state, action = scene(generator, steps=13)
    reward = StructuredReward(REWARD)
    together = log_likelihood(reward, expand(model, reward, state, action, horizon=6, stride=6))
    first = log_likelihood(reward, expand(model, reward, state[:, :, :7], action[:, :, :6]))
    second = log_likelihood(reward, expand(model, reward, state[:, :, 6:], action[:, :, 6:]))
    torch.testing.assert_close(together, first + second, atol=1e-3, rtol=1e-3)
