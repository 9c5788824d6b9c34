"""The first two stages of grounded training: fit the reward to recorded actions, then infer the graphs.

Both use Laplace's approximation of the MaxEnt likelihood, summed over all graphs (`gri.planning.laplace_likelihood`,
`gri.planning.riccati_likelihood`).
"""

import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.planning.edge_posterior import combination_prior, marginals, scene_prior
from gri.planning.laplace_likelihood import Expansion, expand, log_likelihood
from gri.planning.riccati_likelihood import StepExpansion, expand_steps, log_likelihood_by_steps
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.grounded.constants_search import ConstantsSearch, search_constants
from gri.training.grounded.settings import GroundedSettings
from gri.training.optimisation import Descent, draw_batch
from gri.training.training_state import TrainingState, no_state


def fit_reward(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    generator: torch.Generator,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Fit the reward's weights and the rationality α in place: maximise Σ_j log Σ_z p(z_j)·p(u_j | z_j).

    A reward that learns its constants gets them too (`constants_search`).
    """
    if reward.constants is not None and settings.reward_updates:
        search = settings.constants or ConstantsSearch()
        prior = settings.reward_prior, settings.no_edge_prior
        return search_constants(model, reward, scenes, search, *prior, generator, progress, state)
    chosen = torch.randperm(len(scenes), generator=generator)[: settings.reward_scenes]
    expansion = _expand(model, reward, scenes[chosen], settings)
    prior = combination_prior(reward, graph_prior(reward, scenes[chosen], settings), scenes.action.shape[1])
    descent = Descent(reward.parameters(), settings.reward_rate, settings.reward_updates)
    total = settings.reward_updates
    for update in (state or no_state()).updates("reward", total, generator, descent):
        batch = draw_batch(len(chosen), settings.reward_batch, generator)
        evidence = torch.logsumexp(_log_likelihood(reward, expansion[batch]) + prior[batch], -1).mean()
        squares = torch.cat([psi.square() for psi in reward.psi.values()]).sum()
        descent.step(settings.reward_prior * squares - evidence)
        progress("reward", update + 1, total, float(evidence.detach()))


@torch.no_grad()
def scene_posterior(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    progress: Progress = no_progress,
) -> Float[Tensor, "S E K"]:
    """p(z_ij | u) of every scene under the present reward."""
    parts = []
    chunk = _CHUNK[settings.likelihood]
    for start in range(0, len(scenes), chunk):
        part = scenes[start : start + chunk]
        likelihood = _log_likelihood(reward, _expand(model, reward, part, settings))
        parts.append(marginals(reward, likelihood, graph_prior(reward, part, settings)))
        progress("graph", min(start + chunk, len(scenes)), len(scenes), 0.0)
    return torch.cat(parts)


_CHUNK = {"dense": 64, "stepwise": 256}  # scenes whose Hessians are in memory at once


@torch.no_grad()
def _expand(
    model: RelationalModel, reward: StructuredReward, scenes: Scenes, settings: GroundedSettings
) -> Expansion | StepExpansion:
    chunk = _CHUNK[settings.likelihood]
    parts = [scenes[start : start + chunk] for start in range(0, len(scenes), chunk)]
    if settings.likelihood == "stepwise":
        return StepExpansion.concatenate([expand_steps(model, reward, p.state, p.action) for p in parts])
    horizon, stride = settings.horizon, settings.stride
    return Expansion.concatenate([expand(model, reward, p.state, p.action, horizon, stride) for p in parts])


def _log_likelihood(reward: StructuredReward, expansion: Expansion | StepExpansion) -> Float[Tensor, "B R C"]:
    match expansion:
        case Expansion():
            return log_likelihood(reward, expansion)
        case StepExpansion():
            return log_likelihood_by_steps(reward, expansion)


def graph_prior(reward: StructuredReward, scenes: Scenes, settings: GroundedSettings) -> Float[Tensor, "B E K"]:
    """p(z_ij) of every scene."""
    return scene_prior(reward, scenes.state, settings.no_edge_prior, settings.ahead_only)
