"""Grounded training with a labelled encoder: it learns the graphs of the scenes instead of the posterior over graphs.

This is for scenes with known relations, such as those of a simulator (`cosim scenes`). The encoder then infers what the
labels mean, even if the reward implies another relation. Reward and policy are trained without labels, or taken from
another checkpoint.
"""

import msgspec
import torch

from gri import checkpoint, resources
from gri.core.scenes import Scenes
from gri.errors import InputError
from gri.networks.model import RelationalModel
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.grounded.reward_likelihood import fit_reward
from gri.training.grounded.settings import GroundedSettings
from gri.training.grounded.train_grounded import fit_encoder_and_policy, plan_policy
from gri.training.training_state import TrainingState


class LabelledEncoderSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri_told"):
    """The settings of the stages. Those of the posterior over graphs affect the reward only."""

    grounded: GroundedSettings
    start: str | None = None
    """A checkpoint, or the name of a released one, from which policy and reward are taken.

    The reward stays unchanged, and with `updates` = 0 the policy, too. None: both are learned from the scenes.
    """


def train_labelled_encoder(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: LabelledEncoderSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the model and the reward in place. The model must have an encoder.

    Errors: `InputError` if `settings.start` is not a checkpoint that fits (`load_driver`).
    """
    generator, grounded = torch.Generator().manual_seed(seed), settings.grounded
    if settings.start is not None:
        load_driver(model, reward, settings.start)
    else:
        fit_reward(model, reward, scenes, grounded, generator, progress, state)
        if grounded.optima is not None:
            plan_policy(model, reward, scenes, grounded, generator, progress, state)
    labels = scenes.one_hot(len(model.config.vocabulary))
    fit_encoder_and_policy(model, reward, scenes, labels, grounded, generator, progress, state=state)


def load_driver(model: RelationalModel, reward: StructuredReward, start: str) -> None:
    """Copy the policy of the checkpoint `start` to the model, and its reward to `reward`.

    Errors: `InputError` if the checkpoint has no reward, or another vocabulary, dynamics, scale, decoder or reward.
    """
    path = resources.find_checkpoint(start)
    driver, driver_reward = checkpoint.load(path), checkpoint.load_reward(path)
    if driver_reward is None:
        raise InputError(
            f"{path}: got a checkpoint without a reward, wanted one with a reward in field objective.start"
        )
    for what, got, wanted in (
        ("vocabulary", driver.config.vocabulary, model.config.vocabulary),
        ("dynamics", driver.config.dynamics, model.config.dynamics),
        ("scale", driver.config.scale, model.config.scale),
        ("decoder", driver.config.decoder, model.config.decoder),
        ("reward", driver_reward.config, reward.config),
    ):
        if got != wanted:
            raise InputError(
                f"{path}: got {what} {got}, the configuration wants {wanted}; start from another checkpoint"
            )
    model.decoder.load_state_dict(driver.decoder.state_dict())
    reward.load_state_dict(driver_reward.state_dict())
    reward.requires_grad_(False)
