"""Grounded training without an adversary: reward, then graph, then policy.

1. Reward: the weights of the structured reward and the drivers' rationality maximise the likelihood of the recorded
   actions, summed over all graphs under the sparse prior (`gri.laplace`). No label is used.
2. Graph: the likelihood of the actions, under the reward or under a policy planned on it, gives every scene a
   posterior over its edges, which the encoder learns by cross-entropy. The encoder never sees how well the policy
   reproduces a scene, so that the policy cannot redefine what an edge means.
3. Policy: it reproduces the recorded scenes under graphs drawn from the encoder, and maximises the learned reward
   under random graphs and from shifted starts, so that an edge keeps its meaning away from the data.
"""

from typing import Literal

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor

from gri.data.synthetic import Scenes, returns
from gri.graph import InteractionGraph
from gri.laplace import Expansion, combination_prior, expand, log_likelihood, marginals, scene_prior
from gri.model import RelationalModel
from gri.objectives.common import Descent, action_error, batches, reconstruction_loss
from gri.objectives.graphs import posterior_by_policy
from gri.objectives.optima import OptimaSettings, distance, optimal_scenes
from gri.objectives.variation import Augmentation, Shifts, augment, elsewhere
from gri.progress import Progress, silent
from gri.rewards import StructuredReward
from gri.riccati import StepExpansion, expand_steps, log_likelihood_by_steps
from gri.rollout import rollout


class GroundedSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag="gri"):
    """Sizes and rates of the three stages."""

    no_edge_prior: float = 0.9
    ahead_only: bool = False
    """Nobody follows a vehicle that ends up behind it; else only the reward says so."""
    likelihood: Literal["dense", "stepwise"] = "dense"
    """Laplace's approximation by one matrix over a window's actions, or over whole scenes in linear time."""
    graph_scenes: int | None = None
    """The posterior over graphs is computed for so many scenes, and the encoder learns from these; None: all."""
    horizon: int = 19
    """Actions that a driver is taken to foresee when the likelihood of graphs is computed."""
    stride: int = 10
    judge: Literal["reward", "policy"] = "reward"
    """Whose likelihood tells graphs apart: the reward's own, or that of a policy first planned on it."""
    planner_updates: int = 400
    planner_batch: int = 128
    reward_updates: int = 100
    reward_rate: float = 0.05
    reward_batch: int = 16
    reward_scenes: int = 256
    reward_prior: float = 0.0
    """Weight of Σψ² against the mean log-likelihood per vehicle [nats]: a term of which the scenes say little, as of
    collisions where nobody comes near, keeps about the weight of one unit.
    """
    updates: int = 1000
    batch: int = 64
    policy_rate: float = 3e-3
    encoder_rate: float = 1e-3
    encoder_lead: int = 0
    """Updates of the encoder before the policy's first: graphs that are still wrong undo what a plan has taught it."""
    encoder_updates: int | None = None
    """Updates of the encoder beside the policy's, from its first on; None: as many. More repeat the posterior's errors.
    """
    reconstruction: Literal["drawn", "likely", "judged"] = "drawn"
    """Under which graphs recorded scenes are reproduced: drawn from the encoder, its most probable ones, or those of
    the posterior, which knows what is to be reproduced; the policy then learns from the scenes that have one.
    """
    return_batch: int = 32
    return_weight: float = 0.02
    return_fade: float = 1.0
    """Share of the return's weight that is left at the end of its decline: reconstruction has the last word."""
    action_weight: float = 0.0
    """Weight of the squared error of actions, in units of the scale, beside that of states [m²]."""
    optima: OptimaSettings | None = None
    """Imitate optima of the return away from the data instead of climbing to them beside the reconstruction.

    The policy is planned first; the return's batch, weight and fade become those of the distance to the optima.
    """
    optima_scale: float = 0.5
    """Distance [m] from which on being far from an optimum counts linearly only."""
    return_headway: float | None = None
    """Least starting headway [m] over which a vehicle may react where the return is maximised away from the data.

    None: any. A test of shorter headways is then one of headways never trained.
    """
    augmentation: Augmentation = Augmentation()
    shifts: Shifts = Shifts()


