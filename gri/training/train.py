"""Training one model from one configuration."""

import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.config import read_yaml
from gri.core.graph import EdgeType, pairs
from gri.core.scenes import Scenes
from gri.data.ranges.car_following import RANGES
from gri.data.store import DataConfig, Splits
from gri.data.synthetic import expert
from gri.errors import InputError
from gri.evaluation.evaluate import evaluate
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import Edge, ModelConfig, RelationalModel
from gri.progress import Progress, no_progress
from gri.rewards.structured import AnyRewardConfig, AssumedReward, ShapedReward, StructuredReward
from gri.rewards.unstructured import NetworkReward
from gri.training.adversarial.airl import AdversarialSettings, train_adversarial, with_fixed_rationality
from gri.training.baselines.nri import NriSettings, train_nri
from gri.training.baselines.supervised import SupervisedSettings, train_supervised
from gri.training.grounded.labelled_encoder import LabelledEncoderSettings, train_labelled_encoder
from gri.training.grounded.recorded_traffic import RecordedSettings, recorded_prior, train_recorded
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import train_grounded
from gri.training.training_state import TrainingState

Objective = (
    GroundedSettings
    | RecordedSettings
    | LabelledEncoderSettings
    | AdversarialSettings
    | NriSettings
    | SupervisedSettings
)


class TrainConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A model, its scenes, and its training objective."""

    name: str
    data: DataConfig
    objective: Objective
    decoder: DecoderConfig = DecoderConfig()
    encoder: EncoderConfig = EncoderConfig()
    """Not used by objectives that do not infer graphs."""
    reward: AssumedReward | msgspec.UnsetType = msgspec.UNSET
    """What the learner assumes of synthetic car-following drivers. Not set: it knows the constants of the expert."""


@dataclass(frozen=True)
class Trained:
    """A trained model, the reward it was grounded in (None without one), and its provenance for the checkpoint."""

    model: RelationalModel
    reward: StructuredReward | None
    provenance: dict[str, Any]


def read_train_config(path: Path | str) -> TrainConfig:
    """The training configuration of a YAML file.

    Errors: `InputError` if the file cannot be read, a field is unknown or has a wrong value, or a setting of the
    adversarial objective has no effect with the others.
    """
    config = read_yaml(path, TrainConfig)
    for field in ("train", "validation", "test"):
        if getattr(config.data, field) < 1:
            raise InputError(f"{path}: field data.{field}: got {getattr(config.data, field)}, wanted 1 or more scenes")
    if isinstance(config.objective, AdversarialSettings):
        _check_adversarial(path, config.objective)
    if isinstance(config.objective, NriSettings) and config.objective.structured_prior and not config.data.recorded:
        got = f"got it for range {config.data.range}, wanted scenes of recorded traffic; leave it out"
        raise InputError(f"{path}: field objective.structured_prior: {got}")
    if config.reward and config.data.range not in RANGES:
        got = f"got it for range {config.data.range}, wanted one of {', '.join(RANGES)}; leave it out"
        raise InputError(f"{path}: field reward: {got}")
    return config


def _check_adversarial(path: Path | str, settings: AdversarialSettings) -> None:
    """Errors: `InputError` for settings that have no effect with the other settings."""
    semantic, inferred = settings.rewards == "semantic", settings.relations == "inferred"
    planned = settings.start is not None and bool(settings.start.on_semantic_reward)
    for field, wanted, effective in (
        ("start", "semantic rewards and inferred relations, or on_semantic_reward", (semantic and inferred) or planned),
        ("weights", "semantic rewards, whose terms have names", semantic),
    ):
        if getattr(settings, field) and not effective:
            got = f"rewards: {settings.rewards} and relations: {settings.relations}"
            raise InputError(f"{path}: field objective.{field}: got {got}, wanted {wanted}; leave it out")


def model_config(config: TrainConfig) -> ModelConfig:
    """The configuration of the model for the scenes and the objective of `config`."""
    supervised = isinstance(config.objective, SupervisedSettings)
    all_alike = isinstance(config.objective, AdversarialSettings) and config.objective.relations == "all_alike"
    chosen = expert.model_config(
        config.data.recorded or config.data.scene_range,
        config.decoder,
        encoder=None if supervised or all_alike else config.encoder,
        graph=_uniform_graph(3) if all_alike else None,
    )
    return msgspec.structs.replace(chosen, told_graph=supervised)


def learner_reward(config: TrainConfig) -> AnyRewardConfig:
    """The reward that the learner begins with. It shares no object with the reward of the expert.

    If the configuration says nothing, it has the expert's constants, units and temperature: the paper's own game.
    """
    if config.reward:
        return config.reward
    given = (config.data.recorded or config.data.scene_range).reward
    return msgspec.convert(msgspec.to_builtins(given), type(given))


def _uniform_graph(vehicles: int) -> tuple[Edge, ...]:
    """A graph with the same type for all ordered pairs. The type's name has no meaning here."""
    return tuple(Edge(sender=i, receiver=j, type=EdgeType.FOLLOW) for i, j in pairs(vehicles))


