"""Metrics on recorded scenes: those of Table 2, and more (Sec. VI-D, VI-E)."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float
from scipy.stats import wasserstein_distance
from torch import Tensor

from gri.core.dynamics import Dynamics
from gri.core.graph import EdgeType, InteractionGraph, Vocabulary
from gri.core.scenes import Scenes
from gri.evaluation import diagnostics, graph_scores, metrics
from gri.evaluation import out_of_distribution as ood
from gri.evaluation.evaluate import driving_graph, scored_features
from gri.evaluation.metrics import Summary
from gri.networks.model import RelationalModel
from gri.networks.rollout import rollout

SAMPLES = 20
"""Roll-outs per scene of `best_of_samples`."""
RATIOS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
"""Ratios δ of the test out of distribution: Δx' = (1 − δ)·Δx."""
DEFAULT_LENGTH = 4.6
"""Length of vehicles whose length was not recorded [m]."""


def trajectory_errors(
    state: Float[Tensor, "S N T D"], recorded: Float[Tensor, "S N T D"], dynamics: Dynamics
) -> dict[str, Tensor]:
    """Errors of each scene: RMSE of positions [m] and speed [m/s], mean (ADE) and final (FDE) displacement [m]."""
    errors = {f"rmse_{name}": metrics.rmse(state, recorded, index) for name, index in scored_features(dynamics).items()}
    distance = displacement(state, recorded, dynamics)
    return errors | {"ade": distance.mean((1, 2)), "fde": distance[:, :, -1].mean(1)}


def displacement(
    state: Float[Tensor, "*batch N T D"], recorded: Float[Tensor, "*batch N T D"], dynamics: Dynamics
) -> Float[Tensor, "*batch R T"]:
    """Distance of the driven vehicles from their recorded positions [m]."""
    places = [dynamics.index(name) for name in ("x", "y") if name in dynamics.state]
    return (state - recorded)[..., :-1, :, places].norm(dim=-1)


def best_of_samples(model: RelationalModel, train: Scenes, test: Scenes) -> dict[str, Tensor]:
    """Smallest ADE and smallest FDE of each scene over `SAMPLES` roll-outs with sampled actions [m].

    The standard deviation of the actions is fitted to the first 1000 training scenes.
    """
    sampled = diagnostics.sampled_states(model, test, diagnostics.fitted_sigma(model, train[:1000]), SAMPLES)
    distance = displacement(sampled, test.state.expand_as(sampled), model.dynamics)
    return {"min_ade": distance.mean((2, 3)).amin(0), "min_fde": distance[..., -1].mean(2).amin(0)}


def net_gaps(state: Float[Tensor, "S N T D"], length: Float[Tensor, "S N"]) -> Float[Tensor, "S R T"]:
    """Net gap of vehicle j to vehicle j + 1 ahead of it [m]. Lengths of 0 are unknown and count as `DEFAULT_LENGTH`."""
    leader_length = torch.where(length > 0, length, torch.full_like(length, DEFAULT_LENGTH))[:, 1:, None]
    return state[:, 1:, :, 0] - state[:, :-1, :, 0] - leader_length


def interaction_samples(
    state: Float[Tensor, "S N T D"], length: Float[Tensor, "S N"], dynamics: Dynamics
) -> dict[str, Tensor]:
    """Samples of the driven vehicles in car following.

    Per scene: `collision` (a net gap of 0 or less) and `least_gap` [m]. Per vehicle and step: `time_headway` (net gap
    by speed, above 1 m/s only) [s], `speed` [m/s], `acceleration` [m/s²].
    """
    gap, speed = net_gaps(state, length), state[:, :-1, :, dynamics.speed]
    moving = speed > 1.0
    return {
        "collision": (gap <= 0).any(2).any(1),
        "least_gap": gap.amin((1, 2)),
        "time_headway": (gap / speed.clamp(min=1e-6))[moving].clamp(0, 10),
        "speed": speed.flatten(),
        "acceleration": state[:, :-1, :, -1].flatten(),
    }


def compare_interaction(
    state: Float[Tensor, "S N T D"],
    recorded: Float[Tensor, "S N T D"],
    length: Float[Tensor, "S N"],
    dynamics: Dynamics,
) -> dict[str, Any]:
    """Collision rate and mean time headway [s] of roll-outs and recording, and distances between distributions.

    `wasserstein_...` are Wasserstein-1 distances between roll-outs and recording, in the unit of the quantity.
    """
    simulated, real = interaction_samples(state, length, dynamics), interaction_samples(recorded, length, dynamics)
    comparison: dict[str, Any] = {
        "collision": metrics.proportion(simulated["collision"]).mean,
        "collision_recorded": metrics.proportion(real["collision"]).mean,
        "time_headway": float(simulated["time_headway"].mean()),
        "time_headway_recorded": float(real["time_headway"].mean()),
    }
    for name in ("time_headway", "speed", "acceleration"):
        comparison[f"wasserstein_{name}"] = float(wasserstein_distance(simulated[name].numpy(), real[name].numpy()))
    return comparison


