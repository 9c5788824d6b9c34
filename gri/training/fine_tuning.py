"""More training of a trained model on other scenes, by its own objective."""

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
from gri.training.grounded.train_grounded import fit_encoder_and_policy
from gri.training.train import TrainConfig


class FineTuning(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How long, and how much more slowly than at first."""

    updates: int = 150
    slower: float = 0.2
    """Factor on all rates."""


def fine_tune(
    model: RelationalModel,
    reward: StructuredReward | None,
    config: TrainConfig,
    scenes: Scenes,
    tuning: FineTuning,
    seed: int,
    progress: Progress = no_progress,
) -> None:
    """Train the model on in place. Rewards stay, as grounded models get the posterior of the new scenes from theirs;
    but in the game they go on learning.

    Errors: `InputError` for objectives that cannot be taken up again.
    """
    model.requires_grad_(True)
    slower = tuning.slower
    match config.objective:
        case SupervisedSettings() as settings:
            rates = {"learning_rate": slower * settings.learning_rate}
            train_supervised(
                model, scenes, msgspec.structs.replace(settings, updates=tuning.updates, **rates), seed, progress
            )
        case NriSettings() as settings:
            rates = {"policy_rate": slower * settings.policy_rate, "encoder_rate": slower * settings.encoder_rate}
            train_nri(model, scenes, msgspec.structs.replace(settings, updates=tuning.updates, **rates), seed, progress)
        case RecordedSettings() as recorded:
            assert reward is not None, "a grounded model comes with its reward"
            settings = recorded.grounded
            rates = {"policy_rate": slower * settings.policy_rate, "encoder_rate": slower * settings.encoder_rate}
            settings = msgspec.structs.replace(
                settings, updates=tuning.updates, encoder_lead=0, encoder_updates=None, **rates
            )
            posterior = recorded_posterior(model, reward.requires_grad_(False), scenes, recorded)
            generator = torch.Generator().manual_seed(seed)
            fit_encoder_and_policy(model, reward, scenes, posterior, settings, generator, progress)
        case AdversarialSettings() as settings:
            assert reward is not None, "a grounded model comes with its reward"
            rates = {name: slower * getattr(settings, name) for name in ("policy_rate", "encoder_rate", "reward_rate")}
            settings = msgspec.structs.replace(settings, updates=tuning.updates, start=None, **rates)
            shaped = ShapedReward(reward.requires_grad_(True), model.config.scale)  # its potentials are not kept
            train_adversarial(model, shaped, scenes, settings, seed, progress)
        case other:
            raise InputError(f"got objective {type(other).__name__}, wanted one of airl, gri_recorded, nri, supervised")
    model.requires_grad_(False).eval()
