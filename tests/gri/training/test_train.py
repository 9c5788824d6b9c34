"""Small trainings from end to end."""

from pathlib import Path

import msgspec
import pytest
import torch

from gri import checkpoint
from gri.data.store import DataConfig, Splits, scenes_of
from gri.evaluation.evaluate import evaluate
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.training.adversarial.airl import AdversarialSettings, PlannedStart
from gri.training.baselines.supervised import SupervisedSettings
from gri.training.grounded.optimal_scenes import OptimaSettings
from gri.training.grounded.planned_start import PlanSettings
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import Objective, TrainConfig, train

DATA = DataConfig(range="paper", graphs="one", train=96, validation=8, test=64, expert_updates=80)
TINY = DataConfig(range="us101", graphs="mixed", train=12, validation=4, test=4, expert_updates=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


def config(objective: Objective, data: DataConfig) -> TrainConfig:
    return TrainConfig(
        name="small",
        data=data,
        objective=objective,
        decoder=DecoderConfig(hidden=24),
        encoder=EncoderConfig(hidden=24, heads=4),
    )


def splits(data: DataConfig, folder: Path) -> Splits:
    return scenes_of(data, folder)


def test_supervised_training_learns(folder: Path):
    settings = SupervisedSettings(updates=90, batch=16, learning_rate=1e-2)
    untrained = train(config(SupervisedSettings(updates=1), DATA), splits(DATA, folder), 0)
    trained = train(config(settings, DATA), splits(DATA, folder), 0)
    test = splits(DATA, folder).test
    assert evaluate(trained.model, test).rmse["x"].mean < 0.5 * evaluate(untrained.model, test).rmse["x"].mean


def test_grounded_training_finds_graphs_without_labels(folder: Path):
    settings = GroundedSettings(
        updates=60, batch=16, return_batch=4, reward_updates=30, policy_rate=1e-2, encoder_rate=3e-3
    )
    trained = train(config(settings, DATA), splits(DATA, folder), 0)
    result = evaluate(trained.model, splits(DATA, folder).test)
    empty = 1 - float((splits(DATA, folder).test.graph == 1).float().mean())
    assert result.accuracy.mean > empty + 0.05
    assert result.rmse["x"].mean < 1.5
    assert trained.reward is not None


QUICK_START = PlannedStart(
    plan=PlanSettings(updates=2, batch=4, optima=OptimaSettings(scenes=8, sweeps=1, iterations=1), imitation_updates=2),
    encoder_updates=2,
)
SEMANTIC_START = msgspec.structs.replace(QUICK_START, on_semantic_reward=True)
ABLATION = AdversarialSettings(updates=2, batch=4, start=SEMANTIC_START, rewards="networks", expert_graph="likely")
OBJECTIVES = [
    GroundedSettings(updates=2, reward_updates=2, batch=4, return_batch=4),
    AdversarialSettings(updates=2, reward_updates=2, batch=4),
    AdversarialSettings(updates=2, batch=4, start=QUICK_START, expert_graph="likely"),
    ABLATION,
    msgspec.structs.replace(ABLATION, relations="all_alike"),
    SupervisedSettings(updates=2, batch=4),
]
IDS = ["gri", "airl", "planned_airl", "vairl", "airl_alike", "supervised"]


@pytest.mark.parametrize("objective", OBJECTIVES, ids=IDS)
def test_the_same_seed_gives_the_same_model(objective: Objective, folder: Path):
    first, again, other = (train(config(objective, TINY), splits(TINY, folder), seed) for seed in (3, 3, 4))
    for name, tensor in first.model.state_dict().items():
        assert torch.equal(tensor, again.model.state_dict()[name]), name
    assert not torch.equal(first.model.decoder.body.node[0].weight, other.model.decoder.body.node[0].weight)


@pytest.mark.parametrize("objective", OBJECTIVES, ids=IDS)
def test_a_trained_model_survives_its_checkpoint(objective: Objective, folder: Path, tmp_path: Path):
    trained = train(config(objective, TINY), splits(TINY, folder), 0)
    checkpoint.save(tmp_path / "m.safetensors", trained.model, trained.reward, trained.provenance)
    loaded = checkpoint.load(tmp_path / "m.safetensors")
    assert evaluate(loaded, splits(TINY, folder).test) == evaluate(trained.model, splits(TINY, folder).test)
    made = checkpoint.provenance(tmp_path / "m.safetensors")
    assert made["seed"] == 0
    assert msgspec.convert(made["config"], TrainConfig) == config(objective, TINY)


@pytest.mark.slow
def test_grounded_training_on_the_papers_scene(tmp_path: Path):
    """One seed of the table's row in a third of its updates."""
    data = DataConfig(range="paper", graphs="one", train=1000, validation=50, test=200, expert_updates=600)
    scenes = scenes_of(data, tmp_path)
    trained = train(TrainConfig(name="x", data=data, objective=GroundedSettings(updates=350)), scenes, 0)
    result = evaluate(trained.model, scenes.test)
    assert result.accuracy.mean >= 0.99
    assert result.rmse["x"].mean < 0.1
