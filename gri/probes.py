"""Tests of what a trained model has learned, beyond the table: spread, meaning of edges, weights, numbering."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from gri import metrics
from gri.data.synthetic import Scenes
from gri.evaluate import believed
from gri.graph import InteractionGraph, pairs
from gri.graph_scores import shuffled, unshuffled
from gri.metrics import Summary
from gri.model import RelationalModel
from gri.oracle import Given, best_response
from gri.rewards import StructuredReward
from gri.rollout import mean_actions, rollout


@torch.no_grad()
def reconstruct(model: RelationalModel, scenes: Scenes) -> Float[Tensor, "S N T D"]:
    """One roll-out of mean actions under the MAP graph, as the tables score it."""
    return rollout(model, scenes.start, believed(model, scenes).one_hot, scenes.leader).state


@torch.no_grad()
def shuffle_agreement(model: RelationalModel, scenes: Scenes, seed: int = 0) -> float:
    """Share of edges that keep their type when the vehicles are renumbered: 1, unless numbers are read."""
    order = torch.randperm(scenes.state.shape[1], generator=torch.Generator().manual_seed(seed))
    plain = model.infer(scenes.state[:, :, : model.history_steps]).map
    moved = model.infer(shuffled(scenes.state[:, :, : model.history_steps], order)).map
    return float((unshuffled(moved, order) == plain).float().mean())


@torch.no_grad()
def fitted_sigma(model: RelationalModel, scenes: Scenes) -> Float[Tensor, " A"]:
    """The standard deviation of actions under which the recorded ones are most likely, given the trained means.

    Models trained by roll-out error alone never use their σ; this one takes its place.
    """
    graph = believed(model, scenes).one_hot
    means = mean_actions(model, scenes.state, graph, scenes.action.shape[1])
    return (scenes.action - means).square().mean((0, 1, 2)).sqrt()


@torch.no_grad()
def sampled_states(
    model: RelationalModel, scenes: Scenes, sigma: Float[Tensor, " A"], samples: int, seed: int = 0
) -> Float[Tensor, "M S N T D"]:
    """M roll-outs of every scene under its MAP graph with actions drawn from N(μ, σ²)."""
    generator = torch.Generator().manual_seed(seed)
    graph = believed(model, scenes).one_hot
    drawn = []
    for _ in range(samples):
        noise = torch.randn(scenes.action.shape, generator=generator) * sigma / model.decoder.sigma
        drawn.append(rollout(model, scenes.start, graph, scenes.leader, noise).state)
    return torch.stack(drawn)


def std_along_horizon(states: Float[Tensor, "M S N T D"]) -> Float[Tensor, "T D"]:
    """Standard deviation over roll-outs at every instant, mean over scenes and driven vehicles (Appendix B)."""
    return states[:, :, :-1].std(0).mean((0, 1))


def weights_beside_truth(reward: StructuredReward, true: StructuredReward) -> dict[str, tuple[float, float]]:
    """Learned and true weight of every term, both over the weight of the first action term.

    Rewards are only known up to their scale, so that ratios are compared.
    """
    groups = list(reward.psi)
    unit = next(name for name in reward.names("node") if "jerk" in name)
    place = reward.names("node").index(unit)
    scale, true_scale = (float(r.weights("node")[place].detach()) for r in (reward, true))
    return {
        f"{group}.{name}": (
            float(reward.weights(group)[m].detach()) / scale,
            float(true.weights(group)[m].detach()) / true_scale,
        )
        for group in groups
        for m, name in enumerate(reward.names(group))
    }


Effect = Callable[[Tensor], Tensor]
"""States [S, N, T, D] -> one number per scene that the edge's definition says something about."""


@torch.no_grad()
def flip_agreement(
    model: RelationalModel,
    scenes: Scenes,
    true: StructuredReward,
    pair: tuple[int, int],
    kinds: tuple[int, int],
    effect: Effect,
    least: float = 0.1,
) -> Summary | None:
    """Flip one edge between two types; does the effect change its sign as the optimum of the true reward's does?

    The vehicle ahead is driven as recorded in the optimum's roll-outs. Scenes in which the optimum changes by
    less than `least` do not count; None where none is left.
    """
    sender, receiver = pair
    place = pairs(scenes.state.shape[1]).index(pair)
    by_model, by_oracle = [], []
    for kind in kinds:
        types = scenes.graph.clone()
        types[:, place] = kind
        graph = InteractionGraph.certain(types, model.config.vocabulary).one_hot
        by_model.append(effect(rollout(model, scenes.start, graph, scenes.leader).state))
        given = Given(scenes.start[:, receiver], scenes.state[:, sender], kind)
        state = scenes.state.clone()
        state[:, receiver] = best_response(given, true, model.dynamics, model.dt)
        by_oracle.append(effect(state))
    wanted, shown = by_oracle[1] - by_oracle[0], by_model[1] - by_model[0]
    counted = wanted.abs() >= least
    return metrics.proportion((wanted.sign() == shown.sign())[counted]) if bool(counted.any()) else None


def final_headway(state: Float[Tensor, "S N T D"], sender: int = 1, receiver: int = 0) -> Float[Tensor, " S"]:
    """x_i − x_j at the end [m]."""
    return state[:, sender, -1, 0] - state[:, receiver, -1, 0]
