"""The paper's adversarial objective: a min-max problem for encoder, reward and policy (Sec. V-B, Eq. opt-2).

    max_η min_{ξ,ω,ψ,χ,φ} J = E_z~q [ −Σ_t log D(τ^E, z) − E_{τ^G~π(·|z)} Σ_t log(1 − D(τ^G, z)) ],
    D = e^f / (e^f + π),  subject to E KL[q(z|τ^E) || p(z)] ≤ I_c

The paper leaves three points open. They are decided as follows:

- Each driven vehicle has its own D, with the logit f_j − log π_j.
- As in AIRL, the policy maximises f − log π, the logit of D, and not −log(1 − D), which saturates. Its standard
  deviation is fixed. So log π of its own samples has no gradient, and the policy maximises E[f].
- The encoder gets its gradient only through f, with fixed policy and roll-outs. f is linear in the one-hot z, so the
  gradient is one number per edge and type, which is clipped. `contrast` omits the weights 1 − D(τ^E) and D(τ^G), which
  vanish exactly where the graph is wrong. `literal` keeps them.
"""

from typing import Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from gri.core.graph import InteractionGraph, pairs, vehicle_count
from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.networks.rollout import log_prob_of, rollout
from gri.planning.edge_posterior import edge_prior
from gri.progress import Progress, no_progress
from gri.rewards.structured import AnyRewardConfig, NaturalisticConfig, ShapedReward, StructuredReward
from gri.training.adversarial.discriminator import (
    DiscriminatorOutput,
    airl_logit,
    discriminate,
    discriminator_loss,
    shaped_reward,
)
from gri.training.grounded.planned_start import PlanSettings, plan_by_imitation
from gri.training.optimisation import Bottleneck, Descent, batches, categorical_kl, draw_batch, updated_beta
from gri.training.training_state import TrainingState, no_state


