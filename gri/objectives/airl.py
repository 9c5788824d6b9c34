"""The paper's adversarial objective: encoder, reward and policy in one min-max game (Sec. V-B).

    max_η min_{ξ,ω,ψ,χ,φ} J = E_z~q [ −Σ_t log D(τ^E, z) − E_{τ^G~π(·|z)} Σ_t log(1 − D(τ^G, z)) ],
    D = e^f / (e^f + π),  subject to E KL[q(z|τ^E) || p(z)] ≤ I_c

Three readings that the paper leaves open are fixed here:

- D is a matter of each driven vehicle by itself, with logit f_j − log π_j.
- The policy maximises f − log π, D's logit, as in AIRL, not the saturating −log(1 − D). Its standard deviation is held
  fixed, so that log π of its own samples carries no gradient and E[f] is what remains.
- The encoder gets its gradient through f alone, with policy and roll-outs held fixed: f is linear in the one-hot z, so
  that gradient is one number per edge and type, clipped. `contrast` leaves out the weights 1 − D(τ^E) and D(τ^G),
  which fall to zero exactly where the graph is wrong; `literal` keeps them.
"""

from typing import Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from gri.data.synthetic import Scenes
from gri.graph import InteractionGraph, agents_of, pairs
from gri.laplace import edge_prior
from gri.model import RelationalModel
from gri.objectives.common import Bottleneck, Descent, batches, categorical_kl, updated_beta
from gri.progress import Progress, silent
from gri.rewards import ShapedReward
from gri.rollout import Rollout, log_density, log_prob_of, rollout


class AdversarialSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="airl"):
    """The game's options."""

    updates: int = 600
    batch: int = 64
    encoder: Literal["contrast", "literal"] = "contrast"
    """Whether the weights 1 − D(τ^E) and D(τ^G) are left out of J's slopes, for the encoder and in `expert_term`."""
    reward_updates: int = 1
    """Updates of encoder and reward per update of the policy; the literal form needs about 4."""
    policy_rate: float = 2e-3
    reward_rate: float = 2e-3
    encoder_rate: float = 2e-3
    clip: float = 5.0
    """Bound of the encoder's gradient per edge [nats]; without it the logits saturate in a hundred updates.
    """
    logit_penalty: float = 0.05
    """Weight of the squared differences of the encoder's logits. A certain graph is sampled in one way only and has no
    gradient left that could mend it; the penalty leaves every type a small share.
    """
    expert_term: float = 1.0
    """Weight of the expert's half of J in what the policy maximises; 1 as printed, 0 in AIRL. No label enters."""
    bottleneck: Bottleneck = Bottleneck()
    rewards: Literal["semantic", "networks"] = "semantic"
    """`networks` replaces the named terms by free functions: the ablation GRI-VAIRL (Appendix C)."""
    relations: Literal["inferred", "all_alike"] = "inferred"
    """`all_alike`: no encoder, every pair has the same relation; with `networks` the ablation GRI-AIRL."""


