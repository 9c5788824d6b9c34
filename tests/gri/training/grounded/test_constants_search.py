"""A time headway that is wrong by a factor of two is found again, without labels."""

import msgspec
import pytest
import torch

from gri.core.dynamics import POINT_MASS_1D
from gri.core.graph import incoming
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import PAPER
from gri.data.store import DataConfig
from gri.data.synthetic.expert import sample_graphs, sample_starts, true_reward
from gri.networks.model import RelationalModel
from gri.planning.ilqr import ControlProblem, maximise_ilqr
from gri.rewards.structured import AssumedReward, StructuredReward
from gri.training.grounded.constants_search import ConstantsSearch, evidence, search_constants
from gri.training.grounded.reward_likelihood import scene_posterior
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import TrainConfig, model_config

SETTINGS = GroundedSettings(likelihood="stepwise", reward_prior=0.01)
TWICE = msgspec.structs.replace(PAPER.reward.constants, time_headway=1.6)


@pytest.fixture(scope="module")
def scenes() -> Scenes:
    """48 scenes in which both vehicles play their best response under the true reward."""
    generator = torch.Generator().manual_seed(5)
    start, leader = (part.double() for part in sample_starts(PAPER, 48, generator))
    graph = sample_graphs(PAPER.one_graph, 48, generator)
    reward = true_reward(PAPER).in_double()
    action = torch.zeros(48, 2, PAPER.steps - 1, 1, dtype=torch.double)
    state = leader[:, None].repeat(1, 3, 1, 1)
    for j in (1, 0):  # a leader before its follower: one sweep is enough
        others, kinds = incoming(graph, j, 3)
        types = tuple(kinds[0].tolist())
        task = ControlProblem(start[:, j], state[:, others, :-1], types, reward, POINT_MASS_1D, PAPER.dt)
        action[:, j] = maximise_ilqr(task, action[:, j], 30)
        state[:, j] = task.simulate(action[:, j])
    return Scenes(state.float(), action.float(), graph)


@pytest.fixture(scope="module")
def model() -> RelationalModel:
    config = TrainConfig(name="x", data=DataConfig(range="paper", graphs="one"), objective=SETTINGS)
    return RelationalModel(model_config(config))


def accuracy(model: RelationalModel, reward: StructuredReward, scenes: Scenes) -> float:
    return float((scene_posterior(model, reward, scenes, SETTINGS).argmax(-1) == scenes.graph).float().mean())


def test_a_doubled_time_headway_is_learned_and_the_graph_with_it(model: RelationalModel, scenes: Scenes):
    reward = StructuredReward(AssumedReward(constants=TWICE))
    before = accuracy(model, reward, scenes)
    search = ConstantsSearch(spread=0.5, draws=16, screening_scenes=12, scenes=48, rounds=((2, 20), (1, 40)))
    search_constants(model, reward, scenes, search, 0.01, 0.9, torch.Generator().manual_seed(1))
    assert before < 0.75
    assert accuracy(model, reward, scenes) > 0.95
    assert reward.constants is not None
    headway = reward.constants.standstill + 5 * reward.constants.time_headway  # [m], at 5 m/s
    true = PAPER.reward.constants.standstill + 5 * PAPER.reward.constants.time_headway
    assert float(headway.detach()) == pytest.approx(true, rel=0.1)


def test_the_evidence_is_differentiable_in_the_constants_and_the_same_without(model: RelationalModel, scenes: Scenes):
    reward = StructuredReward(AssumedReward(constants=PAPER.reward.constants))
    assert reward.constants is not None
    learned = evidence(model, reward, scenes[:4], 0.9, learn=True)
    with torch.no_grad():
        fixed = evidence(model, reward, scenes[:4], 0.9)
    torch.testing.assert_close(learned.detach(), fixed, rtol=0.02, atol=0.0)  # roots near 0 are cut off differently
    learned.sum().backward()
    assert reward.constants.log_ratio.grad is not None
    assert bool((reward.constants.log_ratio.grad != 0).any())


def test_the_same_seed_learns_the_same(model: RelationalModel, scenes: Scenes):
    search = ConstantsSearch(draws=2, screening_scenes=4, scenes=8, rounds=((1, 2),), batch=4)
    found = []
    for _ in range(2):
        reward = StructuredReward(AssumedReward(constants=TWICE))
        search_constants(model, reward, scenes, search, 0.01, 0.9, torch.Generator().manual_seed(3))
        found.append(reward.state_dict())
    for name, tensor in found[0].items():
        assert torch.equal(tensor, found[1][name])
