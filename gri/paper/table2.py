"""Table 2: train every row on recorded scenes and put it to the tests; what is done is kept and never made again."""

import hashlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import torch

from gri import checkpoint, resources
from gri.core.dynamics import dynamics_named
from gri.core.graph import EdgeType
from gri.core.scenes import Scenes
from gri.data.ranges.recorded import RECORDED, RecordedRange
from gri.data.recorded import recorded_scenes
from gri.data.scene_file.reading import Recorded
from gri.data.store import Splits
from gri.errors import InputError
from gri.evaluation import out_of_distribution as ood
from gri.evaluation import recorded_scores as scores
from gri.evaluation.diagnostics import reconstruct
from gri.evaluation.evaluate import driving_graph
from gri.networks.model import RelationalModel
from gri.paper import table2_lanes
from gri.paper.jobs import write
from gri.progress import Progress, no_progress
from gri.training.baselines import idm
from gri.training.train import TrainConfig, read_train_config, train

VERSION = 1
"""Of what a result holds; raise it when the tests change."""


@dataclass(frozen=True)
class Row:
    """One model of the table."""

    name: str
    suffix: str
    """Its training configuration is `scenarios/train/SCENARIO + suffix.yaml`; `IDM` has none, it is calibrated."""
    meaning: bool = True
    """Its edge types have the meaning of the definitions."""
    transfers: bool = False
    """Also trained on each site alone and tested on the other."""
    rewarded: bool = False
    """Depends on the reward of the scenes."""


IDM = Row("IDM, calibrated", "", transfers=True)
ROWS = (
    Row("GRI", "", transfers=True, rewarded=True),
    Row("GRI (paper)", "_airl", rewarded=True),
    Row("NRI", "_nri", meaning=False),
    Row("Supervised", "_supervised", transfers=True),
)


@dataclass(frozen=True)
class Job:
    """A row, a seed, and the site that it is trained on; None: all."""

    scenario: str
    row: Row
    seed: int
    site: str | None = None

    @property
    def scenes(self) -> RecordedRange:
        return RECORDED[self.scenario]

    @property
    def config(self) -> TrainConfig | None:
        if self.row is IDM:
            return None
        return read_train_config(resources.shipped("scenarios", "train", f"{self.scenario}{self.row.suffix}.yaml"))

    def folder(self, cache: Path, file: str) -> Path:
        scenes = self.scenes if self.row.rewarded else [self.scenes.kinds, self.scenes.steps, self.scenes.scale]
        content = [VERSION, self.config, scenes, self.seed, self.site, file, self.row.meaning]
        content += list(table2_lanes.DEPENDS) if self.scenes.lanes else []
        key = hashlib.sha256(msgspec.json.encode(content)).hexdigest()[:10]
        name = f"{self.scenario}{self.row.suffix or ('_idm' if self.row is IDM else '')}-s{self.seed}"
        return cache / f"{name}{f'-{self.site}' if self.site else ''}-{key}"

    def is_done(self, cache: Path, file: str) -> bool:
        return (self.folder(cache, file) / "result.json").is_file()

    def result(self, cache: Path, file: str) -> dict[str, Any]:
        return msgspec.json.decode((self.folder(cache, file) / "result.json").read_bytes())


