"""Recorded car following: which scenes a job trains on, and what its tests measure (Table II)."""

from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gri.core.dynamics import Dynamics, dynamics_named
from gri.core.graph import EdgeType
from gri.core.scenes import Scenes
from gri.data.ranges.recorded import RecordedRange
from gri.data.recorded import recorded_scenes
from gri.data.scene_file.reading import Recorded
from gri.data.store import Splits
from gri.evaluation import out_of_distribution as ood
from gri.evaluation import recorded_scores as scores
from gri.evaluation.diagnostics import reconstruct
from gri.evaluation.evaluate import driving_graph
from gri.networks.model import RelationalModel
from gri.training.baselines import idm


def sites_of(path: Path, scenes: RecordedRange) -> list[str]:
    """The sites of the test scenes in a file."""
    return sorted(set(recorded_scenes(path, scenes, "test")[1].source.tolist()))


def splits_of(path: Path, scenes: RecordedRange, site: str | None) -> tuple[Splits, Recorded]:
    """The scenes of a file, of which those for training are of one site if a site is given; and the test's record."""
    (train, found), (validation, _), (test, tested) = (
        recorded_scenes(path, scenes, split) for split in ("train", "validation", "test")
    )
    chosen = train if site is None else train[torch.from_numpy(found.source == site)]
    return Splits(chosen, validation, test), tested


def measure_model(model: RelationalModel, defined_types: bool, splits: Splits, found: Recorded) -> dict[str, Any]:
    """The result of a trained row. Types without a defined meaning are forced as the model infers them most often."""
    test = splits.test
    types = scores.forced_edge(model.config.vocabulary, EdgeType.FOLLOW)
    if not defined_types:
        types = ood.modal_edges(driving_graph(model, test).map, (0, 1), 3)
    result = _measure(reconstruct(model, test), scores.drive_by_policy(model, types), test, found, model.dynamics)
    result["errors"] |= scores.best_of_samples(model, splits.train, test)
    graphs = None if model.encoder is None else scores.graph_metrics(model, test)
    return result | {"graphs": graphs, "ood_types": types}


def calibrate_and_test(scenes: RecordedRange, splits: Splits, found: Recorded) -> dict[str, Any]:
    """The result of the calibrated Intelligent Driver Model (IDM)."""
    driver, test = idm.calibrate(splits.train, scenes.dt), splits.test
    respond = partial(idm.drive, driver)
    result = _measure(respond(test.start, test.leader), respond, test, found, dynamics_named(scenes.dynamics))
    return result | {"graphs": None, "parameters": idm.parameters(driver)}


def _measure(
    state: Tensor, respond: scores.FollowerDrive, test: Scenes, found: Recorded, dynamics: Dynamics
) -> dict[str, Any]:
    """Scores of the driven states [S, N, T, D], and of a driver behind a recorded vehicle out of distribution."""
    return {
        "errors": scores.trajectory_errors(state, test.state, dynamics),
        "site": found.source.tolist(),
        "compared": scores.compare_interaction(state, test.state, found.length, dynamics),
        "ood": scores.success_by_ratio(respond, test, (0, 1), dynamics),
    }
