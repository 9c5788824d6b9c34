"""One row and one seed: train, test, keep both. What is kept is never made again.

A job's folder is named after the hash of all that its result depends on, so that a changed configuration is a
new job and an interrupted run goes on where it stopped.
"""

import hashlib
import os
import time
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch import Tensor

from gri import checkpoint
from gri.core.dynamics import Dynamics, dynamics_named
from gri.core.graph import InteractionGraph, Vocabulary
from gri.core.scenes import Scenes
from gri.data.store import Splits, scenes_of
from gri.data.synthetic.expert import sample_starts, true_reward
from gri.evaluation import diagnostics, graph_scores, metrics
from gri.evaluation import out_of_distribution as ood
from gri.evaluation.evaluate import driving_graph
from gri.networks.model import Edge, RelationalModel
from gri.paper.rows import Row, Scenario
from gri.rewards.structured import StructuredReward
from gri.training.adversarial.airl import AdversarialSettings
from gri.training.grounded.settings import GroundedSettings
from gri.training.train import TrainConfig, model_config, train

VERSION = 1
"""Of what a result holds; raise it when the tests change."""
SAMPLES = 20
"""Roll-outs with drawn actions, of `SAMPLED_SCENES` test scenes."""
SAMPLED_SCENES = 200
FLIPPED_SCENES = 100


@dataclass(frozen=True)
class Job:
    """A row to be trained with one seed, and the tests it is put to."""

    scenario: Scenario
    row: Row
    config: TrainConfig
    seed: int

    @property
    def name(self) -> str:
        return f"{self.config.name}-s{self.seed}"

    def folder(self, cache: Path) -> Path:
        data = self.config.data
        content = [VERSION, self.config, data.scene_range, data.shares, asdict(self.scenario.protocol), self.seed]
        digest = hashlib.sha256(msgspec.json.encode([*content, self.row.meaning])).hexdigest()
        return cache / f"{self.name}-{digest[:10]}"

    def is_done(self, cache: Path) -> bool:
        return (self.folder(cache) / "result.json").is_file()

    def result(self, cache: Path) -> dict[str, Any]:
        return msgspec.json.decode((self.folder(cache) / "result.json").read_bytes())

    def made(self, cache: Path) -> dict[str, Any]:
        """How long it took, and by which versions."""
        return msgspec.json.decode((self.folder(cache) / "made.json").read_bytes())


def run(job: Job, cache: Path, scenes: Path) -> str:
    """Do the job unless it is done; the result file appears last and whole."""
    torch.set_num_threads(1)
    if job.is_done(cache):
        return job.name
    folder, splits = job.folder(cache), scenes_of(job.config.data, scenes)
    path = folder / "model.pt"
    if not path.is_file():
        trained = train(job.config, splits, job.seed)
        checkpoint.save(path, trained.model, trained.reward, trained.provenance)
    trained_in = {name: checkpoint.provenance(path).get(name) for name in ("seconds", "cpu_seconds")}
    began = time.monotonic()
    result = examine(job, checkpoint.load(path), checkpoint.load_reward(path), splits, cache)
    made = trained_in | {"tests": round(time.monotonic() - began, 1)}
    write(folder / "made.json", made | {"torch": str(torch.__version__), "gri-cosim": version("gri-cosim")})
    write(folder / "result.json", result)
    return job.name


def write(path: Path, content: Any) -> None:
    """JSON that appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    text = msgspec.json.encode(content, enc_hook=lambda tensor: torch.as_tensor(tensor).tolist())
    part.write_bytes(msgspec.json.format(text, indent=0) + b"\n")
    os.replace(part, path)


def examine(
    job: Job, model: RelationalModel, reward: StructuredReward | None, splits: Splits, cache: Path
) -> dict[str, Any]:
    """All that tables and figures say of one trained model; the same model gives the same values."""
    scenes = splits.test
    graph = driving_graph(model, scenes)
    true = true_reward(job.config.data.scene_range)
    states, types = diagnostics.reconstruct(model, scenes), forced_types(job, model, graph.map)
    return {
        "rmse": {
            name: metrics.rmse(states, scenes.state, model.dynamics.index(name)) for name in job.scenario.features
        },
        "graphs": None if model.encoder is None else graph_result(model, graph.map, scenes.graph),
        "shuffled": None if model.encoder is None else diagnostics.shuffle_agreement(model, scenes),
        "std": spread(job, model, splits),
        "weights": None if reward is None else diagnostics.weights_beside_truth(reward, true),
        "flip": flips(job, model, splits.test[:FLIPPED_SCENES], cache),
        "ood_types": types.tolist(),
        "ood": [asdict(point) for point in curve(job, model, types)],
    }


def graph_result(model: RelationalModel, inferred: Tensor, true: Tensor) -> dict[str, Any]:
    """Accuracies, F1 of every type, the best namings, and the edge frequencies."""
    vocabulary = model.config.vocabulary
    count = len(vocabulary)
    driven = graph_scores.edges_into_driven(inferred), graph_scores.edges_into_driven(true)
    namings = {
        name: graph_scores.best_naming(inferred, true, count, move_none=move)
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


def spread(job: Job, model: RelationalModel, splits: Splits) -> dict[str, Any]:
    """Standard deviation along the horizon, with the policy's σ where the objective gave it one, else a fitted
    one.
    """
    own = isinstance(job.config.objective, AdversarialSettings)
    sigma = model.decoder.sigma if own else diagnostics.fitted_sigma(model, splits.train[:1000])
    drawn = diagnostics.sampled_states(model, splits.test[:SAMPLED_SCENES], sigma, SAMPLES)
    std = diagnostics.std_along_horizon(drawn)
    along = {name: std[:, model.dynamics.index(name)] for name in job.scenario.features}
    return {"sigma": sigma, "fitted": not own, "along": along}


def flips(job: Job, model: RelationalModel, scenes: Scenes, cache: Path) -> dict[str, Any] | None:
    """Whether edges mean what they say, for scenes that share one true graph and models whose types have meaning."""
    if not job.row.meaning or job.config.data.graphs != "one":
        return None
    wanted = optimal_changes(job, scenes, cache)
    found = {
        flip.name: diagnostics.flip_agreement(model, scenes, flip, torch.tensor(wanted[flip.name]))
        for flip in job.scenario.flips
    }
    return {name: asdict(share) for name, share in found.items() if share is not None}


def optimal_changes(job: Job, scenes: Scenes, cache: Path) -> dict[str, list[float]]:
    """What every flip changes in the true reward's optimum, kept like a job; it depends on the scenes alone."""
    data, tested = job.config.data, [asdict(flip) for flip in job.scenario.flips]
    content = msgspec.json.encode([VERSION, data, data.scene_range, data.shares, tested, len(scenes)])
    path = cache / f"flips-{job.scenario.name}-{hashlib.sha256(content).hexdigest()[:10]}.json"
    if not path.is_file():
        true, dynamics = true_reward(data.scene_range), dynamics_of(job)
        changes = {
            flip.name: diagnostics.optimal_change(scenes, true, dynamics, data.scene_range.dt, flip)
            for flip in job.scenario.flips
        }
        write(path, changes)
    return msgspec.json.decode(path.read_bytes())