def train(
    config: TrainConfig,
    splits: Splits,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> Trained:
    """Train a new model. The same configuration, scenes, seed and versions give the same model.

    `progress` is called after every update. With `state`, the training goes on where that one was stopped.
    """
    started = time.monotonic(), time.process_time()
    torch.manual_seed(seed)
    model = RelationalModel(model_config(config))
    scenes = config.data.recorded or config.data.scene_range
    reward: StructuredReward | None = None
    match config.objective:
        case SupervisedSettings() as settings:
            train_supervised(model, splits.train, settings, seed, progress, state=state)
        case GroundedSettings() as settings:
            reward = StructuredReward(learner_reward(config))
            train_grounded(model, reward, splits.train, settings, seed, progress, state=state)
        case RecordedSettings() as settings:
            reward = StructuredReward(learner_reward(config))
            train_recorded(model, reward, splits.train, settings, seed, progress, state=state)
        case LabelledEncoderSettings() as settings:
            reward = StructuredReward(learner_reward(config))
            train_labelled_encoder(model, reward, splits.train, settings, seed, progress, state=state)
        case NriSettings() as settings:
            priors = _structured_prior(config, settings, splits.train) if settings.structured_prior else None
            train_nri(model, splits.train, settings, seed, progress, priors, state)
        case AdversarialSettings(rewards="networks") as settings:
            networks = NetworkReward(scenes.scale, model.config.vocabulary)
            shaped, planning = ShapedReward(networks, scenes.scale), StructuredReward(learner_reward(config))
            train_adversarial(model, shaped, splits.train, settings, seed, progress, planning, state)
        case AdversarialSettings() as settings:
            reward = StructuredReward.with_weights(
                with_fixed_rationality(learner_reward(config)), settings.weights or {}
            )
            train_adversarial(
                model, ShapedReward(reward, scenes.scale), splits.train, settings, seed, progress, state=state
            )
    return Trained(model.requires_grad_(False).eval(), reward, _provenance(config, seed, started, model, splits, state))


def _structured_prior(config: TrainConfig, settings: NriSettings, scenes: Scenes) -> Float[Tensor, "S E K"]:
    """The prior of grounded training on recorded traffic, with the odds of the bottleneck."""
    odds = GroundedSettings(no_edge_prior=settings.bottleneck.no_edge_prior, ahead_only=True)
    return recorded_prior(StructuredReward(learner_reward(config)), scenes.state, RecordedSettings(grounded=odds))


def _provenance(
    config: TrainConfig,
    seed: int,
    started: tuple[float, float],
    model: RelationalModel,
    splits: Splits,
    state: TrainingState | None,
) -> dict[str, Any]:
    before = state.spent if state else (0.0, 0.0)
    return {
        "config": msgspec.to_builtins(config),
        "seed": seed,
        "seconds": round(before[0] + time.monotonic() - started[0], 1),
        "cpu_seconds": round(before[1] + time.process_time() - started[1], 1),
        "versions": {"gri-cosim": version("gri-cosim"), "torch": str(torch.__version__)},
        "validation": msgspec.to_builtins(evaluate(model, splits.validation)),
    }
