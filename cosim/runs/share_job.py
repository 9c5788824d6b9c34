"""One run in which policies drive shares of the traffic, from a scenario to a run folder. It runs in a worker process.

See `cosim.runs.traffic_run` for the door to it.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import torch

from cosim.loop.share_of_traffic import drive_shares
from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.runs import run_tables
from cosim.runs.finished_run import write_manifest
from cosim.runs.share_policies import share_plans
from cosim.runs.share_reading import SHARE_TABLES
from cosim.runs.share_tables import share_tables
from cosim.runs.space_time_figure import space_time_picture
from cosim.spec.input_files import input_files
from cosim.spec.scenario import Scenario
from cosim.spec.shares import driven_shares
from cosim.spec.sumo_models import SumoModel
from cosim.traffic.driver_model_types import with_model_types
from cosim.traffic.scratch_files import scratch_files
from cosim.traffic.simulation_input import prepare_simulation
from gri.errors import InputError


def run_share_job(
    scenario: Scenario,
    folder: Path,
    tell: Callable[..., None],
    *,
    labels: Mapping[str, Any] | None = None,
    draw: bool = True,
) -> None:
    """Run a scenario with shares, and write its tables, its manifest and a picture into an existing, empty folder.

    `labels` are constant columns in front of the `traffic` table; a batch says with them which run this is.

    Raises:
        InputError: the scenario cannot be run as it is.
    """
    torch.set_num_threads(1)  # the models are tiny: more threads are slower
    shares, plans, inputs = driven_shares(scenario), share_plans(scenario), input_files(scenario)
    models = {name: plan.drives for name, plan in plans.items() if isinstance(plan.drives, SumoModel) and plan.share}
    with scratch_files(inputs["net"], folder, folder / "sumo.log") as files:
        prepared = with_model_types(prepare_simulation(scenario, files, scenario.time_limit), models)
        prepared.write()
        outcome = drive_shares(prepared, plans, tell)
    if not len(outcome.recording.samples):
        raise InputError(
            f"traffic: no vehicle was in the study area within {scenario.time_limit:g} s after the warm-up; raise"
            " time_limit, or check road and flows"
        )
    tell("tables", 0, 1)
    tables = share_tables(
        outcome, {name: share for name, (_, share) in shares.items()}, scenario.road.length, outcome.merge
    )
    written = {name: tables[name] for name in (*SHARE_TABLES, *(["samples"] if scenario.surroundings else []))}
    written["traffic"] = run_tables.labelled(written["traffic"], labels or {})
    for name, table in written.items():
        table.to_parquet(folder / f"{name}.parquet", index=False)
    (folder / "scenario.json").write_bytes(msgspec.json.format(msgspec.json.encode(scenario)) + b"\n")
    facts = {
        "shares": {name: share for name, (_, share) in shares.items()},
        "seed": scenario.seed,
        "begin": outcome.begin,
        "end": outcome.end,
        "merge": outcome.merge,
        "traffic_perturbed": perturbed_traffic(scenario).traffic != scenario.traffic,
        "waiting_outside": outcome.backlog.waiting,
        "waiting_outside_since": outcome.backlog.since,
        "policy_failures": dict(outcome.failures),
    }
    write_manifest(folder, run_tables.manifest(facts, inputs, folder))
    if draw:
        title = ", ".join(f"{100 * share:g} % {name}" for name, (_, share) in shares.items())
        space_time_picture(tables["space_time"], folder / "space-time.png", title, tables["samples"], outcome.merge)