def train_grounded(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    seed: int,
    progress: Progress = silent,
) -> None:
    """Train the model and the reward in place."""
    generator = torch.Generator().manual_seed(seed)
    fit_reward(model, reward, scenes, settings, generator, progress)
    judged = scenes[: settings.graph_scenes]
    if settings.judge == "policy" or settings.optima is not None:
        plan(model, reward, scenes, settings, generator, progress)
    if settings.judge == "policy":
        posterior = posterior_by_policy(model, reward, judged, _prior(reward, judged, settings))
    else:
        posterior = scene_posterior(model, reward, judged, settings, progress)
    fit_encoder_and_policy(model, reward, scenes, posterior, settings, generator, progress)


def fit_reward(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    generator: torch.Generator,
    progress: Progress = silent,
) -> None:
    """Maximise Σ_j log Σ_z p(z_j)·p(u_j | z_j) over the reward's weights and α."""
    chosen = torch.randperm(len(scenes), generator=generator)[: settings.reward_scenes]
    expansion = _expand(model, reward, scenes[chosen], settings)
    prior = combination_prior(reward, _prior(reward, scenes[chosen], settings), scenes.action.shape[1])
    descent = Descent(reward.parameters(), settings.reward_rate, settings.reward_updates)
    total = settings.reward_updates
    for update, batch in enumerate(batches(len(chosen), settings.reward_batch, total, generator)):
        evidence = torch.logsumexp(_log_likelihood(reward, expansion[batch]) + prior[batch], -1).mean()
        spread = torch.cat([psi.square() for psi in reward.psi.values()]).sum()
        descent.step(settings.reward_prior * spread - evidence)
        progress("reward", update + 1, total, float(evidence.detach()))


@torch.no_grad()
def scene_posterior(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    progress: Progress = silent,
) -> Float[Tensor, "S E K"]:
    """p(z_ij | u) of every scene under the reward as it stands."""
    parts = []
    chunk = _CHUNK[settings.likelihood]
    for start in range(0, len(scenes), chunk):
        part = scenes[start : start + chunk]
        likelihood = _log_likelihood(reward, _expand(model, reward, part, settings))
        parts.append(marginals(reward, likelihood, _prior(reward, part, settings)))
        progress("graph", min(start + chunk, len(scenes)), len(scenes), 0.0)
    return torch.cat(parts)


_CHUNK = {"dense": 64, "stepwise": 256}  # scenes whose Hessians are held at once


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


def _prior(reward: StructuredReward, scenes: Scenes, settings: GroundedSettings) -> Float[Tensor, "B E K"]:
    return scene_prior(reward, scenes.state, settings.no_edge_prior, settings.ahead_only)


def plan(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    generator: torch.Generator,
    progress: Progress = silent,
) -> None:
    """Let the policy maximise the learned reward under random graphs before it has seen how anyone drives."""
    descent = Descent(model.decoder.parameters(), settings.policy_rate, settings.planner_updates, clip=1.0)
    for update in range(settings.planner_updates):
        value = grounded_return(model, reward, scenes, settings, settings.planner_batch, generator)
        descent.step(-value)
        progress("plan", update + 1, settings.planner_updates, float(value.detach()))


