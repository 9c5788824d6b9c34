"""Recorded lane changes, of which there are few: training on drawn ones, fine-tuning and cross-validation on recorded.

A model is trained on windows with drawn lateral motion (`gri.data.ngsim.sampled_lateral_motion`). No vehicle of a
recorded lane change is in them. The recorded lane changes are split into folds. For each fold, the model is fine-tuned
on the lane changes of the other folds and tested on those of the fold. Windows that share a vehicle are in one fold.
"""

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Int

from gri import checkpoint
from gri.core.dynamics import dynamics_named
from gri.core.graph import EdgeType, pairs
from gri.core.scenes import Scenes
from gri.data.ngsim.sampled_lateral_motion import SOURCE_SUFFIX
from gri.data.ranges.recorded import RecordedRange
from gri.data.recorded import has_sampled_lateral_motion, recorded_scenes
from gri.data.scene_file.reading import Recorded
from gri.data.store import Splits
from gri.evaluation import out_of_distribution as ood
from gri.evaluation import recorded_scores as scores
from gri.evaluation.diagnostics import reconstruct
from gri.evaluation.evaluate import driving_graph
from gri.networks.model import RelationalModel
from gri.paper.job_cache import Job
from gri.training.fine_tuning import fine_tune


@dataclass(frozen=True)
class LaneChanges:
    """The windows of a scene file."""

    recorded: Scenes
    found: Recorded
    """What the file says of the recorded windows."""
    drawn: Scenes
    """Drawn windows for training."""
    validation: Scenes
    """Drawn windows for validation."""

    @property
    def splits(self) -> Splits:
        return Splits(self.drawn, self.validation, self.recorded)


def lane_changes_of(path: Path, scenes: RecordedRange) -> LaneChanges:
    """Recorded lane changes, and the drawn ones without a vehicle of a recorded one."""
    every, found = recorded_scenes(path, scenes, None)
    is_drawn = has_sampled_lateral_motion(found)
    recorded = torch.from_numpy(np.flatnonzero(~is_drawn))
    vehicles = {vehicle for window in recorded.tolist() for vehicle in vehicles_of(found, window)}
    usable = np.array([drawn and vehicles.isdisjoint(vehicles_of(found, w)) for w, drawn in enumerate(is_drawn)])
    train, validation = (torch.from_numpy(usable & (found.split == split)) for split in ("train", "validation"))
    return LaneChanges(every[recorded], found[recorded], every[train], every[validation])


def vehicles_of(found: Recorded, window: int) -> set[tuple[str, int]]:
    """The vehicles of a window as (site, number): vehicles of different sites may have the same number."""
    site = str(found.source[window]).removesuffix(SOURCE_SUFFIX)
    return {(site, int(vehicle)) for vehicle in found.vehicle[window]}


def clusters_and_folds(found: Recorded, folds: int) -> tuple[Int[np.ndarray, " S"], Int[np.ndarray, " S"]]:
    """The cluster and the fold of each window. Windows that are connected by shared vehicles are one cluster.

    The largest cluster is assigned first. Each goes to the fold that has the fewest windows so far.
    """
    cluster = np.arange(len(found))
    first_window: dict[tuple[str, int], int] = {}
    for window in range(len(found)):
        for vehicle in sorted(vehicles_of(found, window)):
            other = first_window.setdefault(vehicle, window)
            cluster[cluster == cluster[window]] = cluster[other]
    counts, fold, load = Counter(cluster.tolist()), np.zeros(len(found), int), [0] * folds
    for number, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        least = load.index(min(load))
        fold[cluster == number] = least
        load[least] += count
    return cluster, fold


def cross_validate(job: Job, lane_changes: LaneChanges, model_file: Path) -> dict[str, Any]:
    """The result of a job: the scores of every recorded window, by the model that was fine-tuned without its fold.

    `before` has the scores of the model before fine-tuning.
    """
    scenes, protocol, defined_types = job.scenario.recorded, job.scenario.cross_validation, job.row.defined_types
    assert scenes is not None
    assert protocol is not None
    recorded, found = lane_changes.recorded, lane_changes.found
    cluster, fold = clusters_and_folds(found, protocol.folds)
    before = measure_model(checkpoint.load(model_file), recorded, defined_types)
    parts, order = [], []
    for number in range(protocol.folds):
        test, train = (torch.from_numpy(np.flatnonzero(chosen)) for chosen in (fold == number, fold != number))
        if not len(test) or not len(train):
            continue
        model, reward = checkpoint.load(model_file), checkpoint.load_reward(model_file)
        some = with_sampled_scenes(recorded[train], lane_changes.drawn, protocol.drawn_per_recorded, job.seed)
        fine_tune(model, reward, job.training, some, protocol.tuning, job.seed)
        parts.append(measure_model(model, recorded[test], defined_types))
        order.append(test)
    return in_window_order(parts, torch.cat(order).argsort()) | {
        "site": found.source.tolist(),
        "cluster": cluster.tolist(),
        "hypothesis": hypotheses(recorded, scenes).tolist(),
        "before": before,
    }


