"""Train one model from one configuration."""

import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import torch

from gri.config import read_yaml
from gri.core.graph import EdgeType, pairs
from gri.data.store import DataConfig, Splits
from gri.data.synthetic import expert
from gri.errors import InputError
from gri.evaluation.evaluate import evaluate
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import Edge, ModelConfig, RelationalModel
from gri.progress import Progress, no_progress
from gri.rewards.structured import ShapedReward, StructuredReward
from gri.rewards.unstructured import NetworkReward
from gri.training.adversarial.airl import AdversarialSettings, in_the_game, train_adversarial
from gri.training.baselines.nri import NriSettings, train_nri
from gri.training.baselines.supervised import SupervisedSettings, train_supervised
from gri.training.grounded.labelled_encoder import LabelledEncoderSettings, train_labelled_encoder
from gri.training.grounded.recorded_traffic import RecordedSettings, train_recorded
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import train_grounded

Objective = (
    GroundedSettings
    | RecordedSettings
    | LabelledEncoderSettings
    | AdversarialSettings
    | NriSettings
    | SupervisedSettings
)


class TrainConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A model, the scenes it learns from, and the objective it is trained by."""

    name: str
    data: DataConfig
    objective: Objective
    decoder: DecoderConfig = DecoderConfig()
    encoder: EncoderConfig = EncoderConfig()
    """Not used by objectives that infer no graph."""


@dataclass(frozen=True)
class Trained:
    """A trained model, the reward it was grounded in if any, and how it came about."""

    model: RelationalModel
    reward: StructuredReward | None
    provenance: dict[str, Any]


def read_train_config(path: Path | str) -> TrainConfig:
    """The training configuration of a YAML file."""
    config = read_yaml(path, TrainConfig)
    for field in ("train", "validation", "test"):
        if getattr(config.data, field) < 1:
            raise InputError(f"{path}: field data.{field}: got {getattr(config.data, field)}, wanted 1 or more scenes")
    if isinstance(config.objective, AdversarialSettings):
        _check_game(path, config.objective)
    return config


def _check_game(path: Path | str, game: AdversarialSettings) -> None:
    """Errors: `InputError` for settings that the other settings leave without an effect."""
    for field, wanted, kept in (
        ("start", "semantic and inferred ones", (game.rewards, game.relations) == ("semantic", "inferred")),
        ("weights", "semantic ones, whose terms have names", game.rewards == "semantic"),
    ):
        if getattr(game, field) and not kept:
            got = f"rewards: {game.rewards} and relations: {game.relations}"
            raise InputError(f"{path}: field objective.{field}: got {got}, wanted {wanted}; leave it out")


def model_config(config: TrainConfig) -> ModelConfig:
    """The model that goes with the scenes of a configuration."""
    told = isinstance(config.objective, SupervisedSettings)
    all_alike = isinstance(config.objective, AdversarialSettings) and config.objective.relations == "all_alike"
    fitting = expert.model_config(
        config.data.recorded or config.data.scene_range,
        config.decoder,
        encoder=None if told or all_alike else config.encoder,
        graph=_all_alike(3) if all_alike else None,
    )
    return msgspec.structs.replace(fitting, told_graph=told)


def _all_alike(vehicles: int) -> tuple[Edge, ...]:
    """Every pair related in the same way; the type's name means nothing."""
    return tuple(Edge(sender=i, receiver=j, type=EdgeType.FOLLOW) for i, j in pairs(vehicles))


def train(config: TrainConfig, splits: Splits, seed: int, progress: Progress = no_progress) -> Trained:
    """Train from scratch; the same configuration, scenes, seed and versions give the same model."""
    began = time.monotonic(), time.process_time()
    torch.manual_seed(seed)
    model = RelationalModel(model_config(config))
    scenes = config.data.recorded or config.data.scene_range
    reward: StructuredReward | None = None
    match config.objective:
        case SupervisedSettings() as settings:
            train_supervised(model, splits.train, settings, seed, progress)
        case GroundedSettings() as settings:
            reward = StructuredReward(scenes.reward)
            train_grounded(model, reward, splits.train, settings, seed, progress)
        case RecordedSettings() as settings:
            reward = StructuredReward(scenes.reward)
            train_recorded(model, reward, splits.train, settings, seed, progress)
        case LabelledEncoderSettings() as settings:
            reward = StructuredReward(scenes.reward)
            train_labelled_encoder(model, reward, splits.train, settings, seed, progress)
        case NriSettings() as settings:
            train_nri(model, splits.train, settings, seed, progress)
        case AdversarialSettings(rewards="networks") as settings:
            networks = NetworkReward(scenes.scale, model.config.vocabulary)
            train_adversarial(model, ShapedReward(networks, scenes.scale), splits.train, settings, seed, progress)
        case AdversarialSettings() as settings:
            reward = StructuredReward.with_weights(in_the_game(scenes.reward), settings.weights or {})
            train_adversarial(model, ShapedReward(reward, scenes.scale), splits.train, settings, seed, progress)
    return Trained(model.requires_grad_(False).eval(), reward, _provenance(config, seed, began, model, splits))


def _provenance(
    config: TrainConfig, seed: int, began: tuple[float, float], model: RelationalModel, splits: Splits
) -> dict[str, Any]:
    return {
        "config": msgspec.to_builtins(config),
        "seed": seed,
        "seconds": round(time.monotonic() - began[0], 1),
        "cpu_seconds": round(time.process_time() - began[1], 1),
        "versions": {"gri-cosim": version("gri-cosim"), "torch": str(torch.__version__)},
        "validation": msgspec.to_builtins(evaluate(model, splits.validation)),
    }
