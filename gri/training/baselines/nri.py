"""The NRI baseline: GRI's encoder and decoder, trained only to reproduce the scenes (Sec. III-A, VI-A).

    min  E_z~q Σ_t ‖x̂_t(z) − x_t‖² + β·KL[q(z|τ) || p(z)]

As in GRI, the decoder's output are actions, the dynamics propagate them, and the same bottleneck limits the graph.
Graphs are sampled by the straight-through Gumbel-softmax. Without rewards, the edge types have no fixed meaning; the
decoder determines it.
"""

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.networks.rollout import rollout
from gri.planning.edge_posterior import edge_prior
from gri.progress import Progress, no_progress
from gri.training.optimisation import (
    Bottleneck,
    Descent,
    action_error,
    categorical_kl,
    draw_batch,
    reconstruction_loss,
    updated_beta,
)
from gri.training.training_state import TrainingState, no_state


class NriSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="nri"):
    """Sizes, learning rates and the bottleneck."""

    updates: int = 1500
    batch: int = 64
    policy_rate: float = 3e-3
    encoder_rate: float = 1e-3
    temperature: float = 0.5
    action_weight: float = 0.0
    """Weight of the squared error of actions, in units of the scale, relative to that of states [m²]."""
    bottleneck: Bottleneck = Bottleneck(rate=0.05)
    """The rate is smaller than in the adversarial objective, whose loss is in nats per scene, not in m² per step."""
    structured_prior: bool | msgspec.UnsetType = msgspec.UNSET
    """Of recorded traffic: in the bottleneck, use the prior of grounded training, which allows few edges.

    Its odds are those of `bottleneck.no_edge_prior`. The row is then called "+ prior".
    """


def train_nri(
    model: RelationalModel,
    scenes: Scenes,
    settings: NriSettings,
    seed: int,
    progress: Progress = no_progress,
    scene_priors: Float[Tensor, "S E K"] | None = None,
    state: TrainingState | None = None,
) -> None:
    """Train the model in place. It must have an encoder. `scene_priors` take the place of the sparse prior."""
    assert model.encoder is not None, "got a model without an encoder; NRI infers graphs and needs one"
    generator = torch.Generator().manual_seed(seed)
    model.decoder.log_sigma.requires_grad_(False)
    encoder_descent = Descent(model.encoder.parameters(), settings.encoder_rate, settings.updates)
    policy = [p for p in model.decoder.parameters() if p.requires_grad]
    policy_descent = Descent(policy, settings.policy_rate, settings.updates)
    prior = edge_prior(len(model.config.vocabulary), settings.bottleneck.no_edge_prior)
    memory, descents = {"beta": 0.0}, (encoder_descent, policy_descent)
    updates = (state or no_state()).updates("encoder and policy", settings.updates, generator, *descents, memory=memory)
    for update in updates:
        chosen = draw_batch(len(scenes), settings.batch, generator)
        batch = scenes[chosen]
        graph = model.infer(batch.observed)
        driven = rollout(model, batch.start, graph.sample(generator, settings.temperature), batch.leader)
        error = reconstruction_loss(driven.state, batch.state, model.dynamics)
        if settings.action_weight:
            error = error + settings.action_weight * action_error(
                driven.action, batch.action, model.decoder.action_unit
            )
        kl = categorical_kl(graph.logits, prior if scene_priors is None else scene_priors[chosen]).mean()
        memory["beta"] = updated_beta(memory["beta"], float(kl.detach()), settings.bottleneck)
        loss = error + memory["beta"] * kl
        gradients = encoder_descent.gradients(loss, retain_graph=True)
        policy_descent.step(loss)
        encoder_descent.apply(gradients)
        progress("encoder and policy", update + 1, settings.updates, float(error.detach()))
