"""One run from a scenario to a run folder; what `cosim run` does in its worker process."""

import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import torch

from cosim.runs import results
from cosim.loop.closed_loop import Files, run
from cosim.world.groups import expected_graph
from cosim.spec.input_files import find_net, input_files, sha256
from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.runs.policy_loading import driver_of
from cosim.runs.report import picture
from cosim.spec.scenario import Scenario, tag_of
from cosim.sumo import SumoError
from cosim.runs.traffic_survey import Survey, survey
from cosim.traffic.route_file import arguments
from gri.errors import InputError


def survey_job(scenario: Scenario, duration: float, tell: Callable[..., None]) -> Survey:
    """Survey the undisturbed traffic of a scenario."""
    net = find_net(scenario.net)
    with tempfile.TemporaryDirectory() as scratch:
        files = Files(net, Path(scratch, "routes.rou.xml"), Path(scratch, "sumo.log"))
        try:
            return survey(perturbed_traffic(scenario), files, duration, tell)
        except SumoError as error:
            raise InputError(f"SUMO refused the scenario: {error}") from error


def run_job(
    scenario: Scenario,
    folder: Path,
    tell: Callable[..., None],
    *,
    labels: Mapping[str, Any] | None = None,
    draw: bool = True,
) -> None:
    """Run the scenario and write its tables, manifest and (with `draw`) a picture into an existing folder.

    Labels, which say what the run is among others, become the first columns of the groups table.
    """
    torch.set_num_threads(1)  # the models are tiny: more threads are slower
    inputs, driver = input_files(scenario), driver_of(scenario)
    with tempfile.TemporaryDirectory() as scratch:
        files = Files(inputs["net"], Path(scratch, "routes.rou.xml"), folder / "sumo.log")
        try:
            outcome = run(scenario, files, driver, tell)
        except SumoError as error:
            raise InputError(f"SUMO refused the scenario: {error}") from error
        routes = sha256(files.routes)
    if not outcome.episodes:
        raise InputError(
            f"group: no group fits the rule within {scenario.time_limit:g} s; loosen its gaps or raise time_limit"
        )
    episodes = [*outcome.episodes, *([] if driver is None else outcome.left_to_sumo)]
    expected = expected_graph(scenario.group)
    tables = {
        "steps": results.steps_table(episodes),
        "groups": results.labelled(results.groups_table(episodes, expected), labels or {}),
        "events": results.events_table(episodes),
        "graphs": results.graphs_table(episodes),
    }
    results.write_tables(folder, tables)
    (folder / "scenario.json").write_bytes(msgspec.json.format(msgspec.json.encode(scenario)) + b"\n")
    run_facts = {
        "driver": tag_of(scenario.policy),
        "seed": scenario.seed,
        "episodes": scenario.episodes,
        "sumo_arguments": arguments(scenario, inputs["net"].name, "routes.rou.xml", "routes.signs.xml", "sumo.log"),
        "simulated_seconds": outcome.simulated,
        "infeasible_starts": dict(Counter(reason.value for _, reason in outcome.excluded)),
        "trunk_collision_steps": outcome.collisions,
        "trunk_teleports": outcome.teleports,
        "routes_sha256": routes,
    }
    results.write_manifest(folder, results.manifest(run_facts, inputs, folder))
    if draw:
        tell("picture", 0, 1)
        picture(tables, folder / "episode.png")
