"""Recorded lane changes, of which there are few: training on drawn ones, fine-tuning on the others, cross-validation.

A model learns from scenes with drawn lateral motion (`gri.data.ngsim.drawn_lane_changes`), none of whose vehicles is in
a recorded lane change. Then, fold by fold, it is fine-tuned on the recorded lane changes of the other folds and tested
on those of its own. Windows that share a vehicle are in one fold.
"""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gri import checkpoint
from gri.core.dynamics import dynamics_named
from gri.core.graph import EdgeType, pairs
from gri.core.scenes import Scenes
from gri.data.ngsim.drawn_lane_changes import MARK
from gri.data.ranges.recorded import RecordedRange
from gri.data.recorded import are_drawn, recorded_scenes
from gri.data.scene_file.reading import Recorded
from gri.data.store import Splits
from gri.evaluation import out_of_distribution as ood
from gri.evaluation import recorded_scores as scores
from gri.evaluation.diagnostics import reconstruct
from gri.evaluation.evaluate import driving_graph
from gri.networks.model import RelationalModel
from gri.progress import Progress
from gri.training.fine_tuning import FineTuning, fine_tune
from gri.training.optimisation import ACROSS
from gri.training.train import TrainConfig, train

FOLDS = 5
TUNING = FineTuning(updates=60)
BESIDE = 4
"""Drawn windows for each recorded one in fine-tuning, which else fits the few recorded ones too well."""
BLUR = (0.2, 0.3)
"""Standard deviations of what is added to first lateral speeds [m/s] and accelerations [m/s²]."""
DEPENDS = (FOLDS, TUNING, BESIDE, BLUR, ACROSS)
"""On what results depend beside the configuration."""


def recorded_and_drawn(path: Path, scenes: RecordedRange) -> tuple[Scenes, Recorded, Scenes, Scenes]:
    """Recorded lane changes and what the file says of them; drawn ones to train on and to validate with."""
    every, found = recorded_scenes(path, scenes, None)
    is_drawn = are_drawn(found)
    real = torch.from_numpy(np.flatnonzero(~is_drawn))
    seen = {name for place in real.tolist() for name in names(found, place)}
    free = np.array([drawn and seen.isdisjoint(names(found, s)) for s, drawn in enumerate(is_drawn)])
    train_split, validation = (torch.from_numpy(free & (found.split == split)) for split in ("train", "validation"))
    return every[real], found[real], every[train_split], every[validation]


def names(found: Recorded, scene: int) -> set[tuple[str, int]]:
    """The vehicles of a scene by site and number; of the sites of several files, numbers may be shared."""
    site = str(found.source[scene]).removesuffix(MARK)
    return {(site, int(vehicle)) for vehicle in found.vehicle[scene]}


def fold_of(found: Recorded, folds: int = FOLDS) -> tuple[np.ndarray, np.ndarray]:
    """[S] The cluster of each window, windows that are joined by shared vehicles, and its fold.

    Clusters go, the largest first, to the fold that has the fewest windows.
    """
    cluster = np.arange(len(found))
    holder: dict[tuple[str, int], int] = {}
    for scene in range(len(found)):
        for name in sorted(names(found, scene)):
            other = holder.setdefault(name, scene)
            cluster[cluster == cluster[scene]] = cluster[other]
    counts, fold, load = Counter(cluster.tolist()), np.zeros(len(found), int), [0] * folds
    for number, count in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        least = load.index(min(load))
        fold[cluster == number] = least
        load[least] += count
    return cluster, fold


def cross_validated(
    config: TrainConfig, scenes: RecordedRange, path: Path, folder: Path, seed: int, meaning: bool, progress: Progress
) -> dict[str, Any]:
    """Scores of every recorded window, before fine-tuning and by the model that was fine-tuned without its fold."""
    real, found, drawn, validation = recorded_and_drawn(path, scenes)
    drawn = blurred(drawn, scenes, seed)
    cluster, fold = fold_of(found)
    kept = folder / "model.pt"
    if not kept.is_file():
        trained = train(config, Splits(drawn, validation, real), seed, progress)
        checkpoint.save(kept, trained.model, trained.reward, trained.provenance)
    before = examined(checkpoint.load(kept), real, meaning)
    parts, order = [], []
    for number in range(FOLDS):
        tested, learned = (torch.from_numpy(np.flatnonzero(chosen)) for chosen in (fold == number, fold != number))
        if not len(tested) or not len(learned):
            continue
        model, reward = checkpoint.load(kept), checkpoint.load_reward(kept)
        fine_tune(model, reward, config, joined(real[learned], drawn, seed), TUNING, seed)
        parts.append(examined(model, real[tested], meaning))
        order.append(tested)
        progress("folds", number + 1, FOLDS, float(torch.as_tensor(parts[-1]["errors"]["rmse_x"]).mean()))
    place = torch.cat(order).argsort()
    told = {"site": found.source.tolist(), "cluster": cluster.tolist(), "hypothesis": readings(real, scenes).tolist()}
    return merged(parts, place) | told | {"before": before}


