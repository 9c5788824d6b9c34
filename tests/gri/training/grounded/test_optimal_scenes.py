import pytest
import torch

from gri.core.dynamics import constant_speed
from gri.core.scenes import Scenes
from gri.data.ranges.lane_changing import LANE_CHANGING_SCENES
from gri.data.synthetic.expert import model_config, returns, sample_starts
from gri.networks.decoder import DecoderConfig
from gri.networks.model import RelationalModel
from gri.networks.rollout import rollout
from gri.rewards.structured import StructuredReward
from gri.training.grounded.augmentation import random_graphs
from gri.training.grounded.optimal_scenes import OptimaSettings, distance_to_optima, incoming, optimal_scenes

COUNT = 6


@pytest.fixture
def model() -> RelationalModel:
    torch.manual_seed(0)
    return RelationalModel(model_config(LANE_CHANGING_SCENES, DecoderConfig(hidden=16), None))


@pytest.fixture
def begun(generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    start, leader = sample_starts(LANE_CHANGING_SCENES, COUNT, generator, steps=8)
    return start, leader, random_graphs(COUNT, 3, 4, generator)


def own_returns(reward: StructuredReward, scenes: Scenes) -> torch.Tensor:
    return returns(reward, scenes.state, scenes.action, scenes.one_hot(4)).sum(-1)


def test_no_vehicle_gains_by_leaving_its_optimum(
    model: RelationalModel, begun: tuple[torch.Tensor, torch.Tensor, torch.Tensor], generator: torch.Generator
):
    reward = StructuredReward(LANE_CHANGING_SCENES.reward)
    found = optimal_scenes(model, reward, *begun, OptimaSettings(sweeps=4, iterations=40))
    driven = rollout(model, begun[0], begun[2], begun[1])
    paid = own_returns(reward, found)
    assert (own_returns(reward, Scenes(driven.state, driven.action, found.graph)) < paid).float().mean() > 0.8
    for vehicle in (0, 1):
        action = found.action[:, vehicle] + 0.2 * torch.randn(found.action[:, vehicle].shape, generator=generator)
        state = [found.state[:, vehicle, 0]]
        for u in action.unbind(1):
            state.append(model.step(state[-1], u))
        others = Scenes(found.state.clone(), found.action.clone(), found.graph)
        others.state[:, vehicle], others.action[:, vehicle] = torch.stack(state, 1), action
        assert (own_returns(reward, others)[:, vehicle] < paid[:, vehicle]).all()


def test_optima_obey_the_dynamics_and_keep_starts_leader_and_graph(
    model: RelationalModel, begun: tuple[torch.Tensor, torch.Tensor, torch.Tensor]
):
    found = optimal_scenes(model, StructuredReward(LANE_CHANGING_SCENES.reward), *begun, OptimaSettings(iterations=3))
    torch.testing.assert_close(found.start, begun[0])
    torch.testing.assert_close(found.leader, begun[1])
    assert torch.equal(found.graph, begun[2].argmax(-1))
    torch.testing.assert_close(model.step(found.state[:, :2, 3], found.action[:, :, 3]), found.state[:, :2, 4])


def test_optima_that_foresee_more_are_those_of_longer_scenes(
    model: RelationalModel, begun: tuple[torch.Tensor, torch.Tensor, torch.Tensor]
):
    start, leader, graph = begun
    reward = StructuredReward(LANE_CHANGING_SCENES.reward)
    further = constant_speed(leader[:, -1], 5, model.dynamics, model.dt)[:, 1:]
    longer = optimal_scenes(model, reward, start, torch.cat([leader, further], 1), graph, OptimaSettings(iterations=3))
    found = optimal_scenes(model, reward, *begun, OptimaSettings(iterations=3, beyond=5))
    assert torch.equal(found.state, longer.state[:, :, : leader.shape[1]])
    assert torch.equal(found.action, longer.action[:, :, : leader.shape[1] - 1])


def test_edges_come_in_by_the_order_of_their_senders():
    graph = torch.tensor([[1, 2, 3, 4, 5, 6]])  # 0->1, 0->2, 1->0, 1->2, 2->0, 2->1
    assert incoming(graph, 0, 3)[1].tolist() == [[3, 5]]
    others, kinds = incoming(graph, 1, 3)
    assert others == [0, 2]
    assert kinds.tolist() == [[1, 6]]


def test_distances_count_squared_when_small_and_linearly_when_large(
    model: RelationalModel, begun: tuple[torch.Tensor, torch.Tensor, torch.Tensor]
):
    driven = rollout(model, begun[0], begun[2], begun[1])
    graph = begun[2].argmax(-1)

    def moved(by: float) -> torch.Tensor:
        """Both vehicles' optimum `by` metres to the left of where the model drives them, but for the start."""
        state = driven.state.detach().clone()
        state[:, :2, 1:, 1] += by
        return distance_to_optima(model, Scenes(state, driven.action.detach(), graph), scale=1.0)

    assert moved(0.0) == 0
    torch.testing.assert_close(moved(0.01), torch.tensor(0.01**2 * 7 / 8), rtol=1e-2, atol=0)
    torch.testing.assert_close(moved(200.0) / moved(100.0), torch.tensor(2.0), rtol=1e-2, atol=0)