def digest(path: Path) -> str:
    """Which scenes: the hash of the file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def sites(scenario: str, path: Path) -> list[str]:
    """Where the test scenes are from."""
    return sorted(set(recorded_scenes(path, RECORDED[scenario], "test")[1].source.tolist()))


def jobs_of(scenario: str, seeds: int, sites: Sequence[str], names: Sequence[str] = ()) -> list[Job]:
    """All rows seed by seed, then one seed of the transfers; `names` leaves out other rows.

    Lane changes have no IDM and, as all of them are needed, no transfers. Errors: `InputError` for an unknown row.
    """
    unknown = [name for name in names if name not in [row.name for row in ROWS]]
    if unknown:
        raise InputError(f"got row {unknown[0]}, wanted one of {', '.join(row.name for row in ROWS)}")
    rows = [row for row in ROWS if not names or row.name in names]
    made = [Job(scenario, row, seed) for seed in range(seeds) for row in rows]
    if RECORDED[scenario].lanes:
        return made
    made.insert(0, Job(scenario, IDM, 0))
    if len(sites) > 1:
        made += [Job(scenario, row, 0, site) for row in (IDM, *rows) if row.transfers for site in sites]
    return made


def run(job: Job, path: Path, cache: Path, progress: Progress = no_progress) -> dict[str, Any]:
    """Do the job unless it is done; the result appears last and whole."""
    file = digest(path)
    folder = job.folder(cache, file)
    if not job.is_done(cache, file):
        began = time.process_time()
        made = _lanes if job.scenes.lanes else _following
        result = made(job, path, folder, progress)
        write(folder / "result.json", result | {"cpu_seconds": round(time.process_time() - began, 1)})
    return job.result(cache, file)


def _lanes(job: Job, path: Path, folder: Path, progress: Progress) -> dict[str, Any]:
    assert job.config is not None
    return table2_lanes.cross_validated(job.config, job.scenes, path, folder, job.seed, job.row.meaning, progress)


def _following(job: Job, path: Path, folder: Path, progress: Progress) -> dict[str, Any]:
    parts = {split: recorded_scenes(path, job.scenes, split) for split in ("train", "validation", "test")}
    chosen = _of_site(*parts["train"], job.site)
    if job.config is None:
        return _calibrated(job, chosen, parts["test"], progress)
    splits = Splits(chosen, parts["validation"][0], parts["test"][0])
    return _examined(job, _model(job, splits, folder, progress), splits, parts["test"][1])


def _of_site(scenes: Scenes, found: Recorded, site: str | None) -> Scenes:
    return scenes if site is None else scenes[torch.from_numpy(found.source == site)]


def _model(job: Job, splits: Splits, folder: Path, progress: Progress) -> RelationalModel:
    path = folder / "model.pt"
    if not path.is_file():
        assert job.config is not None
        trained = train(job.config, splits, job.seed, progress)
        checkpoint.save(path, trained.model, trained.reward, trained.provenance)
    return checkpoint.load(path)


def _examined(job: Job, model: RelationalModel, splits: Splits, found: Recorded) -> dict[str, Any]:
    test, vocabulary = splits.test, model.config.vocabulary
    state = reconstruct(model, test)
    follow = scores.kept_edge(vocabulary, EdgeType.FOLLOW)
    types = follow if job.row.meaning else ood.modal_edges(driving_graph(model, test).map, (0, 1), 3)
    return {
        "errors": scores.errors(state, test.state, model.dynamics) | scores.best_of_samples(model, splits.train, test),
        "site": found.source.tolist(),
        "compared": scores.compared(state, test.state, found.length, model.dynamics),
        "graphs": None if model.encoder is None else scores.graphs(model, test),
        "ood": scores.by_ratio(scores.responder(model, types), test, (0, 1), model.dynamics),
        "ood_types": types,
    }


def _calibrated(job: Job, train_scenes: Scenes, test: tuple[Scenes, Recorded], progress: Progress) -> dict[str, Any]:
    scenes, found = test
    driver, dynamics = idm.calibrate(train_scenes, job.scenes.dt, progress), dynamics_named(job.scenes.dynamics)
    state = idm.drive(driver, scenes.start, scenes.leader)
    return {
        "errors": scores.errors(state, scenes.state, dynamics),
        "site": found.source.tolist(),
        "compared": scores.compared(state, scenes.state, found.length, dynamics),
        "graphs": None,
        "parameters": idm.parameters(driver),
        "ood": scores.by_ratio(lambda start, ahead: idm.drive(driver, start, ahead), scenes, (0, 1), dynamics),
    }
