"""Diagnostics of a trained model: spread of its actions, meaning of its edges, weights of its reward, numbering."""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.core.graph import EdgeType, InteractionGraph, pairs, vehicle_count
from gri.core.scenes import Scenes
from gri.evaluation import metrics
from gri.evaluation.evaluate import driving_graph
from gri.evaluation.graph_scores import shuffled, unshuffled
from gri.evaluation.metrics import Summary
from gri.networks.model import RelationalModel
from gri.networks.rollout import mean_actions, rollout
from gri.planning.best_response import ResponseProblem, best_response
from gri.rewards.structured import StructuredReward


@torch.no_grad()
def reconstruct(model: RelationalModel, scenes: Scenes) -> Float[Tensor, "S N T D"]:
    """One roll-out of mean actions under the MAP graph, as in the paper's tables (Sec. VI-B)."""
    return rollout(model, scenes.start, driving_graph(model, scenes).one_hot, scenes.leader).state


@torch.no_grad()
def shuffle_agreement(model: RelationalModel, scenes: Scenes, seed: int = 0) -> float:
    """Share of edges that keep their type if the vehicles are renumbered. It is 1 if the numbers have no effect."""
    order = torch.randperm(scenes.state.shape[1], generator=torch.Generator().manual_seed(seed))
    original = model.infer(scenes.state[:, :, : model.history_steps]).map
    renumbered = model.infer(shuffled(scenes.state[:, :, : model.history_steps], order)).map
    return float((unshuffled(renumbered, order) == original).float().mean())


@torch.no_grad()
def fitted_sigma(model: RelationalModel, scenes: Scenes) -> Float[Tensor, " A"]:
    """The maximum-likelihood standard deviation of recorded actions about the model's means, in action units (SI).

    Models that are trained by the error of roll-outs alone do not learn their σ. This one replaces it.
    """
    graph = driving_graph(model, scenes).one_hot
    means = mean_actions(model, scenes.state, graph, scenes.action.shape[1])
    return (scenes.action - means).square().mean((0, 1, 2)).sqrt()


@torch.no_grad()
def sampled_states(
    model: RelationalModel, scenes: Scenes, sigma: Float[Tensor, " A"], samples: int, seed: int = 0
) -> Float[Tensor, "M S N T D"]:
    """M = `samples` roll-outs of every scene under its MAP graph, with actions sampled from N(μ, σ²)."""
    generator = torch.Generator().manual_seed(seed)
    graph = driving_graph(model, scenes).one_hot
    sampled = []
    for _ in range(samples):
        noise = torch.randn(scenes.action.shape, generator=generator) * sigma / model.decoder.sigma
        sampled.append(rollout(model, scenes.start, graph, scenes.leader, noise).state)
    return torch.stack(sampled)


def std_along_horizon(states: Float[Tensor, "M S N T D"]) -> Float[Tensor, "T D"]:
    """Standard deviation over roll-outs at every step, mean over scenes and driven vehicles, SI units (Appendix B)."""
    return states[:, :, :-1].std(0).mean((0, 1))


def weights_beside_truth(reward: StructuredReward, true: StructuredReward) -> dict[str, tuple[float, float]]:
    """Learned and true weight of every term "GROUP.TERM", both divided by the weight of the jerk.

    Rewards are identified only up to their scale, so ratios are compared.
    """
    groups = list(reward.psi)
    jerk = next(m for m, name in enumerate(reward.names("node")) if "jerk" in name)
    scale, true_scale = (float(r.weights("node")[jerk].detach()) for r in (reward, true))
    return {
        f"{group}.{name}": (
            float(reward.weights(group)[m].detach()) / scale,
            float(true.weights(group)[m].detach()) / true_scale,
        )
        for group in groups
        for m, name in enumerate(reward.names(group))
    }


@dataclass(frozen=True)
class Flip:
    """A change of one edge's type with the same starts, and the effect that the types' definitions imply."""

    sender: int
    receiver: int
    before: EdgeType
    after: EdgeType
    effect: Literal["headway", "order", "lateral"]
    """At the end, for sender i and receiver j: `headway` x_i − x_j [m], `order` its sign, `lateral` |y_i − y_j| [m]."""

    @property
    def name(self) -> str:
        """Edge, types and effect in one line."""
        return f"{self.sender}->{self.receiver}: {self.before} -> {self.after}, {self.effect}"


@torch.no_grad()
def flip_agreement(
    model: RelationalModel, scenes: Scenes, flip: Flip, expected: Float[Tensor, " S"], min_change: float = 0.1
) -> Summary | None:
    """Share of scenes in which the flip changes the effect in the expected direction.

    `expected` is the expected change (`optimal_change`). Scenes in which it is smaller than `min_change` (in the
    effect's unit) do not count; None if no scene counts.
    """
    effects = []
    for kind in (flip.before, flip.after):
        types = flipped(scenes.graph, flip, model.config.vocabulary.index(kind))
        graph = InteractionGraph.certain(types, model.config.vocabulary).one_hot
        effects.append(_effect(flip, rollout(model, scenes.start, graph, scenes.leader).state, model.dynamics))
    change, counted = effects[1] - effects[0], expected.abs() >= min_change
    return metrics.proportion((expected.sign() == change.sign())[counted]) if bool(counted.any()) else None


def optimal_change(
    scenes: Scenes, true: StructuredReward, dynamics: Dynamics, dt: float, flip: Flip
) -> Float[Tensor, " S"]:
    """Change of the effect by the flip if the receiver maximises the true reward.

    The other vehicles move as recorded. `dt` is the time step [s]. All scenes must have the same graph.
    """
    effects = []
    for kind in (flip.before, flip.after):
        types = flipped(scenes.graph[:1], flip, true.vocabulary.index(kind))[0]
        effects.append(_effect(flip, _with_best_response(scenes, types, flip.receiver, true, dynamics, dt), dynamics))
    return effects[1] - effects[0]


def flipped(graph: Int[Tensor, "S E"], flip: Flip, kind: int) -> Int[Tensor, "S E"]:
    """The graphs in which the flip's edge has the type `kind` (an index into the vocabulary)."""
    types = graph.clone()
    types[:, pairs(vehicle_count(graph.shape[1])).index((flip.sender, flip.receiver))] = kind
    return types


def _with_best_response(
    scenes: Scenes, types: Int[Tensor, " E"], vehicle: int, true: StructuredReward, dynamics: Dynamics, dt: float
) -> Float[Tensor, "S N T D"]:
    """States in which `vehicle` plays its best response to the recorded trajectories of the others."""
    n = scenes.state.shape[1]
    others = [i for i in range(n) if i != vehicle]
    kinds = tuple(int(types[pairs(n).index((i, vehicle))]) for i in others)
    state = scenes.state.clone()
    state[:, vehicle] = best_response(
        ResponseProblem(state[:, vehicle, 0], state[:, others], kinds), true, dynamics, dt
    )
    return state


def _effect(flip: Flip, state: Float[Tensor, "S N T D"], dynamics: Dynamics) -> Float[Tensor, " S"]:
    """The flip's effect in each scene, at the last step."""
    between = state[:, flip.sender, -1] - state[:, flip.receiver, -1]
    if flip.effect == "lateral":
        return between[:, dynamics.index("y")].abs()
    headway = between[:, dynamics.index("x")]
    return headway.sign() if flip.effect == "order" else headway
