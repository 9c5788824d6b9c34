"""Grounded training without an adversary: first the reward, then the graph, then the policy.

1. Reward: the weights of the structured reward and the drivers' rationality maximise the likelihood of the recorded
   actions, summed over all graphs with the sparse prior (`gri.planning.laplace_likelihood`). No label is used.
2. Graph: the likelihood of the actions, under the reward or under a policy planned on it, gives a posterior over the
   edges of every scene. The encoder learns this posterior by cross-entropy. It gets no gradient from the policy's
   reconstruction, so the policy cannot change what an edge means.
3. Policy: it reproduces the recorded scenes under graphs from the encoder. It also maximises the learned reward under
   random graphs and from shifted starts, so that an edge keeps its meaning off the data.
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
from gri.training.grounded.augmentation import augment_histories, sample_off_data
from gri.training.grounded.optimal_scenes import distance_to_optima, optimal_scenes
from gri.training.grounded.policy_posterior import posterior_by_policy
from gri.training.grounded.reward_likelihood import fit_reward, graph_prior, scene_posterior
from gri.training.grounded.settings import GroundedSettings
from gri.training.optimisation import Descent, action_error, draw_batch, reconstruction_loss
from gri.training.training_state import TrainingState, no_state


def train_grounded(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    seed: int,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the model and the reward in place. The model must have an encoder. Graphs of scenes are not used."""
    generator = torch.Generator().manual_seed(seed)
    fit_reward(model, reward, scenes, settings, generator, progress, state)
    graph_scenes = scenes[: settings.graph_scenes]
    if settings.judge == "policy" or settings.optima is not None:
        plan_policy(model, reward, scenes, settings, generator, progress, state)
    if settings.judge == "policy":
        posterior = posterior_by_policy(model, reward, graph_scenes, graph_prior(reward, graph_scenes, settings))
    else:
        posterior = scene_posterior(model, reward, graph_scenes, settings, progress)
    fit_encoder_and_policy(model, reward, scenes, posterior, settings, generator, progress, state=state)


def plan_policy(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    generator: torch.Generator,
    progress: Progress = no_progress,
    state: TrainingState | None = None,
) -> None:
    """Train the policy in place to maximise the reward under random graphs, before it imitates recorded scenes."""
    descent = Descent(model.decoder.parameters(), settings.policy_rate, settings.planner_updates, clip=1.0)
    for update in (state or no_state()).updates("plan", settings.planner_updates, generator, descent):
        value = off_data_return(model, reward, scenes, settings, settings.planner_batch, generator)
        descent.step(-value)
        progress("plan", update + 1, settings.planner_updates, float(value.detach()))


