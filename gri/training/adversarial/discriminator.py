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
    """log D − log(1 − D) = f − log π."""
    return f - log_pi


def discriminator_loss(expert: Float[Tensor, "B R T"], generated: Float[Tensor, "B R T"]) -> Float[Tensor, ""]:
    """J per vehicle and step from the logits of D: −log D(τ^E) − log(1 − D(τ^G))."""
    return (softplus(-expert) + softplus(generated)).mean()


class DiscriminatorOutput(msgspec.Struct, frozen=True):
    """One batch seen by the discriminator: logits of recorded and generated steps, and the generated roll-out."""

    expert: Tensor
    generated: Tensor
    rollout: Rollout


def judge(
    model: RelationalModel, reward: ShapedReward, batch: Scenes, z: Tensor, generator: torch.Generator
) -> DiscriminatorOutput:
    """Roll the policy out under z and form the logits of D; differentiable in the reward only."""
    with torch.no_grad():
        noise = torch.randn(batch.action.shape, generator=generator)
        driven = rollout(model, batch.start, z, batch.leader, noise)
        log_pi_expert = log_prob_of(model, batch.state, batch.action, z)
        log_pi_generated = log_density(noise, model.decoder.sigma)
    return DiscriminatorOutput(
        airl_logit(shaped(reward, batch.state, batch.action, z), log_pi_expert),
        airl_logit(shaped(reward, driven.state, driven.action, z), log_pi_generated),
        driven,
    )


def shaped(reward: ShapedReward, state: Tensor, action: Tensor, z: Tensor) -> Float[Tensor, "B R T"]:
    """f_j of the driven vehicles."""
    idle = action.new_zeros(len(action), state.shape[1] - action.shape[1], *action.shape[2:])
    return reward(state, torch.cat([action, idle], 1), z)[:, : action.shape[1]]