def blurred(drawn: Scenes, scenes: RecordedRange, seed: int) -> Scenes:
    """Scenes whose first lateral speeds and accelerations are off by `BLUR`; all else stays.

    Drawn motion is so smooth that its first instant tells when the lane will be changed, which recorded motion, with
    ten times the spread of accelerations, does not.
    """
    generator, state = torch.Generator().manual_seed(seed), drawn.state.clone()
    dynamics = dynamics_named(scenes.dynamics)
    for feature, size in zip(("vy", "ay"), BLUR, strict=True):
        added = size * torch.randn(state[:, :-1, 0, 0].shape, generator=generator)
        state[:, :-1, 0, dynamics.index(feature)] += added
    return replace(drawn, state=state)


def readings(real: Scenes, scenes: RecordedRange) -> np.ndarray:
    """[S] 0 for windows under H1, 1 under H2, by the edge over which vehicle 1 makes room."""
    yields = scenes.vocabulary.index(EdgeType.YIELD)
    return (real.graph[:, pairs(3).index((0, 1))] == yields).numpy().astype(int)


def joined(real: Scenes, drawn: Scenes, seed: int) -> Scenes:
    """Recorded windows and `BESIDE` times as many drawn ones: what was learned from the many is not to be forgotten."""
    generator = torch.Generator().manual_seed(seed)
    some = drawn[torch.randperm(len(drawn), generator=generator)[: BESIDE * len(real)]]
    both = (torch.cat([getattr(part, name) for part in (real, some)]) for name in ("state", "action", "graph"))
    return Scenes(*both)


def examined(model: RelationalModel, scenes: Scenes, meaning: bool) -> dict[str, Any]:
    """What is measured on windows of both readings."""
    state = reconstruct(model, scenes)
    graphs = None if model.encoder is None else scores.graphs(model, scenes)
    return {
        "errors": scores.errors(state, scenes.state, model.dynamics),
        "graphs": graphs and {key: graphs[key] for key in ("accuracy", "accuracy_renamed", "driven_accuracy")},
        "inferred": driving_graph(model, scenes).map,
        "ood": yielding_by_ratio(model, scenes, meaning),
    }


def yielding_by_ratio(model: RelationalModel, scenes: Scenes, meaning: bool) -> list[dict[str, Any]]:
    """The test out of distribution with the edge over which vehicle 0 yields: from 1 in H1, from 2 in H2."""
    inferred, vocabulary = driving_graph(model, scenes).map, model.config.vocabulary
    points: list[dict[str, Any]] = [{"ratio": ratio, "hits": 0, "contacts": 0, "scenes": 0} for ratio in scores.RATIOS]
    for sender in (1, 2):
        edge = pairs(3).index((sender, 0))
        chosen = torch.nonzero(scenes.graph[:, edge] == vocabulary.index(EdgeType.YIELD))[:, 0]
        if not len(chosen):
            continue
        types = scores.kept_edge(vocabulary, EdgeType.YIELD)
        if not meaning:
            types = ood.modal_edges(inferred[chosen], (0, sender), 3)
        found = scores.by_ratio(scores.responder(model, types), scenes[chosen], (0, sender), model.dynamics)
        for point, one in zip(points, found, strict=True):
            point["hits"] += round(one["success"] * one["scenes"])
            point["contacts"] += round(one["collision"] * one["scenes"])
            point["scenes"] += one["scenes"]
    return points


def merged(parts: list[dict[str, Any]], place: torch.Tensor) -> dict[str, Any]:
    """The folds' scores as those of all windows, in the order of the windows."""

    def together(*keys: str) -> list[Any]:
        values = []
        for part in parts:
            for key in keys:
                part = part[key]
            values.append(torch.as_tensor(part))
        return torch.cat(values)[place].tolist()

    first = parts[0]
    points = [
        {key: (point[key] if key == "ratio" else sum(part["ood"][k][key] for part in parts)) for key in point}
        for k, point in enumerate(first["ood"])
    ]
    return {
        "errors": {name: together("errors", name) for name in first["errors"]},
        "graphs": first["graphs"] and {name: together("graphs", name) for name in first["graphs"]},
        "inferred": together("inferred"),
        "ood": points,
    }
