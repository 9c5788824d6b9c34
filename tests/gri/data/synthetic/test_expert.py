import msgspec
import pytest
import torch

from gri.core.graph import pairs
from gri.data.ranges.car_following import MIXED_GRAPHS, ONE_GRAPH, PAPER, RANGES, SceneRange
from gri.data.synthetic.expert import make_scenes, sample_graphs, sample_starts, train_expert
from gri.networks.model import ModelConfig, RelationalModel


def untrained(scenes: SceneRange) -> RelationalModel:
    torch.manual_seed(0)
    config = ModelConfig(dt=scenes.dt, never_reverse=scenes.never_reverse, scale=scenes.scale, encoder=None)
    return RelationalModel(config)


@pytest.mark.parametrize("scenes", RANGES.values(), ids=lambda r: r.name)
def test_starts_are_in_range_and_in_order(scenes: SceneRange, generator: torch.Generator):
    start, leader = sample_starts(scenes, 500, generator)
    headway = start[:, 1:, 0] - start[:, :-1, 0]
    assert scenes.starts.headway[0] - 1e-4 <= headway.min()
    assert headway.max() <= scenes.starts.headway[1] + 1e-4
    assert (start[..., 1] >= 0).all()
    assert leader.shape == (500, scenes.steps, 3)
    assert torch.equal(leader[:, 0], start[:, 2])


def test_graphs_come_in_their_shares_and_none_enters_the_leader(generator: torch.Generator):
    graphs = sample_graphs(MIXED_GRAPHS, 4000, generator)
    into_leader = [edge for edge, (_, j) in enumerate(pairs(3)) if j == 2]
    assert graphs[:, into_leader].sum() == 0
    chain = sample_graphs(ONE_GRAPH, 1, generator)
    assert abs((graphs == chain).all(-1).float().mean() - 0.5) < 0.03


@pytest.mark.parametrize("scenes", RANGES.values(), ids=lambda r: r.name)
def test_scenes_obey_the_dynamics_and_repeat_with_their_seed(scenes: SceneRange):
    expert = untrained(scenes)
    made = make_scenes(expert, scenes, MIXED_GRAPHS, 20, seed=5, action_noise=0.3)
    again = make_scenes(expert, scenes, MIXED_GRAPHS, 20, seed=5, action_noise=0.3)
    assert torch.equal(made.state, again.state)
    moved = expert.step(made.state[:, :2, :-1], made.action)
    torch.testing.assert_close(made.state[:, :2, 1:], moved, atol=1e-3, rtol=1e-4)


def test_an_experts_free_vehicle_does_not_see_the_others():
    scenes = make_scenes(untrained(PAPER), PAPER, ONE_GRAPH, 1, seed=1)
    expert = untrained(PAPER)
    other = scenes.start.clone()
    other[:, 0] += torch.tensor([3.0, 1.0, 0.0])
    from gri.networks.rollout import rollout

    with torch.no_grad():
        changed = rollout(expert, other, scenes.one_hot(2), scenes.leader)
    torch.testing.assert_close(changed.state[:, 1], scenes.state[:, 1])


def test_training_raises_the_experts_return():
    returns: list[float] = []
    short = msgspec.structs.replace(PAPER, steps=12)
    train_expert(short, ONE_GRAPH, seed=0, updates=60, batch=32, progress=lambda *p: returns.append(p[3]))
    assert sum(returns[-10:]) > sum(returns[:10]) + 1.0
