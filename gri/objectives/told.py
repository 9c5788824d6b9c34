"""Grounded training with an encoder that is told: it learns the scenes' own graphs instead of the reward's posterior.

For scenes whose relations are known, as those of a simulator are (`cosim scenes`): what the encoder then infers is what
the labels mean, also where the reward sees a relation differently. Reward and policy are trained as without labels.
"""

import msgspec
import torch

from gri.data.synthetic import Scenes
from gri.model import RelationalModel
from gri.objectives.gri import GroundedSettings, fit_encoder_and_policy, fit_reward, plan
from gri.progress import Progress, silent
from gri.rewards import StructuredReward


class ToldSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri_told"):
    """The stages' settings; those of the posterior over graphs are used for the reward alone."""

    grounded: GroundedSettings


def train_told(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: ToldSettings,
    seed: int,
    progress: Progress = silent,
) -> None:
    """Train the model and the reward in place."""
    generator, grounded = torch.Generator().manual_seed(seed), settings.grounded
    fit_reward(model, reward, scenes, grounded, generator, progress)
    if grounded.optima is not None:
        plan(model, reward, scenes, grounded, generator, progress)
    told = scenes.one_hot(len(model.config.vocabulary))
    fit_encoder_and_policy(model, reward, scenes, told, grounded, generator, progress)
