import msgspec
import torch

from gri.core.graph import LANE_CHANGING, EdgeType, InteractionGraph, pairs
from gri.data.ranges.lane_changing import LANE_CHANGING_SCENES, sample_merge
from gri.data.synthetic.expert import make_scenes, model_config, sample_graphs, train_expert
from gri.networks.decoder import DecoderConfig
from gri.networks.model import RelationalModel

LANES = LANE_CHANGING_SCENES


def untrained() -> RelationalModel:
    torch.manual_seed(0)
    return RelationalModel(model_config(LANES, DecoderConfig(), None))


def test_starts_are_a_merge(generator: torch.Generator):
    start, leader = sample_merge(LANES, 500, generator)
    x, y, v, heading, a, yaw_rate = start.unbind(-1)
    headway, lag = x[:, 2] - x[:, 0], x[:, 0] - x[:, 1]
    assert headway.min() >= 8 - 1e-4
    assert headway.max() <= 12 + 1e-4
    assert lag.abs().max() <= 2 + 1e-4
    assert (y[:, 0] + 3.5).abs().max() <= 0.3
    assert y[:, 1].abs().max() <= 0.3
    assert torch.stack([heading, a, yaw_rate]).abs().max() == 0
    assert v.min() >= 4
    assert v.max() <= 6
    assert torch.equal(leader[:, 0], start[:, 2])
    torch.testing.assert_close(leader[:, -1, 0], 5.8 * v[:, 2])


def test_the_one_graph_is_the_papers():
    graph = sample_graphs(LANES.one_graph, 1, torch.Generator(), LANE_CHANGING)
    edges = {pair: kind for pair, (kind, _) in InteractionGraph.certain(graph, LANE_CHANGING).edges().items()}
    assert edges == {(2, 0): EdgeType.FOLLOW, (1, 0): EdgeType.CUT_IN, (0, 1): EdgeType.YIELD}


def test_mixed_graphs_use_all_types_and_leave_the_leader_alone(generator: torch.Generator):
    graphs = sample_graphs(LANES.mixed_graphs, 4000, generator, LANE_CHANGING)
    assert sorted(graphs.unique().tolist()) == [0, 1, 2, 3]
    assert graphs[:, [edge for edge, (_, j) in enumerate(pairs(3)) if j == 2]].sum() == 0
    assert len(graphs.unique(dim=0)) == len(LANES.mixed_graphs)
    assert abs(sum(graph.share for graph in LANES.mixed_graphs) - 1) < 1e-9


def test_scenes_obey_the_dynamics_and_repeat_with_their_seed():
    expert = untrained()
    made, again = (make_scenes(expert, LANES, LANES.mixed_graphs, 20, seed=5, action_noise=0.3) for _ in range(2))
    assert torch.equal(made.state, again.state)
    assert torch.equal(made.graph, again.graph)
    assert made.state.shape == (20, 3, 30, 6)
    moved = expert.step(made.state[:, :2, :-1], made.action)
    torch.testing.assert_close(made.state[:, :2, 1:], moved, atol=1e-3, rtol=1e-4)


def test_noise_is_stated_in_jerk_and_scaled_to_the_other_action():
    quiet, noisy = (make_scenes(untrained(), LANES, LANES.one_graph, 200, 1, noise) for noise in (0.0, 0.01))
    difference = (noisy.action - quiet.action).std((0, 1, 2))
    torch.testing.assert_close(difference, torch.tensor([0.01, 0.002]), rtol=0.05, atol=0)


def test_training_raises_the_experts_return():
    returns: list[float] = []
    short = msgspec.structs.replace(LANES, steps=12)
    train_expert(short, LANES.mixed_graphs, seed=0, updates=40, batch=32, progress=lambda *p: returns.append(p[3]))
    assert sum(returns[-10:]) > sum(returns[:10]) + 1.0