def fit_encoder_and_policy(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    posterior: Float[Tensor, "S E K"],
    settings: GroundedSettings,
    generator: torch.Generator,
    progress: Progress = silent,
) -> None:
    """One update of each per batch; neither sees the other's gradient. The posterior is that of the first scenes."""
    assert model.encoder is not None, "grounded training infers graphs; give the model an encoder"
    optima = None
    if settings.optima is not None:
        begun = begun_elsewhere(model, scenes, settings, settings.optima.scenes, generator)
        optima = optimal_scenes(model, reward, *begun, settings.optima, progress)
    beside = settings.updates if settings.encoder_updates is None else settings.encoder_updates
    to_encoder = Descent(model.encoder.parameters(), settings.encoder_rate, settings.encoder_lead + beside)
    for chosen in batches(len(posterior), settings.batch, settings.encoder_lead, generator):
        shown = _look(model, scenes[chosen], settings, generator)
        to_encoder.step(_cross_entropy(posterior[chosen], shown))
    to_policy = Descent(model.decoder.parameters(), settings.policy_rate, settings.updates)
    reproduced = len(posterior) if settings.reconstruction == "judged" else len(scenes)
    for update, chosen in enumerate(batches(reproduced, settings.batch, settings.updates, generator)):
        batch = scenes[chosen]
        known, taught = chosen % len(posterior), update < beside
        shown = _look(model, scenes[known], settings, generator) if taught else None
        with torch.no_grad():
            graph = (
                shown if shown is not None and torch.equal(known, chosen) else _look(model, batch, settings, generator)
            )
        if shown is not None:
            to_encoder.step(_cross_entropy(posterior[known], shown))
        believed = _believed(graph, posterior[known], settings, generator)
        driven = rollout(model, batch.start, believed, batch.leader)
        loss = reconstruction_loss(driven.state, batch.state, model.dynamics)
        if settings.action_weight:
            loss = loss + settings.action_weight * action_error(driven.action, batch.action, model.decoder.action_unit)
        if optima is None:
            away = -grounded_return(model, reward, scenes, settings, settings.return_batch, generator)
        else:
            some = torch.randint(0, len(optima), (settings.return_batch,), generator=generator)
            away = distance(model, optima[some], settings.optima_scale)
        to_policy.step(loss + settings.return_weight * faded(update / settings.updates, settings.return_fade) * away)
        progress("encoder and policy", update + 1, settings.updates, float(loss.detach()))


def _believed(
    graph: InteractionGraph, posterior: Float[Tensor, "B E K"], settings: GroundedSettings, generator: torch.Generator
) -> Float[Tensor, "B E K"]:
    """The graphs under which scenes are reproduced: the encoder's, or the posterior's."""
    match settings.reconstruction:
        case "drawn":
            return graph.sample(generator).detach()
        case "likely":
            return graph.one_hot
        case "judged":
            return torch.nn.functional.one_hot(posterior.argmax(-1), posterior.shape[-1]).to(posterior)


def _cross_entropy(posterior: Float[Tensor, "B E K"], shown: InteractionGraph) -> Float[Tensor, ""]:
    return -(posterior * shown.logits.log_softmax(-1)).sum(-1).mean()


def faded(done: float, left: float) -> float:
    """Factor that declines from 1 to `left` as the work done goes from 0 to 1, ever more slowly."""
    return left + (1 - left) * (1 - done) ** 2


def _look(
    model: RelationalModel, scenes: Scenes, settings: GroundedSettings, generator: torch.Generator
) -> InteractionGraph:
    return model.infer(augment(scenes.seen, settings.augmentation, model.history_steps, generator, model.dynamics))


def grounded_return(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    count: int,
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """Mean learned reward per step under random graphs, half of the starts shifted; each vehicle for itself."""
    start, leader, graph = begun_elsewhere(model, scenes, settings, count, generator)
    driven = rollout(model, start, graph, leader, selfish=True)
    return returns(reward, driven.state, driven.action, graph).mean()


def begun_elsewhere(
    model: RelationalModel, scenes: Scenes, settings: GroundedSettings, count: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Starts of random scenes, shifted as the settings say, their leader's states, and random graphs (`elsewhere`)."""
    types = len(model.config.vocabulary)
    return elsewhere(scenes, settings.shifts, settings.return_headway, model.dynamics, types, count, generator)