def airl_logit(f: Float[Tensor, "*batch"], log_pi: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """log D − log(1 − D) = f − log π."""
    return f - log_pi


def discriminator_loss(expert: Float[Tensor, "B R T"], generated: Float[Tensor, "B R T"]) -> Float[Tensor, ""]:
    """J per vehicle and step from the logits of D: −log D(τ^E) − log(1 − D(τ^G))."""
    return (softplus(-expert) + softplus(generated)).mean()


def edge_gradient(
    expert: Float[Tensor, "B E T K"],
    generated: Float[Tensor, "B E T K"],
    weight_expert: Float[Tensor, "B E T"],
    weight_generated: Float[Tensor, "B E T"],
    clip: float,
) -> Float[Tensor, "B E K"]:
    """∂J/∂z_ij,k = Σ_t [w^G·f^{e,k}(τ^G) − w^E·f^{e,k}(τ^E)], clipped; w = D(τ^G) and 1 − D(τ^E), or 1."""
    terms = weight_generated[..., None] * generated - weight_expert[..., None] * expert
    return terms.sum(2).clamp(-clip, clip)


def train_adversarial(
    model: RelationalModel,
    reward: ShapedReward,
    scenes: Scenes,
    settings: AdversarialSettings,
    seed: int,
    progress: Progress = silent,
) -> None:
    """Play the game; trains the model and the reward in place."""
    generator = torch.Generator().manual_seed(seed)
    model.decoder.log_sigma.requires_grad_(False)
    learned = [p for name, p in reward.named_parameters() if not name.endswith("log_alpha")]
    inner = settings.updates * settings.reward_updates
    to_encoder = Descent(model.encoder.parameters(), settings.encoder_rate, inner) if model.encoder else None
    to_reward = Descent(learned, settings.reward_rate, inner)
    policy = [p for p in model.decoder.parameters() if p.requires_grad]
    to_policy = Descent(policy, settings.policy_rate, settings.updates)
    prior = edge_prior(len(model.config.vocabulary), settings.bottleneck.no_edge_prior)
    beta = 0.0
    for update in range(settings.updates):
        for chosen in batches(len(scenes), settings.batch, settings.reward_updates, generator):
            batch = scenes[chosen]
            graph = model.infer(batch.seen)
            z = graph.sample(generator)
            judged = judge(model, reward, batch, z.detach(), generator)
            to_reward.step(discriminator_loss(judged.expert, judged.generated))
            if to_encoder is None:
                continue
            kl = categorical_kl(graph.logits, prior).mean()
            beta = updated_beta(beta, float(kl.detach()), settings.bottleneck)
            slope = encoder_slope(reward, batch, judged, settings)
            loss = (z * slope).sum((1, 2)).mean() + z.shape[1] * beta * kl
            to_encoder.step(loss + settings.logit_penalty * spread(graph.logits))
        batch = scenes[torch.randint(0, len(scenes), (settings.batch,), generator=generator)]
        value = policy_value(model, reward, batch, model.infer(batch.seen), settings, generator)
        to_policy.step(-value)
        progress("game", update + 1, settings.updates, float(value.detach()))


def spread(logits: Float[Tensor, "B E K"]) -> Float[Tensor, ""]:
    """Σ_ij Σ_{k>0} (l_ij,k − l_ij,0)², mean over scenes."""
    return (logits[..., 1:] - logits[..., :1]).square().sum((1, 2)).mean()


class Judged(msgspec.Struct, frozen=True):
    """One batch seen by the discriminator: logits of recorded and generated steps, and the generated roll-out."""

    expert: Tensor
    generated: Tensor
    rollout: Rollout


def judge(model: RelationalModel, reward: ShapedReward, batch: Scenes, z: Tensor, generator: torch.Generator) -> Judged:
    """Roll the policy out under z and form the logits of D; differentiable in the reward only."""
    with torch.no_grad():
        noise = torch.randn(batch.action.shape, generator=generator)
        driven = rollout(model, batch.start, z, batch.leader, noise)
        log_pi_expert = log_prob_of(model, batch.state, batch.action, z)
        log_pi_generated = log_density(noise, model.decoder.sigma)
    return Judged(
        airl_logit(shaped(reward, batch.state, batch.action, z), log_pi_expert),
        airl_logit(shaped(reward, driven.state, driven.action, z), log_pi_generated),
        driven,
    )


def shaped(reward: ShapedReward, state: Tensor, action: Tensor, z: Tensor) -> Float[Tensor, "B R T"]:
    """f_j of the driven vehicles."""
    idle = action.new_zeros(len(action), state.shape[1] - action.shape[1], *action.shape[2:])
    return reward(state, torch.cat([action, idle], 1), z)[:, : action.shape[1]]


@torch.no_grad()
def encoder_slope(
    reward: ShapedReward, batch: Scenes, judged: Judged, settings: AdversarialSettings
) -> Float[Tensor, "B E K"]:
    """The gradient of J that the encoder is given, for edges into driven vehicles; 0 for the others."""
    expert, generated = reward.edges(batch.state), reward.edges(judged.rollout.state)
    n, driven = agents_of(expert.shape[1]), judged.expert.shape[1]
    receivers = torch.tensor([j for _, j in pairs(n)])
    counted = (receivers < driven).float()[:, None]
    receivers = receivers.clamp(max=driven - 1)
    w_expert, w_generated = torch.ones_like(judged.expert), torch.ones_like(judged.generated)
    if settings.encoder == "literal":
        w_expert, w_generated = (-judged.expert).sigmoid(), judged.generated.sigmoid()
    slope = edge_gradient(expert, generated, w_expert[:, receivers], w_generated[:, receivers], settings.clip)
    return slope * counted


def policy_value(
    model: RelationalModel,
    reward: ShapedReward,
    batch: Scenes,
    graph: InteractionGraph,
    settings: AdversarialSettings,
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """Mean f of the policy's own roll-outs under graphs drawn from the encoder (cooperative, as in the paper), and
    the expert's share of J with its weight.
    """
    noise = torch.randn(batch.action.shape, generator=generator)
    z = graph.sample(generator).detach()
    driven = rollout(model, batch.start, z, batch.leader, noise)
    value = shaped(reward, driven.state, driven.action, z).mean()
    if settings.expert_term:
        f_expert = shaped(reward, batch.state, batch.action, z).detach()
        log_pi = log_prob_of(model, batch.state, batch.action, z)
        value = value + settings.expert_term * expert_value(f_expert, log_pi, settings.encoder).mean()
    return value


def expert_value(
    f: Float[Tensor, "*batch"], log_pi: Float[Tensor, "*batch"], form: Literal["contrast", "literal"]
) -> Float[Tensor, "*batch"]:
    """The expert's half of J for the policy: −log D(τ^E), with slope (1 − D(τ^E))·∇log π, or without that weight.

    The weight vanishes where recorded actions are unlikely, that is where the policy has most to learn from them.
    """
    return softplus(-airl_logit(f, log_pi)) if form == "literal" else log_pi