def blurred(drawn: Scenes, scenes: RecordedRange, blur: tuple[float, float], seed: int) -> Scenes:
    """Scenes with noise on the lateral speeds and accelerations at the first step. Everything else stays.

    Drawn motion is so smooth that its first step gives away when the lane change begins. Recorded motion does not: the
    standard deviation of its accelerations is ten times larger.
    """
    generator, state = torch.Generator().manual_seed(seed), drawn.state.clone()
    dynamics = dynamics_named(scenes.dynamics)
    for feature, std in zip(("vy", "ay"), blur, strict=True):
        noise = std * torch.randn(state[:, :-1, 0, 0].shape, generator=generator)
        state[:, :-1, 0, dynamics.index(feature)] += noise
    return replace(drawn, state=state)


def hypotheses(recorded: Scenes, scenes: RecordedRange) -> Int[np.ndarray, " S"]:
    """0 for windows under H1, 1 under H2: whether vehicle 1 yields to vehicle 0."""
    yields = scenes.vocabulary.index(EdgeType.YIELD)
    return (recorded.graph[:, pairs(3).index((0, 1))] == yields).numpy().astype(int)


def with_sampled_scenes(recorded: Scenes, drawn: Scenes, per_recorded: int, seed: int) -> Scenes:
    """Recorded windows and several times as many drawn ones, so that fine-tuning does not forget the latter."""
    generator = torch.Generator().manual_seed(seed)
    some = drawn[torch.randperm(len(drawn), generator=generator)[: per_recorded * len(recorded)]]
    both = (torch.cat([getattr(part, name) for part in (recorded, some)]) for name in ("state", "action", "graph"))
    return Scenes(*both)


def measure_model(model: RelationalModel, scenes: Scenes, defined_types: bool) -> dict[str, Any]:
    """The scores of windows under both hypotheses."""
    state = reconstruct(model, scenes)
    graphs = None if model.encoder is None else scores.graph_metrics(model, scenes)
    return {
        "errors": scores.trajectory_errors(state, scenes.state, model.dynamics),
        "graphs": graphs and {key: graphs[key] for key in ("accuracy", "accuracy_renamed", "driven_accuracy")},
        "inferred": driving_graph(model, scenes).map,
        "ood": yielding_by_ratio(model, scenes, defined_types),
    }


def yielding_by_ratio(model: RelationalModel, scenes: Scenes, defined_types: bool) -> list[dict[str, Any]]:
    """The out-of-distribution test with the edge over which vehicle 0 yields: to vehicle 1 in H1, to 2 in H2."""
    inferred, vocabulary = driving_graph(model, scenes).map, model.config.vocabulary
    points: list[dict[str, Any]] = [{"ratio": ratio, "hits": 0, "contacts": 0, "scenes": 0} for ratio in scores.RATIOS]
    for sender in (1, 2):
        edge = pairs(3).index((sender, 0))
        chosen = torch.nonzero(scenes.graph[:, edge] == vocabulary.index(EdgeType.YIELD))[:, 0]
        if not len(chosen):
            continue
        types = scores.forced_edge(vocabulary, EdgeType.YIELD)
        if not defined_types:
            types = ood.modal_edges(inferred[chosen], (0, sender), 3)
        found = scores.success_by_ratio(
            scores.drive_by_policy(model, types), scenes[chosen], (0, sender), model.dynamics
        )
        for point, one in zip(points, found, strict=True):
            point["hits"] += round(one["success"] * one["scenes"])
            point["contacts"] += round(one["collision"] * one["scenes"])
            point["scenes"] += one["scenes"]
    return points


def in_window_order(parts: list[dict[str, Any]], order: Int[torch.Tensor, " S"]) -> dict[str, Any]:
    """The scores of all folds as those of all windows, in the order of the windows."""

    def joined(values: list[Any]) -> list[Any]:
        return torch.cat([torch.as_tensor(value) for value in values])[order].tolist()

    first = parts[0]
    points = [
        {key: (point[key] if key == "ratio" else sum(part["ood"][k][key] for part in parts)) for key in point}
        for k, point in enumerate(first["ood"])
    ]
    return {
        "errors": {name: joined([part["errors"][name] for part in parts]) for name in first["errors"]},
        "graphs": first["graphs"] and {n: joined([part["graphs"][n] for part in parts]) for n in first["graphs"]},
        "inferred": joined([part["inferred"] for part in parts]),
        "ood": points,
    }
