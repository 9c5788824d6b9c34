"""The discriminator of the adversarial objective, D = e^f / (e^f + π), per driven vehicle and step (Sec. V-B)."""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.networks.rollout import Rollout, log_density, log_prob_of, rollout
from gri.rewards.structured import ShapedReward


def airl_logit(f: Float[Tensor, "*batch"], log_pi: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """The logit of D: log D − log(1 − D) = f − log π."""
    return f - log_pi


def discriminator_loss(expert: Float[Tensor, "B R T"], generated: Float[Tensor, "B R T"]) -> Float[Tensor, ""]:
    """J per vehicle and step, −log D(τ^E) − log(1 − D(τ^G)), from the logits of recorded and generated steps."""
    return (softplus(-expert) + softplus(generated)).mean()


class DiscriminatorOutput(msgspec.Struct, frozen=True):
    """The discriminator's output for one batch."""

    expert: Tensor
    """Logits [B, R, T−1] of the recorded steps."""
    generated: Tensor
    """Logits [B, R, T−1] of the generated steps."""
    rollout: Rollout
    """The generated roll-out."""


def discriminate(
    model: RelationalModel, reward: ShapedReward, batch: Scenes, z: Tensor, generator: torch.Generator
) -> DiscriminatorOutput:
    """Roll the policy out under the one-hot graph z [B, E, K], and compute the logits of D.

    The result is differentiable with respect to the reward only.
    """
    with torch.no_grad():
        noise = torch.randn(batch.action.shape, generator=generator)
        driven = rollout(model, batch.start, z, batch.leader, noise)
        log_pi_expert = log_prob_of(model, batch.state, batch.action, z)
        log_pi_generated = log_density(noise, model.decoder.sigma)
    return DiscriminatorOutput(
        airl_logit(shaped_reward(reward, batch.state, batch.action, z), log_pi_expert),
        airl_logit(shaped_reward(reward, driven.state, driven.action, z), log_pi_generated),
        driven,
    )


def shaped_reward(reward: ShapedReward, state: Tensor, action: Tensor, z: Tensor) -> Float[Tensor, "B R T"]:
    """f_j of each driven vehicle at every step (Eq. node_reward and edge_reward), under the one-hot graph z."""
    idle = action.new_zeros(len(action), state.shape[1] - action.shape[1], *action.shape[2:])
    return reward(state, torch.cat([action, idle], 1), z)[:, : action.shape[1]]
