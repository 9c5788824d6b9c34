"""Small trainings on lane-changing scenes, from end to end."""

from pathlib import Path

import msgspec
import pytest
import torch

from gri import checkpoint
from gri.core.dynamics import DUBINS
from gri.core.graph import LANE_CHANGING
from gri.core.layers import edge_ends
from gri.data.store import DataConfig, Splits, scenes_of
from gri.data.synthetic.expert import model_config
from gri.evaluation.evaluate import evaluate, graph_of_paper
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import RelationalModel
from gri.rewards.structured import LaneRewardConfig
from gri.training.adversarial.airl import AdversarialSettings
from gri.training.baselines.nri import NriSettings
from gri.training.baselines.supervised import SupervisedSettings
from gri.training.grounded.augmentation import Shifts, random_graphs, sample_off_data, shift_starts
from gri.training.grounded.optimal_scenes import OptimaSettings
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import decayed
from gri.training.train import Objective, TrainConfig, train

TINY = DataConfig(range="lane_changing", graphs="mixed", train=12, validation=4, test=4, expert_updates=1)
ENCODER = EncoderConfig(hidden=16, heads=4, reads=(0, 1, 2, 3))


@pytest.fixture(scope="module")
def splits(tmp_path_factory: pytest.TempPathFactory) -> Splits:
    return scenes_of(TINY, tmp_path_factory.mktemp("scenes"))


def config(objective: Objective, data: DataConfig = TINY) -> TrainConfig:
    return TrainConfig(name="small", data=data, objective=objective, decoder=DecoderConfig(hidden=16), encoder=ENCODER)


STEPWISE = GroundedSettings(
    likelihood="stepwise",
    graph_scenes=8,
    updates=2,
    reward_updates=2,
    batch=4,
    return_batch=4,
    shifts=Shifts(position=(0.0, 20.0), lateral=(-1.0, 1.0)),
)
IMITATED = msgspec.structs.replace(
    STEPWISE,
    encoder_lead=2,
    planner_updates=1,
    planner_batch=4,
    optima=OptimaSettings(scenes=8, sweeps=1, iterations=1),
)
OBJECTIVES = {
    "gri": STEPWISE,
    "gri_optima": IMITATED,
    "airl": AdversarialSettings(updates=2, reward_updates=2, batch=4),
    "airl_literal": AdversarialSettings(updates=2, encoder="literal", batch=4),
    "nri": NriSettings(updates=2, batch=4),
    "supervised": SupervisedSettings(updates=2, batch=4),
}


@pytest.mark.parametrize("objective", OBJECTIVES.values(), ids=list(OBJECTIVES))
def test_every_objective_trains_and_survives_its_checkpoint(objective: Objective, splits: Splits, tmp_path: Path):
    trained = train(config(objective), splits, seed=1)
    checkpoint.save(tmp_path / "m.safetensors", trained.model, trained.reward, trained.provenance)
    loaded = checkpoint.load(tmp_path / "m.safetensors")
    result = evaluate(loaded, splits.test)
    assert result == evaluate(trained.model, splits.test)
    assert set(result.rmse) == {"x", "y", "v"}
    assert set(result.f1) <= {"none", "follow", "yield", "cut_in"}
    reward = checkpoint.load_reward(tmp_path / "m.safetensors")
    if trained.reward is None:
        assert reward is None
    else:
        assert reward is not None
        assert isinstance(reward.config, LaneRewardConfig)
        torch.testing.assert_close(reward.weights("cut_in"), trained.reward.weights("cut_in"))


@pytest.mark.parametrize("objective", [STEPWISE, IMITATED], ids=["return", "optima"])
def test_the_same_seed_gives_the_same_model(objective: GroundedSettings, splits: Splits):
    first, again = (train(config(objective), splits, seed=3).model.state_dict() for _ in range(2))
    assert all(torch.equal(first[name], again[name]) for name in first)


def test_a_model_knows_its_lane_but_not_where_on_the_road_it_is(splits: Splits):
    torch.manual_seed(0)
    model = RelationalModel(model_config(TINY.scene_range, DecoderConfig(hidden=16), ENCODER))
    state = splits.test.state
    along, across = (state + shift for shift in torch.tensor([[300.0, 0, 0, 0, 0, 0], [0, 3.5, 0, 0, 0, 0]]))
    logits = model.infer(state).logits
    torch.testing.assert_close(model.infer(along).logits, logits, atol=1e-4, rtol=1e-4)
    assert not torch.equal(model.infer(across).logits, logits)


def test_the_papers_graph_has_three_relations():
    assert graph_of_paper(LANE_CHANGING).tolist() == [2, 0, 3, 0, 1, 0]


def test_half_of_the_random_edges_are_none_and_the_rest_of_any_type(generator: torch.Generator):
    shares = random_graphs(4000, 3, 4, generator).mean((0, 1))
    torch.testing.assert_close(shares, torch.tensor([1 / 2, 1 / 6, 1 / 6, 1 / 6]), atol=0.02, rtol=0)


def test_the_return_fades_from_all_of_its_weight_to_what_is_left():
    assert [decayed(done, 0.2) for done in (0.0, 0.5, 1.0)] == pytest.approx([1.0, 0.4, 0.2])
    assert decayed(0.7, 1.0) == 1.0


def test_starts_are_shifted_along_and_across_the_road(generator: torch.Generator):
    start = torch.zeros(200, 3, 6)
    moved = shift_starts(start, Shifts(position=(0.0, 20.0), lateral=(-1.0, 1.0), speed=(1.0, 2.0)), generator, DUBINS)
    x, y, v, *rest = moved[:100, :2].unbind(-1)
    assert 0 <= x.min() < 1 < 19 < x.max() <= 20
    assert -1 <= y.min() < -0.9 < 0.9 < y.max() <= 1
    assert 1 <= v.min() <= v.max() <= 2
    assert torch.stack(rest).abs().max() == 0
    assert moved[:, 2].abs().max() == moved[100:].abs().max() == 0


def test_held_out_headways_have_no_edges(splits: Splits, generator: torch.Generator):
    start, leader, graph = sample_off_data(splits.train, Shifts(position=(0.0, 20.0)), 8.0, DUBINS, 4, 500, generator)
    assert leader.shape == (500, 30, 6)
    senders, receivers = edge_ends(3)
    near = start[:, senders, 0] - start[:, receivers, 0] < 8.0
    assert (graph[near].argmax(-1) == 0).all()
    assert (graph[~near].argmax(-1) > 0).float().mean() > 0.4


@pytest.mark.slow
def test_grounded_training_finds_graphs_without_labels(tmp_path: Path):
    data = DataConfig(range="lane_changing", graphs="mixed", train=600, validation=20, test=200, expert_updates=300)
    scenes = scenes_of(data, tmp_path)
    settings = GroundedSettings(likelihood="stepwise", updates=300, encoder_rate=3e-3, shifts=Shifts(position=(0, 20)))
    chosen = TrainConfig(name="x", data=data, objective=settings, encoder=EncoderConfig(reads=(0, 1, 2, 3)))
    result = evaluate(train(chosen, scenes, 0).model, scenes.test)
    assert result.driven_accuracy.mean > 0.9
    assert result.rmse["x"].mean < 0.5
    assert result.rmse["y"].mean < 0.3