def graph_metrics(model: RelationalModel, scenes: Scenes) -> dict[str, Any]:
    """Scores of inferred graphs against the hypothesised ones.

    Accuracies per scene, also with the best naming of labels; F1 by type over edges into driven vehicles; the frequency
    of each type for each edge (`metrics.edge_frequency`); and `diagnostics.shuffle_agreement`.
    """
    inferred, vocabulary = driving_graph(model, scenes).map, model.config.vocabulary
    naming = graph_scores.best_label_matching(inferred, scenes.graph, len(vocabulary), move_none=False)
    driven = graph_scores.edges_into_driven(inferred), graph_scores.edges_into_driven(scenes.graph)
    return {
        "accuracy": metrics.accuracy(inferred, scenes.graph),
        "accuracy_renamed": metrics.accuracy(graph_scores.renamed(inferred, naming), scenes.graph),
        "driven_accuracy": metrics.accuracy(*driven),
        "f1": {str(kind): graph_scores.f1(*driven, k) for k, kind in enumerate(vocabulary)},
        "frequency": metrics.edge_frequency(inferred, len(vocabulary)),
        "shuffle_agreement": diagnostics.shuffle_agreement(model, scenes),
    }


FollowerDrive = Callable[[Tensor, Tensor], Tensor]
"""(starts [S, 2, D], trajectory of the vehicle ahead [S, T, D]) -> states [S, 2, T, D]."""


def success_by_ratio(
    drive: FollowerDrive, scenes: Scenes, kept: tuple[int, int], dynamics: Dynamics
) -> list[dict[str, Any]]:
    """The test out of distribution on recorded scenes: the starting headway is reduced by each ratio δ (Sec. VI-E).

    `kept` are the indices of follower and vehicle ahead. The follower's start is moved along the road. The vehicle
    ahead drives as recorded. x^T is the last state. `success`, `collision` are rates, `lateral` is the mean Δy [m],
    `scenes` the number of scenes.
    """
    pair = scenes.state[:, list(kept)]
    points = []
    for ratio in RATIOS:
        start = pair[:, :, 0].clone()
        start[:, 0, 0] += ratio * (pair[:, 1, 0, 0] - pair[:, 0, 0, 0])
        state = drive(start, pair[:, 1])
        point = ood.score(state, ratio, ood.Front.CONSTANT_SPEED, ood.Protocol(), dynamics)
        points.append(
            {"ratio": ratio, "success": point.success.mean, "collision": point.collision.mean,
             "lateral": point.lateral.mean, "scenes": len(state)}
        )  # fmt: skip
    return points


def drive_by_policy(model: RelationalModel, types: Tensor) -> FollowerDrive:
    """Drive vehicle 0 by the model's mean actions. `types` are the forced types of 0 → 1 and 1 → 0."""

    @torch.no_grad()
    def drive(start: Tensor, ahead: Tensor) -> Tensor:
        graph = InteractionGraph.certain(types.expand(len(start), 2), model.config.vocabulary).one_hot
        return rollout(model, start, graph, ahead).state

    return drive


def forced_edge(vocabulary: Vocabulary, kind: EdgeType) -> Tensor:
    """Types of 0 → 1 and 1 → 0: "none" and `kind`."""
    return torch.tensor([0, vocabulary.index(kind)])


def pooled_rate(success: float, scenes: int) -> Summary:
    """A success rate with its interval, given the number of scenes."""
    successful: Bool[Tensor, " S"] = torch.arange(scenes) < round(success * scenes)
    return metrics.proportion(successful)


def clustered_half_width(values: Float[Tensor, " S"], cluster: Sequence[int]) -> float:
    """Half the width of the 95 % interval of the mean if scenes with the same number in `cluster` are not independent.

    The variance of the mean is Σ_c (Σ_{s in c} (value_s − mean))² / S², times C / (C − 1) for C clusters.
    """
    deviation, numbers = values - values.mean(), torch.tensor(cluster)
    sums = torch.stack([deviation[numbers == number].sum() for number in numbers.unique()])
    count = len(sums)
    return 1.96 * float((sums.square().sum() * count / max(count - 1, 1)).sqrt()) / len(values)
