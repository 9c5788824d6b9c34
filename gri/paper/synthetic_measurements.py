"""Everything that tables and figures say about one model that was trained on synthetic scenes."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gri.core.dynamics import dynamics_named
from gri.core.scenes import Scenes
from gri.data.store import Splits
from gri.data.synthetic.expert import sample_starts, true_reward
from gri.evaluation import diagnostics, graph_scores, metrics
from gri.evaluation import out_of_distribution as ood
from gri.evaluation.evaluate import driving_graph
from gri.networks.model import RelationalModel
from gri.paper.job_cache import VERSION, Job, cached
from gri.rewards.structured import AssumedReward, StructuredReward
from gri.training.adversarial.airl import AdversarialSettings

SAMPLES = 20
"""Roll-outs with sampled actions of each of the first `SAMPLED_SCENES` test scenes."""
SAMPLED_SCENES = 200
FLIPPED_SCENES = 100


def measure_model(
    job: Job, model: RelationalModel, reward: StructuredReward | None, splits: Splits, cache: Path
) -> dict[str, Any]:
    """The result of a job. The same model always gives the same values."""
    scenes, ranges = splits.test, job.training.data.scene_range
    graph = driving_graph(model, scenes)
    states, types = diagnostics.reconstruct(model, scenes), forced_types(job, model, graph.map)
    drive = ood.drive_by_policy(model, types, ranges.steps)
    comparable = reward is not None and not isinstance(reward.config, AssumedReward) and not job.training.data.expert
    weights = diagnostics.weights_beside_truth(reward, true_reward(ranges)) if reward and comparable else None
    return {
        "rmse": {
            name: metrics.rmse(states, scenes.state, model.dynamics.index(name)) for name in job.scenario.features
        },
        "graphs": None if model.encoder is None else graph_scores_of(model, graph.map, scenes.graph),
        "shuffled": None if model.encoder is None else diagnostics.shuffle_agreement(model, scenes),
        "std": std_along_horizon(job, model, splits),
        "weights": weights,
        "flip": flip_agreements(job, model, scenes[:FLIPPED_SCENES], cache),
        "ood_types": types.tolist(),
        "ood": [asdict(point) for point in ood.curve(drive, starts(job), job.scenario.protocol, model.dynamics)],
    }


def graph_scores_of(model: RelationalModel, inferred: Tensor, true: Tensor) -> dict[str, Any]:
    """Accuracies, F1 of every type, the best ways to name the types, and edge frequencies; [S, E] types each."""
    vocabulary = model.config.vocabulary
    count = len(vocabulary)
    driven = graph_scores.edges_into_driven(inferred), graph_scores.edges_into_driven(true)
    namings = {
        name: graph_scores.best_label_matching(inferred, true, count, move_none=move)
        for name, move in (("types 1 to K-1", False), ("all types", True))
    }
    return {
        "accuracy": metrics.accuracy(inferred, true),
        "driven_accuracy": metrics.accuracy(*driven),
        "f1": {str(kind): graph_scores.f1(*driven, k) for k, kind in enumerate(vocabulary)},
        "namings": {
            name: {
                "naming": naming,
                "accuracy": float(metrics.accuracy(graph_scores.renamed(inferred, naming), true).mean()),
            }
            for name, naming in namings.items()
        },
        "empty": float(metrics.accuracy(torch.zeros_like(true), true).mean()),
        "frequency": metrics.edge_frequency(inferred, count),
    }


def std_along_horizon(job: Job, model: RelationalModel, splits: Splits) -> dict[str, Any]:
    """Standard deviation of sampled roll-outs at every instant.

    Actions have the policy's own σ where the objective trains it, and a fitted σ otherwise.
    """
    own = isinstance(job.training.objective, AdversarialSettings)
    sigma = model.decoder.sigma if own else diagnostics.fitted_sigma(model, splits.train[:1000])
    states = diagnostics.sampled_states(model, splits.test[:SAMPLED_SCENES], sigma, SAMPLES)
    std = diagnostics.std_along_horizon(states)
    along = {name: std[:, model.dynamics.index(name)] for name in job.scenario.features}
    return {"sigma": sigma, "fitted": not own, "along": along}


def flip_agreements(job: Job, model: RelationalModel, scenes: Scenes, cache: Path) -> dict[str, Any] | None:
    """Share of scenes in which a changed edge type has the effect that it has in the optimum of the true reward.

    None where scenes do not share one true graph, the types of the model have no defined meaning, or the drivers have
    no reward.
    """
    if not job.row.defined_types or job.training.data.graphs != "one" or job.training.data.expert:
        return None
    optimal = optimal_changes(job, scenes, cache)
    shares = {
        flip.name: diagnostics.flip_agreement(model, scenes, flip, torch.tensor(optimal[flip.name]))
        for flip in job.scenario.flips
    }
    return {name: asdict(share) for name, share in shares.items() if share is not None}


def optimal_changes(job: Job, scenes: Scenes, cache: Path) -> dict[str, list[float]]:
    """The effect of every flip in the optimum of the true reward. It depends on the scenes alone and is cached."""
    data, flips = job.training.data, job.scenario.flips
    content = [VERSION, data, data.scene_range, data.shares, [asdict(flip) for flip in flips], len(scenes)]

    def compute() -> dict[str, Tensor]:
        true, dt, dynamics = true_reward(data.scene_range), data.scene_range.dt, dynamics_named(job.model.dynamics)
        return {flip.name: diagnostics.optimal_change(scenes, true, dynamics, dt, flip) for flip in flips}

    return cached(cache, f"flips-{job.scenario.name}", content, compute)


def forced_types(job: Job, model: RelationalModel, inferred: Tensor) -> Tensor:
    """[2] The edge types of the out-of-distribution test: as defined, or as the model itself names them in the data."""
    if job.row.defined_types:
        return ood.follow_edge(model.config.vocabulary)
    return ood.modal_edges(inferred, job.scenario.protocol.kept, vehicles=3)


def starts(job: Job) -> Tensor:
    """[B, 2, D] Starts of the two remaining vehicles before the headway is set. All rows have the same."""
    protocol = job.scenario.protocol
    generator = torch.Generator().manual_seed(protocol.seed)
    start, _ = sample_starts(job.training.data.scene_range, protocol.starts, generator)
    return ood.remaining_pair(start, protocol.kept)


def oracle_drive(job: Job) -> ood.Drive:
    """Driving by the optimum of the true reward."""
    scenes = job.training.data.scene_range
    return ood.drive_optimally(true_reward(scenes), dynamics_named(job.model.dynamics), scenes.dt, scenes.steps)


def oracle_curve(job: Job, cache: Path) -> list[dict[str, Any]]:
    """The out-of-distribution test of the true reward's optimum. It depends on the scenes alone and is cached."""
    protocol = job.scenario.protocol
    content = [VERSION, job.training.data.scene_range, asdict(protocol)]

    def compute() -> list[dict[str, Any]]:
        torch.set_num_threads(1)
        points = ood.curve(oracle_drive(job), starts(job), protocol, dynamics_named(job.model.dynamics))
        return [asdict(point) for point in points]

    return cached(cache, f"oracle-{job.scenario.name}", content, compute)