def fit_encoder_and_policy(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    posterior: Float[Tensor, "P E K"],
    settings: GroundedSettings,
    generator: torch.Generator,
    progress: Progress = no_progress,
    weight: Float[Tensor, " P"] | None = None,
    state: TrainingState | None = None,
) -> None:
    """Train encoder and policy in place; neither gets the other's gradient.

    `posterior` is that of the first P scenes. `weight` gives the relative probabilities of these scenes while the
    encoder is trained alone (`encoder_lead`).
    """
    assert model.encoder is not None, "got a model without an encoder; grounded training infers graphs and needs one"
    optima = None
    if settings.optima is not None:
        start, leader, graph = off_data_batch(model, scenes, settings, settings.optima.scenes, generator)
        optima = optimal_scenes(model, reward, start, leader, graph, settings.optima, progress)
    lead = settings.encoder_lead
    joint_updates = settings.updates if settings.encoder_updates is None else settings.encoder_updates
    encoder_descent = Descent(model.encoder.parameters(), settings.encoder_rate, lead + joint_updates)
    state = state or no_state()
    for update in state.updates("encoder", lead, generator, encoder_descent):
        chosen = draw_batch(len(posterior), settings.batch, generator, weight)
        inferred = _infer_augmented(model, scenes[chosen], settings, generator)
        loss = _cross_entropy(posterior[chosen], inferred)
        encoder_descent.step(loss)
        progress("encoder", update + 1, lead, float(loss.detach()))
    policy_descent = Descent(model.decoder.parameters(), settings.policy_rate, settings.updates)
    reproduced = len(posterior) if settings.reconstruction == "judged" else len(scenes)
    descents = encoder_descent, policy_descent
    for update in state.updates("encoder and policy", settings.updates, generator, *descents):
        chosen = draw_batch(reproduced, settings.batch, generator)
        batch, with_posterior = scenes[chosen], chosen % len(posterior)
        trains_encoder = update < joint_updates
        inferred = _infer_augmented(model, scenes[with_posterior], settings, generator) if trains_encoder else None
        if inferred is not None and torch.equal(with_posterior, chosen):
            graph = inferred
        else:
            with torch.no_grad():
                graph = _infer_augmented(model, batch, settings, generator)
        if inferred is not None:
            encoder_descent.step(_cross_entropy(posterior[with_posterior], inferred))
        one_hot = _reconstruction_graph(graph, posterior[with_posterior], settings, generator)
        driven = rollout(model, batch.start, one_hot, batch.leader)
        loss = reconstruction_loss(driven.state, batch.state, model.dynamics)
        if settings.action_weight:
            loss = loss + settings.action_weight * action_error(driven.action, batch.action, model.decoder.action_unit)
        if optima is None:
            off_data_loss = -off_data_return(model, reward, scenes, settings, settings.return_batch, generator)
        else:
            sampled = torch.randint(0, len(optima), (settings.return_batch,), generator=generator)
            off_data_loss = distance_to_optima(model, optima[sampled], settings.optima_scale)
        return_weight = settings.return_weight * decayed(update / settings.updates, settings.return_fade)
        policy_descent.step(loss + return_weight * off_data_loss)
        progress("encoder and policy", update + 1, settings.updates, float(loss.detach()))


def _reconstruction_graph(
    graph: InteractionGraph, posterior: Float[Tensor, "B E K"], settings: GroundedSettings, generator: torch.Generator
) -> Float[Tensor, "B E K"]:
    """One-hot graphs under which scenes are reproduced: from the encoder's `graph`, or from the posterior."""
    match settings.reconstruction:
        case "drawn":
            return graph.sample(generator).detach()
        case "likely":
            return graph.one_hot
        case "judged":
            return torch.nn.functional.one_hot(posterior.argmax(-1), posterior.shape[-1]).to(posterior)


def _cross_entropy(posterior: Float[Tensor, "B E K"], inferred: InteractionGraph) -> Float[Tensor, ""]:
    return -(posterior * inferred.logits.log_softmax(-1)).sum(-1).mean()


def decayed(progress: float, final: float) -> float:
    """Factor that decreases from 1 to `final` as `progress` goes from 0 to 1: final + (1 − final)·(1 − progress)²."""
    return final + (1 - final) * (1 - progress) ** 2


def _infer_augmented(
    model: RelationalModel, scenes: Scenes, settings: GroundedSettings, generator: torch.Generator
) -> InteractionGraph:
    """The graphs that the encoder infers from augmented histories."""
    history = augment_histories(
        scenes.observed, settings.augmentation, model.history_steps, generator, model.dynamics, model.dt
    )
    return model.infer(history)


def off_data_return(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    settings: GroundedSettings,
    count: int,
    generator: torch.Generator,
) -> Float[Tensor, ""]:
    """Mean reward per driven vehicle and step over `count` roll-outs from `off_data_batch`.

    No gradient flows from a vehicle's reward to other vehicles.
    """
    start, leader, graph = off_data_batch(model, scenes, settings, count, generator)
    driven = rollout(model, start, graph, leader, detach_senders=True)
    return returns(reward, driven.state, driven.action, graph).mean()


def off_data_batch(
    model: RelationalModel, scenes: Scenes, settings: GroundedSettings, count: int, generator: torch.Generator
) -> tuple[Float[Tensor, "B N D"], Float[Tensor, "B T D"], Float[Tensor, "B E K"]]:
    """B = `count` starts, the leader's states, and random one-hot graphs (`sample_off_data`)."""
    types = len(model.config.vocabulary)
    return sample_off_data(scenes, settings.shifts, settings.return_headway, model.dynamics, types, count, generator)
