"""The cache of jobs: one row of one scenario, trained and tested with one seed. A finished job is never run again.

The name of a job's folder ends in the hash of everything that its result depends on. A changed configuration is
therefore a new job, and an interrupted run continues where it stopped. A folder holds `model.safetensors` (not for
calibrated rows), `made.json` (durations and versions) and `result.json`, which is written last.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Any

import msgspec
import torch

from gri.networks.model import ModelConfig
from gri.paper.rows import Row, Scenario
from gri.storage.verification import VALUE, is_intact, read_sealed, read_value, write_sealed
from gri.terminal import notice
from gri.training.optimisation import LATERAL_WEIGHT
from gri.training.train import TrainConfig, model_config

FIX = "give the same command again, which does it once more"
VERSION = 1
"""Version of the results. Raise it when the tests change: every job is then run again."""


@dataclass(frozen=True)
class SceneFile:
    """A file of recorded scenes."""

    path: Path
    digest: str
    """Start of the SHA-256 hash of its content."""


@dataclass(frozen=True)
class Job:
    """A row of a scenario, to be trained and tested with one seed."""

    scenario: Scenario
    row: Row
    config: TrainConfig | None
    """None for calibrated rows."""
    seed: int
    site: str | None = None
    """The recorded site whose scenes it is trained on; None: all scenes."""
    scene_file: SceneFile | None = None
    """Where the scenes of recorded scenarios are."""

    @property
    def name(self) -> str:
        config = self.config.name if self.config else f"{self.scenario.prefix}{self.row.suffix}"
        return f"{config}-s{self.seed}{f'-{self.site}' if self.site else ''}"

    def folder(self, cache: Path) -> Path:
        return cache / f"{self.name}-{hash_of(_dependencies(self))}"

    def is_done(self, cache: Path) -> bool:
        """Whether its result is there and undamaged."""
        return all(is_intact(self.folder(cache) / name, notice) for name in ("made.json", "result.json"))

    def result(self, cache: Path) -> dict[str, Any]:
        return read_sealed(self.folder(cache) / "result.json", FIX)

    def made(self, cache: Path) -> dict[str, Any]:
        """Seconds that training and tests took, and the versions used."""
        return read_sealed(self.folder(cache) / "made.json", FIX)

    @property
    def training(self) -> TrainConfig:
        """The training configuration of a row that is trained."""
        assert self.config is not None, f"{self.row.name} is calibrated, not trained"
        return self.config

    @property
    def model(self) -> ModelConfig:
        return model_config(self.training)


def scenarios_of(jobs: Sequence[Job]) -> list[Scenario]:
    """The scenarios of some jobs, in their order."""
    return list({job.scenario.name: job.scenario for job in jobs}.values())


def _dependencies(job: Job) -> list[Any]:
    """Everything that the result of a job depends on, in the order in which it is hashed."""
    scenario, scenes = job.scenario, job.scenario.recorded
    if scenes is None:
        data = job.training.data
        protocol = asdict(scenario.protocol)
        return [VERSION, job.config, data.scene_range, data.shares, protocol, job.seed, job.row.defined_types]
    digest = job.scene_file and job.scene_file.digest
    tested = [] if scenario.cross_validation is None else [*astuple(scenario.cross_validation), LATERAL_WEIGHT]
    trained_on = scenes if job.row.uses_reward else [scenes.kinds, scenes.steps, scenes.scale]
    return [VERSION, job.config, trained_on, job.seed, job.site, digest, job.row.defined_types, *tested]


def hash_of(content: Any) -> str:
    """Ten digits that change with the content."""
    return hashlib.sha256(msgspec.json.encode(content)).hexdigest()[:10]


def cached(cache: Path, name: str, content: Any, compute: Callable[[], Any]) -> Any:
    """A value that depends on the content alone: read from its file in the cache, or computed and written there."""
    path = cache / f"{name}-{hash_of(content)}.json"
    if not is_intact(path, notice):
        write_json(path, {VALUE: compute()})
    return read_value(path, FIX)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a sealed JSON file (`gri.storage`). Tensors become lists."""
    write_sealed(path, content, lambda tensor: torch.as_tensor(tensor).tolist())
