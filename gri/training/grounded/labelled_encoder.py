"""Grounded training with an encoder that is told: it learns the scenes' own graphs instead of the reward's posterior.

For scenes whose relations are known, as those of a simulator are (`cosim scenes`): what the encoder then infers is what
the labels mean, also where the reward sees a relation differently. Reward and policy are trained as without labels, or
are those of a trained driver.
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
from gri.training.grounded.train_grounded import fit_encoder_and_policy, plan


class LabelledEncoderSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri_told"):
    """The stages' settings; those of the posterior over graphs are used for the reward alone."""

    grounded: GroundedSettings
    start: str | None = None
    """A checkpoint, or a released one's name: training goes on from its policy, and its reward stays as it is. With no
    `updates` the policy does as well. None: reward and policy are learned from the scenes.
    """


def train_labelled_encoder(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: LabelledEncoderSettings,
    seed: int,
    progress: Progress = no_progress,
) -> None:
    """Train the model and the reward in place."""
    generator, grounded = torch.Generator().manual_seed(seed), settings.grounded
    if settings.start is not None:
        take_over(model, reward, settings.start)
    else:
        fit_reward(model, reward, scenes, grounded, generator, progress)
        if grounded.optima is not None:
            plan(model, reward, scenes, grounded, generator, progress)
    told = scenes.one_hot(len(model.config.vocabulary))
    fit_encoder_and_policy(model, reward, scenes, told, grounded, generator, progress)


def take_over(model: RelationalModel, reward: StructuredReward, start: str) -> None:
    """Give the model the policy of a checkpoint, and the reward that of its policy.

    Errors: `InputError` where the checkpoint has no reward, or is of another layout or size.
    """
    path = resources.checkpoint_at(start)
    driver, its_reward = checkpoint.load(path), checkpoint.load_reward(path)
    if its_reward is None:
        raise InputError(f"{path}: was trained without a reward; field objective.start wants a grounded driver")
    for what, got, wanted in (
        ("vocabulary", driver.config.vocabulary, model.config.vocabulary),
        ("dynamics", driver.config.dynamics, model.config.dynamics),
        ("scale", driver.config.scale, model.config.scale),
        ("decoder", driver.config.decoder, model.config.decoder),
        ("reward", its_reward.config, reward.config),
    ):
        if got != wanted:
            raise InputError(
                f"{path}: its {what} is {got}, the configuration wants {wanted}; start from another driver"
            )
    model.decoder.load_state_dict(driver.decoder.state_dict())
    reward.load_state_dict(its_reward.state_dict())
    reward.requires_grad_(False)
