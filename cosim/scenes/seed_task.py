"""What a worker process does with one seed of a data set.

Light to import: without torch a process is small, and copies of it for interventions are cheap.
"""

from pathlib import Path

import msgspec

from cosim.scenes.scene_rules import DT
from cosim.scenes.seed_scenes import SeedSpec, SeedStatistics, extract_scenes
from cosim.spec.input_files import find_net
from cosim.sumo import SumoError
from cosim.traffic.scratch_files import scratch_folder
from gri.data.scene_file.schema import Header, writing
from gri.errors import InputError

SCENES, FIGURES = "scenes.parquet", "figures.json"


class SeedResult(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of a finished seed; `key` is the hash of everything that its scenes depend on."""

    key: str
    sha256: str
    """Hash of the file of its scenes."""
    figures: SeedStatistics
    cpu_seconds: float
    """[s] Of the process of the seed and its copies, without the start-up of the worker."""
    peak_mb: float
    """[MB] Resident memory of the process of the seed."""


def seed_task(folder: Path, spec: SeedSpec) -> SeedStatistics:
    """Write the scenes of one seed into its folder (the function of a `cosim.process.task.Task`).

    Errors: `InputError` where SUMO refuses the scenario.
    """
    try:
        with (
            scratch_folder(folder) as scratch,
            writing(folder / SCENES, Header(dt=DT, vehicles=spec.scenario.group.size)) as write,
        ):
            return extract_scenes(spec, find_net(spec.scenario.net), Path(scratch), write)
    except SumoError as error:
        raise InputError(f"SUMO refused the scenario: {error}") from error
