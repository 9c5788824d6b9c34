"""The NRI baseline: the same encoder and decoder, trained to reproduce the scenes and nothing else (Sec. III-A, VI-A).

    min  E_z~q Σ_t ‖x̂_t(z) − x_t‖² + β·KL[q(z|τ) || p(z)]

The decoder gives actions, as GRI's does, and the dynamics propagate them. Graphs are drawn by the straight-
through Gumbel-softmax, and the bottleneck is GRI's. Without rewards the types have no meaning but the one
that the decoder happens to give them.
"""

import msgspec
import torch

from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.networks.rollout import rollout
from gri.planning.laplace_likelihood import edge_prior
from gri.progress import Progress, no_progress
from gri.training.optimisation import (
    Bottleneck,
    Descent,
    action_error,
    batches,
    categorical_kl,
    reconstruction_loss,
    updated_beta,
)


class NriSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="nri"):
    """Sizes, rates and the bottleneck."""

    updates: int = 1500
    batch: int = 64
    policy_rate: float = 3e-3
    encoder_rate: float = 1e-3
    temperature: float = 0.5
    action_weight: float = 0.0
    """Weight of the squared error of actions, in units of the scale, beside that of states [m²]."""
    bottleneck: Bottleneck = Bottleneck(rate=0.05)
    """β is smaller than in the game: the loss is in m² per step here, in nats per scene there."""


def train_nri(
    model: RelationalModel, scenes: Scenes, settings: NriSettings, seed: int, progress: Progress = no_progress
) -> None:
    """Train the model in place."""
    assert model.encoder is not None, "NRI infers graphs; give the model an encoder"
    generator = torch.Generator().manual_seed(seed)
    model.decoder.log_sigma.requires_grad_(False)
    to_encoder = Descent(model.encoder.parameters(), settings.encoder_rate, settings.updates)
    policy = [p for p in model.decoder.parameters() if p.requires_grad]
    to_policy = Descent(policy, settings.policy_rate, settings.updates)
    prior = edge_prior(len(model.config.vocabulary), settings.bottleneck.no_edge_prior)
    beta = 0.0
    for update, chosen in enumerate(batches(len(scenes), settings.batch, settings.updates, generator)):
        batch = scenes[chosen]
        graph = model.infer(batch.seen)
        driven = rollout(model, batch.start, graph.sample(generator, settings.temperature), batch.leader)
        error = reconstruction_loss(driven.state, batch.state, model.dynamics)
        if settings.action_weight:
            error = error + settings.action_weight * action_error(
                driven.action, batch.action, model.decoder.action_unit
            )
        kl = categorical_kl(graph.logits, prior).mean()
        beta = updated_beta(beta, float(kl.detach()), settings.bottleneck)
        loss = error + beta * kl
        gradients = to_encoder.gradients(loss, retain_graph=True)
        to_policy.step(loss)
        to_encoder.apply(gradients)
        progress("encoder and policy", update + 1, settings.updates, float(error.detach()))
