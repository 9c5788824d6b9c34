"""The Python door to runs in which policies drive shares of the traffic: `run_traffic`, `open_traffic_run`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd

from cosim.process.worker_process import run_in_worker
from cosim.runs.finished_run import has_file, read_manifest, verified_file
from cosim.runs.run_folder import next_folder, run_folder
from cosim.runs.share_reading import read_share_tables
from cosim.runs.share_summary import summary_table
from cosim.spec.input_files import refuse_foreign_code
from cosim.spec.loading import changed, find_file, load_scenario, override
from cosim.spec.scenario import Scenario
from cosim.spec.settings import settings_of
from cosim.spec.shares import driven_shares
from cosim.world.backlog import MANY_WAITING
from gri.errors import InputError
from gri.table import Table


@dataclass(frozen=True)
class TrafficRun:
    """A finished run with shares: its folder and its tables (columns and units: docs/reference/run-tables.md)."""

    folder: Path
    traffic: pd.DataFrame
    """One row for all vehicles, and one per driver: flow, speeds, safety, emissions."""
    vehicles: pd.DataFrame
    """One row per vehicle that was in the study area."""
    space_time: pd.DataFrame
    """One row per cell of space and time."""
    incidents: pd.DataFrame
    """Contacts, misplaced and stuck vehicles, policies that failed."""
    pair_graphs: pd.DataFrame
    """One row per inferred relation between a driven vehicle and the one ahead."""
    manifest: dict[str, Any]

    @cached_property
    def samples(self) -> pd.DataFrame | None:
        """All vehicles in the study area once a second; None where the scenario has `surroundings: false`."""
        if not has_file(self.folder, "samples.parquet"):
            return None
        return pd.read_parquet(verified_file(self.folder, "samples.parquet"))

    def summary(self) -> Table:
        """The table that `cosim run` prints."""
        return summary_table(self.traffic)

    def warnings(self) -> list[str]:
        """What a reader of the tables must know."""
        facts = self.manifest["arguments"]
        if facts["waiting_outside_since"] is None:
            return []
        return [
            f"{facts['waiting_outside']} vehicles wait outside the net at the end, {MANY_WAITING} or more since"
            f" {facts['waiting_outside_since']:g} s: the road cannot take the demand, so flows say what it can"
        ]

    @property
    def policy_failures(self) -> list[str]:
        """One line per policy that gave no usable answer; its vehicles were left to SUMO from then on."""
        return [f"{name}: {why}" for name, why in self.manifest["arguments"]["policy_failures"].items()]


def run_traffic(
    scenario: str | Path | Scenario,
    *,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
    settings: Sequence[str] = (),
    folder: str | Path | None = None,
    allow_code: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
) -> TrafficRun:
    """Run a scenario whose policies drive shares of the traffic, and return its tables.

    Args:
        scenario: name of a shipped scenario, path of a YAML file, or a `Scenario`.
        seed: replaces the scenario's seed.
        overrides: other top-level fields of the scenario to replace, such as `{"share": 0.4}`.
        settings: changes of single fields at any depth, such as `["share=0.4"]`; values are written as in YAML.
        folder: where to write the run; by default a new folder in `runs/`.
        allow_code: whether to run a policy (`kind: python`) that a scenario file names outside its own folder.
        progress: called with (stage, done, total) while the run goes on.

    Raises:
        InputError: the scenario or the folder does not fit; the message says what to change.
        RuntimeError: the simulation failed.

    Example:
        >>> import cosim
        >>> done = cosim.run_traffic("us101_share", overrides={"share": 0.4, "time_limit": 300})
        >>> done.traffic[["driver", "flow", "mean_speed", "contacts"]]
    """
    allowed = (overrides or {}).get("max_work")
    if isinstance(scenario, Scenario):
        chosen = changed(scenario, settings_of(settings)) if settings else scenario
    else:
        chosen = load_scenario(str(scenario), max_work=allowed, settings=settings)
        refuse_foreign_code(msgspec.to_builtins(chosen), find_file(str(scenario), "scenarios", "scenario"), allow_code)
    changes = {**({} if seed is None else {"seed": seed}), **(overrides or {})}
    chosen = override(chosen, changes)
    if not chosen.has_shares:
        raise InputError("share: got a scenario without share and shares; add share: 0.2, or call cosim.run for groups")
    name = chosen.net if isinstance(scenario, Scenario) else Path(scenario).stem
    parts = "-".join(f"{label}{100 * share:g}" for label, (_, share) in driven_shares(chosen).items())
    place = Path(folder) if folder else next_folder(Path("runs"), f"{Path(name).name}-{parts}-seed{chosen.seed}")
    with run_folder(place) as partial:
        run_in_worker(
            "cosim.runs.share_job:run_share_job",
            chosen,
            partial,
            log=partial / "sumo.log",
            tell=progress or (lambda *_: None),
        )
    return open_traffic_run(place)


def open_traffic_run(folder: str | Path) -> TrafficRun:
    """Read a finished run with shares from its folder. Raises `InputError` if it is none."""
    folder = Path(folder)
    return TrafficRun(folder, **read_share_tables(folder), manifest=read_manifest(folder))
