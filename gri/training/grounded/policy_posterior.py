"""The posterior over the graphs of recorded scenes by a policy that was planned on the reward; no labels are used."""

import torch
from jaxtyping import Float
from torch import Tensor

from gri.core.graph import pairs, vehicle_count
from gri.core.scenes import Scenes
from gri.networks.model import RelationalModel
from gri.networks.rollout import mean_actions
from gri.planning.edge_posterior import combinations, marginals
from gri.rewards.structured import StructuredReward


@torch.no_grad()
def posterior_by_policy(
    model: RelationalModel,
    reward: StructuredReward,
    scenes: Scenes,
    prior: Float[Tensor, "S E K"],
) -> Float[Tensor, "S E K"]:
    """p(z | u) ∝ p(z)·Π_t N(u_t; μ(x_t, z), σ²), with a policy μ that maximises the reward under every graph.

    Like a driver, a policy knows only the present; Laplace's approximation assumes that vehicles foresee the others.
    σ² is the mean over vehicles of the mean squared deviation under the graph that fits best.
    """
    deviation = _deviations(model, reward, scenes)  # Shape: (S, R, C, T−1)
    squared = deviation.square()
    variance = squared.mean(-1).amin(-1).mean().clamp(min=1e-4)
    return marginals(reward, -0.5 * squared.sum(-1) / variance, prior)


def _deviations(model: RelationalModel, reward: StructuredReward, scenes: Scenes) -> Float[Tensor, "S R C U"]:
    """Distance of recorded from mean actions, in units of the scale, for each combination of edges into a vehicle."""
    n = scenes.state.shape[1]
    unit = model.decoder.action_unit
    parts = []
    for types in combinations(reward, n - 1)[1]:
        graph = incoming_graph(types, n).expand(len(scenes), -1, -1)
        means = mean_actions(model, scenes.state, graph, driven=scenes.action.shape[1])
        parts.append(((means - scenes.action) / unit).norm(dim=-1))
    return torch.stack(parts, 2)


def incoming_graph(types: Float[Tensor, "S K"], n: int) -> Float[Tensor, "1 E K"]:
    """The graph of n vehicles in which the edges into each vehicle, in the order of senders, have these types."""
    assert types.shape[0] == n - 1 == vehicle_count(n * (n - 1)) - 1
    return torch.stack([types[i if i < j else i - 1] for i, j in pairs(n)])[None]
