"""Fine-tuning: training a trained model on other scenes by its own objective."""

from typing import TypeVar

import msgspec
import torch

from gri.core.scenes import Scenes
from gri.errors import InputError
from gri.networks.model import RelationalModel
from gri.progress import Progress, no_progress
from gri.rewards.structured import ShapedReward, StructuredReward
from gri.training.adversarial.airl import AdversarialSettings, train_adversarial
from gri.training.baselines.nri import NriSettings, train_nri
from gri.training.baselines.supervised import SupervisedSettings, train_supervised
from gri.training.grounded.recorded_traffic import RecordedSettings, recorded_posterior
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import fit_encoder_and_policy
from gri.training.train import TrainConfig

Settings = TypeVar("Settings", SupervisedSettings, NriSettings, GroundedSettings, AdversarialSettings)


class FineTuning(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The number of updates and the reduction of the learning rates."""

    updates: int = 150
    slower: float = 0.2
    """Factor on all learning rates."""


def fine_tune(
    model: RelationalModel,
    reward: StructuredReward | None,
    config: TrainConfig,
    scenes: Scenes,
    tuning: FineTuning,
    seed: int,
    progress: Progress = no_progress,
) -> None:
    """Train the model further in place, on `scenes`.

    `config` is the configuration by which it was trained, and `reward` the reward of its checkpoint. The reward stays
    as it is, except in the adversarial objective, which continues to learn it. Grounded models learn from the posterior
    over the graphs of the new scenes under their reward.

    Errors: `InputError` for the objectives `gri` and `gri_told`, which cannot be continued.
    """
    model.requires_grad_(True)
    match config.objective:
        case SupervisedSettings() as settings:
            train_supervised(model, scenes, _slower(settings, tuning, "learning_rate"), seed, progress)
        case NriSettings() as settings:
            train_nri(model, scenes, _slower(settings, tuning, "policy_rate", "encoder_rate"), seed, progress)
        case RecordedSettings() as recorded:
            assert reward is not None, "a grounded model comes with its reward"
            settings = _slower(recorded.grounded, tuning, "policy_rate", "encoder_rate")
            settings = msgspec.structs.replace(settings, encoder_lead=0, encoder_updates=None)
            posterior = recorded_posterior(model, reward.requires_grad_(False), scenes, recorded)
            generator = torch.Generator().manual_seed(seed)
            fit_encoder_and_policy(model, reward, scenes, posterior, settings, generator, progress)
        case AdversarialSettings() as settings:
            assert reward is not None, "a grounded model comes with its reward"
            settings = _slower(settings, tuning, "policy_rate", "encoder_rate", "reward_rate")
            settings = msgspec.structs.replace(settings, start=None)
            # A checkpoint does not contain the shaping potentials, so they begin anew.
            shaped = ShapedReward(reward.requires_grad_(True), model.config.scale)
            train_adversarial(model, shaped, scenes, settings, seed, progress)
        case other:
            raise InputError(f"got objective {type(other).__name__}, wanted one of airl, gri_recorded, nri, supervised")
    model.requires_grad_(False).eval()


def _slower(settings: Settings, tuning: FineTuning, *rates: str) -> Settings:
    """The settings with the updates of `tuning` and reduced learning rates."""
    reduced = {name: tuning.slower * getattr(settings, name) for name in rates}
    return msgspec.structs.replace(settings, updates=tuning.updates, **reduced)
