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

from gri.core.graph import InteractionGraph, agents_of, pairs
from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.networks.rollout import log_prob_of, rollout
from gri.planning.laplace_likelihood import edge_prior
from gri.progress import Progress, no_progress
from gri.rewards.structured import AnyRewardConfig, NaturalisticConfig, ShapedReward, StructuredReward
from gri.training.adversarial.discriminator import DiscriminatorOutput, airl_logit, discriminator_loss, judge, shaped
from gri.training.grounded.planned_start import PlanSettings, plan_by_optima
from gri.training.optimisation import Bottleneck, Descent, batches, categorical_kl, updated_beta


class PlannedStart(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Who moves before the game: the policy comes near its optimum under the initial reward, then the encoder alone.

    The encoder's slope compares what the policy does under a graph with what was recorded, and says little of the graph
    while the policy is poor under every one.
    """

    plan: PlanSettings = PlanSettings()
    encoder_updates: int = 220
    encoder_rate: float = 2e-3


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
    expert_graph: Literal["drawn", "likely"] = "drawn"
    """Whether recorded actions are imitated under graphs drawn from the encoder or under its most probable ones: drawn
    while it is unsure, they teach the policy to do the same under every graph, which takes the encoder's slope away.
    """
    policy_clip: float = 10.0
    """Bound of the norm of the policy's gradient; returns under contradictory graphs are huge."""
    weights: dict[str, dict[str, float]] | None = None
    """With which weights 1 + e^ψ the named terms begin, group by group ("node", "follow", ...); None: 2 each."""
    start: PlannedStart | None = None
    """Moves before the game; None: all players begin at once. For named rewards and inferred relations only."""
    bottleneck: Bottleneck = Bottleneck()
    rewards: Literal["semantic", "networks"] = "semantic"
    """`networks` replaces the named terms by free functions: the ablation GRI-VAIRL (Appendix C)."""
    relations: Literal["inferred", "all_alike"] = "inferred"
    """`all_alike`: no encoder, every pair has the same relation; with `networks` the ablation GRI-AIRL."""


RATIONALITY = 0.04
"""By what rewards of recorded traffic are multiplied in the game, which learns no α: the α that GRI finds by likelihood
(car following). With 1, f is −300 per step where log π is −4, as nobody drives at the free speed.
"""


def in_the_game(config: AnyRewardConfig) -> AnyRewardConfig:
    """The reward's configuration as the game has it."""
    if isinstance(config, NaturalisticConfig):
        return msgspec.structs.replace(config, temperature=RATIONALITY)
    return config


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
    progress: Progress = no_progress,
) -> None:
    """Play the game; trains the model and the reward in place."""
    generator = torch.Generator().manual_seed(seed)
    model.decoder.log_sigma.requires_grad_(False)
    learned = [p for name, p in reward.named_parameters() if not name.endswith("log_alpha")]
    inner = settings.updates * settings.reward_updates
    if settings.start is not None:
        begin(model, reward, scenes, settings, settings.start, generator, progress)
    encoder = EncoderPlayer(model, settings, settings.encoder_rate, inner) if model.encoder else None
    to_reward = Descent(learned, settings.reward_rate, inner)
    to_policy = Descent(model.decoder.parameters(), settings.policy_rate, settings.updates, settings.policy_clip)
    for update in range(settings.updates):
        for chosen in batches(len(scenes), settings.batch, settings.reward_updates, generator):
            batch = scenes[chosen]
            graph = model.infer(batch.seen)
            z = graph.sample(generator)
            judged = judge(model, reward, batch, z.detach(), generator)
            to_reward.step(discriminator_loss(judged.expert, judged.generated))
            if encoder is not None:
                encoder.move(reward, batch, graph, z, judged)
        batch = scenes[torch.randint(0, len(scenes), (settings.batch,), generator=generator)]
        value = policy_value(model, reward, batch, model.infer(batch.seen), settings, generator)
        to_policy.step(-value)
        progress("game", update + 1, settings.updates, float(value.detach()))


def begin(
    model: RelationalModel,
    reward: ShapedReward,
    scenes: Scenes,
    settings: AdversarialSettings,
    start: PlannedStart,
    generator: torch.Generator,
    progress: Progress = no_progress,
) -> None:
    """The moves before the game; the reward stays as it is."""
    assert isinstance(reward.reward, StructuredReward), "only a reward of known terms can be planned on"
    plan_by_optima(model, reward.reward, scenes, start.plan, generator, progress)
    encoder = EncoderPlayer(model, settings, start.encoder_rate, start.encoder_updates)
    total = start.encoder_updates
    for update, chosen in enumerate(batches(len(scenes), settings.batch, total, generator)):
        batch = scenes[chosen]
        graph = model.infer(batch.seen)
        z = graph.sample(generator)
        loss = encoder.move(reward, batch, graph, z, judge(model, reward, batch, z.detach(), generator))
        progress("encoder", update + 1, total, loss)


class EncoderPlayer:
    """The encoder's moves, with the multiplier β of its bottleneck."""

    def __init__(self, model: RelationalModel, settings: AdversarialSettings, rate: float, updates: int) -> None:
        assert model.encoder is not None, "all relations are given; there is nothing to infer"
        self.settings, self.beta = settings, 0.0
        self.prior = edge_prior(len(model.config.vocabulary), settings.bottleneck.no_edge_prior)
        self.descent = Descent(model.encoder.parameters(), rate, updates)

    def move(
        self,
        reward: ShapedReward,
        batch: Scenes,
        graph: InteractionGraph,
        z: Float[Tensor, "B E K"],
        judged: DiscriminatorOutput,
    ) -> float:
        """One update from one batch and the graphs z drawn for it; returns the loss."""
        kl = categorical_kl(graph.logits, self.prior).mean()
        self.beta = updated_beta(self.beta, float(kl.detach()), self.settings.bottleneck)
        slope = encoder_slope(reward, batch, judged, self.settings)
        loss = (z * slope).sum((1, 2)).mean() + z.shape[1] * self.beta * kl
        loss = loss + self.settings.logit_penalty * spread(graph.logits)
        self.descent.step(loss)
        return float(loss.detach())


def spread(logits: Float[Tensor, "B E K"]) -> Float[Tensor, ""]:
    """Σ_ij Σ_{k>0} (l_ij,k − l_ij,0)², mean over scenes."""
    return (logits[..., 1:] - logits[..., :1]).square().sum((1, 2)).mean()


@torch.no_grad()
def encoder_slope(
    reward: ShapedReward, batch: Scenes, judged: DiscriminatorOutput, settings: AdversarialSettings
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
        shown = z if settings.expert_graph == "drawn" else graph.one_hot.detach()
        f_expert = shaped(reward, batch.state, batch.action, shown).detach()
        log_pi = log_prob_of(model, batch.state, batch.action, shown)
        value = value + settings.expert_term * expert_value(f_expert, log_pi, settings.encoder).mean()
    return value


def expert_value(
    f: Float[Tensor, "*batch"], log_pi: Float[Tensor, "*batch"], form: Literal["contrast", "literal"]
) -> Float[Tensor, "*batch"]:
    """The expert's half of J for the policy: −log D(τ^E), with slope (1 − D(τ^E))·∇log π, or without that weight.

    The weight vanishes where recorded actions are unlikely, that is where the policy has most to learn from them.
    """
    return softplus(-airl_logit(f, log_pi)) if form == "literal" else log_pi
