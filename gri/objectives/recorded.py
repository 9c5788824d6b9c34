"""Grounded training on recorded traffic: the stages of `gri.objectives.gri`, with a reward that has networks in it.

The references h of the reward are fitted with its weights: the likelihood of the recorded actions, summed over all
graphs, is expanded anew at every update. Graph and policy are then learned as from any other reward.
"""

import msgspec
import torch

from gri.data.synthetic import Scenes
from gri.laplace import combination_prior, scene_prior
from gri.model import RelationalModel
from gri.objectives.common import Descent, batches
from gri.objectives.graphs import posterior_by_policy
from gri.objectives.gri import GroundedSettings, fit_encoder_and_policy, plan, scene_posterior
from gri.progress import Progress, silent
from gri.rewards import StructuredReward
from gri.riccati import expand_steps, log_likelihood_by_steps


class RecordedSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri_recorded"):
    """The stages' settings; those of the reward are here, `grounded.reward_*` are not used."""

    grounded: GroundedSettings
    reward_updates: int = 150
    reward_rate: float = 0.05
    """Of weights and α."""
    reference_rate: float = 3e-3
    reward_batch: int = 24
    log_alpha: float = -1.5
    """Logarithm of the drivers' rationality before training; people are less exact than 0 would have them."""


def train_recorded(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: RecordedSettings,
    seed: int,
    progress: Progress = silent,
) -> None:
    """Train the model and the reward in place."""
    generator, grounded = torch.Generator().manual_seed(seed), settings.grounded
    scenes = scenes[torch.randperm(len(scenes), generator=generator)]  # a file has its sites one after the other
    fit_references(model, reward, scenes, settings, generator, progress)
    judged = scenes[: grounded.graph_scenes]
    if grounded.judge == "policy":
        plan(model, reward, scenes, grounded, generator, progress)
        prior = scene_prior(reward, judged.state, grounded.no_edge_prior, grounded.ahead_only)
        posterior = posterior_by_policy(model, reward, judged, prior)
    else:
        posterior = scene_posterior(model, reward, judged, grounded, progress)
    fit_encoder_and_policy(model, reward, scenes, posterior, grounded, generator, progress)


def fit_references(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: RecordedSettings,
    generator: torch.Generator,
    progress: Progress = silent,
) -> None:
    """Maximise Σ_j log Σ_z p(z_j)·p(u_j | z_j) over weights, α and reference networks."""
    grounded, total = settings.grounded, settings.reward_updates
    assert reward.references is not None, "recorded traffic wants a reward with references"
    reward.log_alpha.data.fill_(settings.log_alpha)
    to_references = Descent(reward.references.parameters(), settings.reference_rate, total, clip=1.0)
    to_weights = Descent([*reward.psi.parameters(), reward.log_alpha], settings.reward_rate, total, clip=1.0)
    for update, chosen in enumerate(batches(len(scenes), settings.reward_batch, total, generator)):
        batch = scenes[chosen]
        likelihood = log_likelihood_by_steps(reward, expand_steps(model, reward, batch.state, batch.action, learn=True))
        prior = scene_prior(reward, batch.state, grounded.no_edge_prior, grounded.ahead_only)
        evidence = torch.logsumexp(likelihood + combination_prior(reward, prior, batch.action.shape[1]), -1).mean()
        gradients = to_references.gradients(-evidence, retain_graph=True)
        to_weights.step(-evidence)
        to_references.apply(gradients)
        progress("reward and references", update + 1, total, float(evidence.detach()))