def forced_types(job: Job, model: RelationalModel, inferred: Tensor) -> Tensor:
    """The two edges of the test out of distribution: as defined, or as the model itself names them in the data."""
    if job.row.meaning:
        return ood.follow_edge(model.config.vocabulary)
    return ood.modal_edges(inferred, job.scenario.protocol.kept, vehicles=3)


def curve(job: Job, model: RelationalModel, types: Tensor) -> list[ood.Point]:
    """The test out of distribution."""
    drive = ood.driver(model, types, job.config.data.scene_range.steps)
    return ood.curve(drive, starts(job), job.scenario.protocol, model.dynamics)


def starts(job: Job) -> Tensor:
    """Starts of the two vehicles that remain, before the headway is set; the same for every row."""
    protocol = job.scenario.protocol
    generator = torch.Generator().manual_seed(protocol.seed)
    start, _ = sample_starts(job.config.data.scene_range, protocol.starts, generator)
    return ood.keep(start, protocol.kept)


def oracle_points(job: Job, cache: Path) -> list[dict[str, Any]]:
    """The curve of the true reward's optimum, kept like a job; it depends on the scenes alone."""
    scenes, protocol = job.config.data.scene_range, job.scenario.protocol
    content = msgspec.json.encode([VERSION, scenes, asdict(protocol)])
    path = cache / f"oracle-{job.scenario.name}-{hashlib.sha256(content).hexdigest()[:10]}.json"
    if not path.is_file():
        torch.set_num_threads(1)
        dynamics = dynamics_of(job)
        drive = ood.oracle(true_reward(scenes), dynamics, scenes.dt, scenes.steps)
        write(path, [asdict(point) for point in ood.curve(drive, starts(job), protocol, dynamics)])
    return msgspec.json.decode(path.read_bytes())


def quick(job: Job) -> Job:
    """The same job, a hundred times smaller: shows that everything runs, its figures mean nothing."""
    data = msgspec.structs.replace(job.config.data, train=200, validation=20, test=50, expert_updates=20)
    objective = msgspec.structs.replace(job.config.objective, updates=10)
    if isinstance(objective, GroundedSettings):
        optima = objective.optima and msgspec.structs.replace(objective.optima, scenes=50)
        objective = msgspec.structs.replace(objective, planner_updates=10, optima=optima)
    elif isinstance(objective, AdversarialSettings) and objective.start:
        optima = msgspec.structs.replace(objective.start.plan.optima, scenes=50)
        plan = msgspec.structs.replace(objective.start.plan, updates=10, optima=optima, imitation_updates=10)
        start = msgspec.structs.replace(objective.start, plan=plan, encoder_updates=10)
        objective = msgspec.structs.replace(objective, start=start)
    config = msgspec.structs.replace(job.config, name=f"{job.config.name}-quick", data=data, objective=objective)
    headways = job.scenario.protocol.headways[::4]
    protocol = replace(job.scenario.protocol, headways=headways, starts=20)
    return replace(job, config=config, scenario=replace(job.scenario, protocol=protocol))


def dynamics_of(job: Job) -> Dynamics:
    return dynamics_named(model_config(job.config).dynamics)


def vocabulary_of(job: Job) -> Vocabulary:
    return model_config(job.config).vocabulary


def types_of(job: Job, edges: tuple[Edge, ...]) -> Tensor:
    """Type indices [1, E] of the graph that has just these edges."""
    named = {(edge.sender, edge.receiver): edge.type for edge in edges}
    return InteractionGraph.of_edges(named, vocabulary_of(job)).map
