"""Tests of what a trained model has learned, beyond the table: spread, meaning of edges, weights, numbering."""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.core.graph import EdgeType, InteractionGraph, agents_of, pairs
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
    """One roll-out of mean actions under the MAP graph, as the tables score it."""
    return rollout(model, scenes.start, driving_graph(model, scenes).one_hot, scenes.leader).state


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
    graph = driving_graph(model, scenes).one_hot
    means = mean_actions(model, scenes.state, graph, scenes.action.shape[1])
    return (scenes.action - means).square().mean((0, 1, 2)).sqrt()


@torch.no_grad()
def sampled_states(
    model: RelationalModel, scenes: Scenes, sigma: Float[Tensor, " A"], samples: int, seed: int = 0
) -> Float[Tensor, "M S N T D"]:
    """M roll-outs of every scene under its MAP graph with actions drawn from N(μ, σ²)."""
    generator = torch.Generator().manual_seed(seed)
    graph = driving_graph(model, scenes).one_hot
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


@dataclass(frozen=True)
class Flip:
    """One edge set to one type and then to another, on the same starts, and what the definitions say must change."""

    sender: int
    receiver: int
    before: EdgeType
    after: EdgeType
    effect: Literal["headway", "order", "lateral"]
    """Final x_i − x_j, its sign, or final |y_i − y_j|."""

    @property
    def name(self) -> str:
        return f"{self.sender}->{self.receiver}: {self.before} -> {self.after}, {self.effect}"


@torch.no_grad()
def flip_agreement(
    model: RelationalModel, scenes: Scenes, flip: Flip, wanted: Float[Tensor, " S"], least: float = 0.1
) -> Summary | None:
    """Share of scenes in which the flip moves the effect the way it is wanted.

    Scenes in which it is wanted to change by less than `least` (headway and lateral distance: [m]) do not count; None
    where none is left.
    """
    effects = []
    for kind in (flip.before, flip.after):
        types = flipped(scenes.graph, flip, model.config.vocabulary.index(kind))
        graph = InteractionGraph.certain(types, model.config.vocabulary).one_hot
        effects.append(_effect(flip, rollout(model, scenes.start, graph, scenes.leader).state, model.dynamics))
    shown, counted = effects[1] - effects[0], wanted.abs() >= least
    return metrics.proportion((wanted.sign() == shown.sign())[counted]) if bool(counted.any()) else None


def optimal_change(
    scenes: Scenes, true: StructuredReward, dynamics: Dynamics, dt: float, flip: Flip
) -> Float[Tensor, " S"]:
    """How the flip changes the effect in the optimum of the true reward.

    The receiver's optimum takes the other vehicles as recorded; all scenes must share one graph.
    """
    effects = []
    for kind in (flip.before, flip.after):
        types = flipped(scenes.graph[:1], flip, true.vocabulary.index(kind))[0]
        effects.append(_effect(flip, _with_best_response(scenes, types, flip.receiver, true, dynamics, dt), dynamics))
    return effects[1] - effects[0]


def flipped(graph: Int[Tensor, "S E"], flip: Flip, kind: int) -> Int[Tensor, "S E"]:
    """The graphs with the flip's edge of the given type."""
    types = graph.clone()
    types[:, pairs(agents_of(graph.shape[1])).index((flip.sender, flip.receiver))] = kind
    return types


def _with_best_response(
    scenes: Scenes, types: Int[Tensor, " E"], vehicle: int, true: StructuredReward, dynamics: Dynamics, dt: float
) -> Float[Tensor, "S N T D"]:
    n = scenes.state.shape[1]
    others = [i for i in range(n) if i != vehicle]
    kinds = tuple(int(types[pairs(n).index((i, vehicle))]) for i in others)
    state = scenes.state.clone()
    state[:, vehicle] = best_response(
        ResponseProblem(state[:, vehicle, 0], state[:, others], kinds), true, dynamics, dt
    )
    return state


def _effect(flip: Flip, state: Float[Tensor, "S N T D"], dynamics: Dynamics) -> Float[Tensor, " S"]:
    between = state[:, flip.sender, -1] - state[:, flip.receiver, -1]
    if flip.effect == "lateral":
        return between[:, dynamics.index("y")].abs()
    headway = between[:, dynamics.index("x")]
    return headway.sign() if flip.effect == "order" else headway
