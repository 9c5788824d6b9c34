"""What is measured on recorded scenes: Table 2, and what it leaves out (Sec. VI-D, VI-E)."""

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
RATIOS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0)
"""δ of the test out of distribution: Δx' = (1 − δ)·Δx."""
DEFAULT_LENGTH = 4.6  # [m], of vehicles whose length was not recorded
KEPT = {"car_following": (0, 1), "lane_changing_h1": (0, 1), "lane_changing_h2": (0, 2)}


def trajectory_errors(
    state: Float[Tensor, "S N T D"], recorded: Float[Tensor, "S N T D"], dynamics: Dynamics
) -> dict[str, Tensor]:
    """Per scene: RMSE of position and speed, mean and final displacement [m]."""
    found = {f"rmse_{name}": metrics.rmse(state, recorded, place) for name, place in scored_features(dynamics).items()}
    away = displacement(state, recorded, dynamics)
    return found | {"ade": away.mean((1, 2)), "fde": away[:, :, -1].mean(1)}


def displacement(
    state: Float[Tensor, "*batch N T D"], recorded: Float[Tensor, "*batch N T D"], dynamics: Dynamics
) -> Float[Tensor, "*batch R T"]:
    """Distance of driven vehicles from where they were recorded [m]."""
    places = [dynamics.index(name) for name in ("x", "y") if name in dynamics.state]
    return (state - recorded)[..., :-1, :, places].norm(dim=-1)


def best_of_samples(model: RelationalModel, train: Scenes, test: Scenes) -> dict[str, Tensor]:
    """Per scene: least mean and final displacement of `SAMPLES` roll-outs with drawn actions [m]."""
    drawn = diagnostics.sampled_states(model, test, diagnostics.fitted_sigma(model, train[:1000]), SAMPLES)
    away = displacement(drawn, test.state.expand_as(drawn), model.dynamics)
    return {"min_ade": away.mean((2, 3)).amin(0), "min_fde": away[..., -1].mean(2).amin(0)}


def net_gaps(state: Float[Tensor, "S N T D"], length: Float[Tensor, "S N"]) -> Float[Tensor, "S R T"]:
    """Net distance of vehicle j to j + 1 ahead of it [m]; unknown lengths count as `DEFAULT_LENGTH`."""
    ahead = torch.where(length > 0, length, torch.full_like(length, DEFAULT_LENGTH))[:, 1:, None]
    return state[:, 1:, :, 0] - state[:, :-1, :, 0] - ahead


def interaction_samples(
    state: Float[Tensor, "S N T D"], length: Float[Tensor, "S N"], dynamics: Dynamics
) -> dict[str, Tensor]:
    """Collisions, and headways in time [s] and accelerations [m/s²] of driven vehicles, of car following."""
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
    """Collision rates and mean time headways of roll-outs and record, and distances of their distributions."""
    ours, theirs = interaction_samples(state, length, dynamics), interaction_samples(recorded, length, dynamics)
    found: dict[str, Any] = {
        "collision": metrics.proportion(ours["collision"]).mean,
        "collision_recorded": metrics.proportion(theirs["collision"]).mean,
        "time_headway": float(ours["time_headway"].mean()),
        "time_headway_recorded": float(theirs["time_headway"].mean()),
    }
    for name in ("time_headway", "speed", "acceleration"):
        found[f"wasserstein_{name}"] = float(wasserstein_distance(ours[name].numpy(), theirs[name].numpy()))
    return found


def graph_metrics(model: RelationalModel, scenes: Scenes) -> dict[str, Any]:
    """Accuracies against the hypothesis, best naming, F1, and how often each edge has each type."""
    inferred, vocabulary = driving_graph(model, scenes).map, model.config.vocabulary
    naming = graph_scores.best_naming(inferred, scenes.graph, len(vocabulary), move_none=False)
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
    """The test out of distribution: vehicles `kept` of every scene, the headway shrunk by each ratio δ.

    The vehicle ahead drives as recorded; vehicle 0 is moved along the road. x^T is the last state. Rates are counts,
    so that seeds can be pooled_rate.
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
    """The model under forced types of the two edges (0 → 1, 1 → 0)."""

    @torch.no_grad()
    def drive(start: Tensor, ahead: Tensor) -> Tensor:
        graph = InteractionGraph.certain(types.expand(len(start), 2), model.config.vocabulary).one_hot
        return rollout(model, start, graph, ahead).state

    return drive


def forced_edge(vocabulary: Vocabulary, kind: EdgeType) -> Tensor:
    """1 → 0 is of that type, 0 → 1 nothing."""
    return torch.tensor([0, vocabulary.index(kind)])


def pooled_rate(success: float, scenes: int) -> Summary:
    """Rate with its interval over scenes."""
    hits = round(success * scenes)
    values: Bool[Tensor, " S"] = torch.arange(scenes) < hits
    return metrics.proportion(values)


def clustered_half_width(values: Float[Tensor, " S"], cluster: Sequence[int]) -> float:
    """Half the width of the 95 % interval of the mean when scenes of one cluster are not independent of each other.

    The variance of the mean is Σ_c (Σ_{s in c} (value_s − mean))² / S², times C / (C − 1) for C clusters.
    """
    away, numbers = values - values.mean(), torch.tensor(cluster)
    sums = torch.stack([away[numbers == number].sum() for number in numbers.unique()])
    count = len(sums)
    return 1.96 * float((sums.square().sum() * count / max(count - 1, 1)).sqrt()) / len(values)
