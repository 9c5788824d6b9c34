"""Grounded training without an adversary: reward, then graph, then policy.

1. Reward: the weights of the structured reward and the drivers' rationality maximise the likelihood of the recorded
   actions, summed over all graphs under the sparse prior (`gri.planning.laplace_likelihood`). No label is used.
2. Graph: the likelihood of the actions, under the reward or under a policy planned on it, gives every scene a
   posterior over its edges, which the encoder learns by cross-entropy. The encoder never sees how well the policy
   reproduces a scene, so that the policy cannot redefine what an edge means.
3. Policy: it reproduces the recorded scenes under graphs drawn from the encoder, and maximises the learned reward
   under random graphs and from shifted starts, so that an edge keeps its meaning away from the data.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.graph import InteractionGraph
from gri.core.scenes import Scenes
from gri.data.synthetic.expert import returns
from gri.networks.model import RelationalModel
from gri.networks.rollout import rollout
from gri.progress import Progress, no_progress
from gri.rewards.structured import StructuredReward
from gri.training.grounded.augmentation import augment, elsewhere
from gri.training.grounded.optimal_scenes import distance, optimal_scenes
from gri.training.grounded.policy_posterior import posterior_by_policy
from gri.training.grounded.reward_likelihood import fit_reward, prior_of, scene_posterior
from gri.training.grounded.settings import GroundedSettings
from gri.training.optimisation import Descent, action_error, batches, reconstruction_loss


def train_grounded(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    seed: int,
    progress: Progress = no_progress,
) -> None:
    """Train the model and the reward in place."""
    generator = torch.Generator().manual_seed(seed)
    fit_reward(model, reward, scenes, settings, generator, progress)
    judged = scenes[: settings.graph_scenes]
    if settings.judge == "policy" or settings.optima is not None:
        plan(model, reward, scenes, settings, generator, progress)
    if settings.judge == "policy":
        posterior = posterior_by_policy(model, reward, judged, prior_of(reward, judged, settings))
    else:
        posterior = scene_posterior(model, reward, judged, settings, progress)
    fit_encoder_and_policy(model, reward, scenes, posterior, settings, generator, progress)


def plan(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    generator: torch.Generator,
    progress: Progress = no_progress,
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
    progress: Progress = no_progress,
    weight: Float[Tensor, " S"] | None = None,
) -> None:
    """One update of each per batch; neither sees the other's gradient. The posterior is that of the first scenes.

    `weight`: how often the encoder draws each of these while it moves alone.
    """
    assert model.encoder is not None, "grounded training infers graphs; give the model an encoder"
    optima = None
    if settings.optima is not None:
        begun = off_data_returns(model, scenes, settings, settings.optima.scenes, generator)
        optima = optimal_scenes(model, reward, *begun, settings.optima, progress)
    beside = settings.updates if settings.encoder_updates is None else settings.encoder_updates
    lead = settings.encoder_lead
    to_encoder = Descent(model.encoder.parameters(), settings.encoder_rate, lead + beside)
    for update, chosen in enumerate(batches(len(posterior), settings.batch, lead, generator, weight)):
        error = _cross_entropy(posterior[chosen], _look(model, scenes[chosen], settings, generator))
        to_encoder.step(error)
        progress("encoder", update + 1, lead, float(error.detach()))
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
        driving_graph = _believed(graph, posterior[known], settings, generator)
        driven = rollout(model, batch.start, driving_graph, batch.leader)
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
    seen = augment(scenes.seen, settings.augmentation, model.history_steps, generator, model.dynamics, model.dt)
    return model.infer(seen)


def grounded_return(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    count: int,
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """Mean learned reward per step under random graphs, half of the starts shifted; each vehicle for itself."""
    start, leader, graph = off_data_returns(model, scenes, settings, count, generator)
    driven = rollout(model, start, graph, leader, selfish=True)
    return returns(reward, driven.state, driven.action, graph).mean()


def off_data_returns(
    model: RelationalModel, scenes: Scenes, settings: GroundedSettings, count: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Starts of random scenes, shifted as the settings say, their leader's states, and random graphs (`elsewhere`)."""
    types = len(model.config.vocabulary)
    return elsewhere(scenes, settings.shifts, settings.return_headway, model.dynamics, types, count, generator)