class PlannedStart(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Pretraining: first the policy is planned on the initial reward, then the encoder is trained alone.

    The encoder's gradient compares the policy's roll-outs under a graph with the recorded scenes. It has little
    information on the graph while the policy is poor under every graph.
    """

    plan: PlanSettings = PlanSettings()
    encoder_updates: int = 220
    """Updates of the encoder alone."""
    encoder_rate: float = 2e-3
    on_semantic_reward: bool | msgspec.UnsetType = msgspec.UNSET
    """Plan on the semantic reward where the game learns networks for rewards. Its ablations then begin with the same
    policy as the game with semantic rewards; without an encoder, only the policy is pretrained.
    """


class AdversarialSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="airl"):
    """Settings of the adversarial objective and its ablations."""

    updates: int = 600
    batch: int = 64
    encoder: Literal["contrast", "literal"] = "contrast"
    """`contrast` omits the weights 1 − D(τ^E) and D(τ^G) from J's gradients, for the encoder and in `expert_term`."""
    reward_updates: int = 1
    """Updates of encoder and reward per update of the policy. The literal form needs about 4."""
    policy_rate: float = 2e-3
    reward_rate: float = 2e-3
    encoder_rate: float = 2e-3
    clip: float = 5.0
    """Bound of the encoder's gradient per edge [nats]. Without it the logits saturate within a hundred updates."""
    logit_penalty: float = 0.05
    """Weight of the squared differences of the encoder's logits.

    A certain graph always gives the same sample, so no gradient can correct it. The penalty keeps a small probability
    for every type.
    """
    expert_term: float = 1.0
    """Weight of the expert's half of J in the policy's objective: 1 as printed, 0 as in AIRL. It needs no labels."""
    expert_graph: Literal["drawn", "likely"] = "drawn"
    """Graphs under which recorded actions are imitated: sampled from the encoder, or its most probable ones.

    Graphs sampled from an uncertain encoder teach the policy to act alike under all graphs. Then the encoder's gradient
    vanishes.
    """
    policy_clip: float = 10.0
    """Bound of the norm of the policy's gradient. Returns under contradictory graphs are very large."""
    weights: dict[str, dict[str, float]] | None = None
    """Initial weights 1 + e^ψ of the named terms, by group ("node", "follow", ...) and term; None: 2 each."""
    start: PlannedStart | None = None
    """Pretraining; None: none. Without semantic rewards and inferred relations only with its `on_semantic_reward`."""
    bottleneck: Bottleneck = Bottleneck()
    rewards: Literal["semantic", "networks"] = "semantic"
    """`networks` replaces the named terms by neural networks: the ablation GRI-VAIRL (Appendix C)."""
    relations: Literal["inferred", "all_alike"] = "inferred"
    """`all_alike`: no encoder, all edges have the same type. With `networks`: the ablation GRI-AIRL (Appendix C)."""


FIXED_RATIONALITY = 0.04
"""Factor on rewards of recorded traffic, because the adversarial objective does not learn α.

It is the α that grounded training finds for car following. With 1, f would be −300 per step while log π is −4, as
vehicles do not drive at the free speed.
"""


def with_fixed_rationality(config: AnyRewardConfig) -> AnyRewardConfig:
    """The reward's configuration for the adversarial objective (`FIXED_RATIONALITY`)."""
    if isinstance(config, NaturalisticConfig):
        return msgspec.structs.replace(config, temperature=FIXED_RATIONALITY)
    return config


def edge_gradient(
    expert: Float[Tensor, "B E T K"],
    generated: Float[Tensor, "B E T K"],
    weight_expert: Float[Tensor, "B E T"],
    weight_generated: Float[Tensor, "B E T"],
    clip: float,
) -> Float[Tensor, "B E K"]:
    """∂J/∂z_ij,k = Σ_t [w^G·f^{e,k}(τ^G) − w^E·f^{e,k}(τ^E)], clipped to ±`clip` [nats].

    `expert` and `generated` are f^{e,k} of recorded and generated steps. The weights are w^G = D(τ^G) and
    w^E = 1 − D(τ^E), or 1.
    """
    terms = weight_generated[..., None] * generated - weight_expert[..., None] * expert
    return terms.sum(2).clamp(-clip, clip)


def train_adversarial(
    model: RelationalModel,
    reward: ShapedReward,
    scenes: Scenes,
    settings: AdversarialSettings,
    seed: int,
    progress: Progress = no_progress,
    planning: StructuredReward | None = None,
    state: TrainingState | None = None,
) -> None:
    """Train the model and the reward in place. Encoder and reward are updated in turn with the policy.

    The policy of a planned start is planned on the reward `planning`; None: on the initial reward of the game.
    """
    generator = torch.Generator().manual_seed(seed)
    model.decoder.log_sigma.requires_grad_(False)
    learned = [p for name, p in reward.named_parameters() if not name.endswith("log_alpha")]
    inner = settings.updates * settings.reward_updates
    if settings.start is not None:
        pretrain(model, reward, scenes, settings, settings.start, generator, progress, planning, state)
    encoder = EncoderUpdates(model, settings, settings.encoder_rate, inner) if model.encoder else None
    reward_descent = Descent(learned, settings.reward_rate, inner)
    policy_descent = Descent(model.decoder.parameters(), settings.policy_rate, settings.updates, settings.policy_clip)
    descents = [reward_descent, policy_descent, *([encoder.descent] if encoder else [])]
    memory = encoder.memory if encoder else {}
    stage = "encoder, reward and policy"
    for update in (state or no_state()).updates(stage, settings.updates, generator, *descents, memory=memory):
        for chosen in batches(len(scenes), settings.batch, settings.reward_updates, generator):
            batch = scenes[chosen]
            graph = model.infer(batch.observed)
            z = graph.sample(generator)
            discriminated = discriminate(model, reward, batch, z.detach(), generator)
            reward_descent.step(discriminator_loss(discriminated.expert, discriminated.generated))
            if encoder is not None:
                encoder.update(reward, batch, graph, z, discriminated)
        batch = scenes[torch.randint(0, len(scenes), (settings.batch,), generator=generator)]
        value = policy_objective(model, reward, batch, model.infer(batch.observed), settings, generator)
        policy_descent.step(-value)
        progress(stage, update + 1, settings.updates, float(value.detach()))


def pretrain(
    model: RelationalModel,
    reward: ShapedReward,
    scenes: Scenes,
    settings: AdversarialSettings,
    start: PlannedStart,
    generator: torch.Generator,
    progress: Progress = no_progress,
    planning: StructuredReward | None = None,
    state: TrainingState | None = None,
) -> None:
    """Pretrain policy and encoder in place. The rewards stay unchanged."""
    planning = reward.reward if planning is None and isinstance(reward.reward, StructuredReward) else planning
    assert planning is not None, "got a reward of networks; planning needs a semantic one"
    plan_by_imitation(model, planning, scenes, start.plan, generator, progress, state)
    if model.encoder is None:
        return
    encoder = EncoderUpdates(model, settings, start.encoder_rate, start.encoder_updates)
    total = start.encoder_updates
    updates = (state or no_state()).updates("encoder", total, generator, encoder.descent, memory=encoder.memory)
    for update in updates:
        batch = scenes[draw_batch(len(scenes), settings.batch, generator)]
        graph = model.infer(batch.observed)
        z = graph.sample(generator)
        loss = encoder.update(reward, batch, graph, z, discriminate(model, reward, batch, z.detach(), generator))
        progress("encoder", update + 1, total, loss)


class EncoderUpdates:
    """The encoder's optimiser and the multiplier β of its bottleneck, for `updates` updates."""

    def __init__(self, model: RelationalModel, settings: AdversarialSettings, rate: float, updates: int) -> None:
        assert model.encoder is not None, "got a model without an encoder; its relations are given"
        self.settings, self.memory = settings, {"beta": 0.0}
        self.prior = edge_prior(len(model.config.vocabulary), settings.bottleneck.no_edge_prior)
        self.descent = Descent(model.encoder.parameters(), rate, updates)

    def update(
        self,
        reward: ShapedReward,
        batch: Scenes,
        graph: InteractionGraph,
        z: Float[Tensor, "B E K"],
        discriminated: DiscriminatorOutput,
    ) -> float:
        """One update from a batch, its inferred graphs, and the samples z of these. Returns the loss."""
        kl = categorical_kl(graph.logits, self.prior).mean()
        beta = self.memory["beta"] = updated_beta(self.memory["beta"], float(kl.detach()), self.settings.bottleneck)
        gradient = encoder_gradient(reward, batch, discriminated, self.settings)
        loss = (z * gradient).sum((1, 2)).mean() + z.shape[1] * beta * kl
        loss = loss + self.settings.logit_penalty * squared_logit_differences(graph.logits)
        self.descent.step(loss)
        return float(loss.detach())


def squared_logit_differences(logits: Float[Tensor, "B E K"]) -> Float[Tensor, ""]:
    """Σ_ij Σ_{k>0} (l_ij,k − l_ij,0)², mean over scenes."""
    return (logits[..., 1:] - logits[..., :1]).square().sum((1, 2)).mean()


@torch.no_grad()
def encoder_gradient(
    reward: ShapedReward, batch: Scenes, discriminated: DiscriminatorOutput, settings: AdversarialSettings
) -> Float[Tensor, "B E K"]:
    """∂J/∂z for the edges into driven vehicles; 0 for the others."""
    expert, generated = reward.edges(batch.state), reward.edges(discriminated.rollout.state)
    n, driven = vehicle_count(expert.shape[1]), discriminated.expert.shape[1]
    receivers = torch.tensor([j for _, j in pairs(n)])
    counted = (receivers < driven).float()[:, None]
    receivers = receivers.clamp(max=driven - 1)
    w_expert, w_generated = torch.ones_like(discriminated.expert), torch.ones_like(discriminated.generated)
    if settings.encoder == "literal":
        w_expert, w_generated = (-discriminated.expert).sigmoid(), discriminated.generated.sigmoid()
    gradient = edge_gradient(expert, generated, w_expert[:, receivers], w_generated[:, receivers], settings.clip)
    return gradient * counted


def policy_objective(
    model: RelationalModel,
    reward: ShapedReward,
    batch: Scenes,
    graph: InteractionGraph,
    settings: AdversarialSettings,
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """The policy's objective: mean f of its roll-outs, plus the weighted expert's half of J.

    Graphs are sampled from the encoder. The policy is cooperative, as in the paper: it maximises the sum over vehicles.
    """
    noise = torch.randn(batch.action.shape, generator=generator)
    z = graph.sample(generator).detach()
    driven = rollout(model, batch.start, z, batch.leader, noise)
    value = shaped_reward(reward, driven.state, driven.action, z).mean()
    if settings.expert_term:
        imitation_graph = z if settings.expert_graph == "drawn" else graph.one_hot.detach()
        f_expert = shaped_reward(reward, batch.state, batch.action, imitation_graph).detach()
        log_pi = log_prob_of(model, batch.state, batch.action, imitation_graph)
        value = value + settings.expert_term * expert_objective(f_expert, log_pi, settings.encoder).mean()
    return value


def expert_objective(
    f: Float[Tensor, "*batch"], log_pi: Float[Tensor, "*batch"], form: Literal["contrast", "literal"]
) -> Float[Tensor, "*batch"]:
    """The expert's half of J for the policy.

    `literal`: −log D(τ^E), with the gradient (1 − D(τ^E))·∇log π. `contrast`: log π, without that weight. The weight
    vanishes where recorded actions are unlikely, which is where the policy has most to learn.
    """
    return softplus(-airl_logit(f, log_pi)) if form == "literal" else log_pi
