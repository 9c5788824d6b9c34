"""One run from a scenario to a run folder. It runs in a worker process: see `cosim.runs.run`."""

import json
from collections import Counter
from collections.abc import Callable, Mapping
from inspect import getsourcefile
from pathlib import Path
from typing import Any

import msgspec
import torch

from cosim.loop.closed_loop import run
from cosim.perturb.effects import effects_table
from cosim.runs import run_tables
from cosim.runs.finished_run import SCENARIO, write_manifest
from cosim.runs.policy_loading import driver_of
from cosim.runs.shared_warm_up import SharedWarmUp
from cosim.runs.surroundings_table import write_surroundings
from cosim.runs.traffic_effects import traffic_effects
from cosim.runs.traffic_survey import Survey, survey
from cosim.spec.input_files import find_net, input_files, sha256
from cosim.spec.scenario import LeftToSumo, Scenario, tag_of
from cosim.traffic.route_file import arguments
from cosim.traffic.scratch_files import scratch_files
from cosim.world.group_search import why_not_more
from cosim.world.groups import expected_graph
from gri.core.policy import Policy
from gri.errors import InputError


def survey_job(scenario: Scenario, duration: float, tell: Callable[..., None]) -> Survey:
    """Survey the undisturbed traffic of a scenario."""
    with scratch_files(find_net(scenario.net)) as files:
        return survey(scenario, files, duration, tell)


def run_job(
    scenario: Scenario,
    folder: Path,
    tell: Callable[..., None],
    *,
    labels: Mapping[str, Any] | None = None,
    counterpart_labels: Mapping[str, Any] | None = None,
    draw: bool = True,
    policy: Policy | None = None,
    prepared: SharedWarmUp | None = None,
) -> None:
    """Run a scenario and write its tables, its manifest and a picture into an existing folder.

    Args:
        scenario: what to run.
        folder: an existing, empty folder.
        tell: called with (stage, done, total).
        labels: constant columns to put in front of the groups table; a batch says with them which run this is.
        counterpart_labels: the same for the counterparts table; by default `labels`.
        draw: whether to draw a picture of one episode.
        policy: a policy object that takes the place of the one that the scenario names.
        prepared: the traffic at the end of the warm-up, in a copy of the process that runs it.

    Raises:
        InputError: the scenario cannot be run as it is.
    """
    torch.set_num_threads(1)  # the models are tiny: more threads are slower
    inputs, driver = _inputs(scenario, policy), driver_of(scenario, policy)
    with scratch_files(inputs["net"], folder, folder / "sumo.log") as files:
        if prepared is None:
            outcome = run(scenario, files, driver, tell)
        else:
            outcome = prepared.run(scenario, files.log, driver, tell)
        effects = effects_table([*outcome.effects, *traffic_effects(scenario, tell, scratch=folder)])
        routes = (
            None if scenario.traffic.has_own_files else prepared.routes_sha256 if prepared else sha256(files.routes)
        )
    if not outcome.episodes:
        why = why_not_more(tag_of(scenario.group), outcome.search.seen, outcome.search.failed, scenario.group.size)
        raise InputError(
            f"group: no group fits the rule within {scenario.time_limit:g} s; loosen it or raise time_limit ({why})"
        )
    episodes, counterparts = outcome.episodes, () if driver is None else outcome.left_to_sumo
    expected = expected_graph(scenario.group)
    groups = run_tables.groups_table(episodes, expected, outcome.left_to_sumo)
    left = (
        run_tables.groups_table(counterparts, expected)
        if counterparts
        else groups.iloc[:0].drop(columns="leader_deviation")
    )
    tables = {
        "steps": run_tables.steps_table(episodes, counterparts),
        "groups": run_tables.labelled(groups, labels or {}),
        "counterparts": run_tables.labelled(left, counterpart_labels or labels or {}),
        "events": run_tables.events_table(episodes, counterparts),
        "graphs": run_tables.graphs_table(episodes),
    }
    run_tables.write_tables(folder, tables)
    if scenario.surroundings:
        write_surroundings(folder, outcome.episodes, [] if driver is None else outcome.left_to_sumo)
    (folder / SCENARIO).write_bytes(msgspec.json.format(msgspec.json.encode(scenario)) + b"\n")
    run_facts = {
        "driver": tag_of(scenario.policy) if driver is None else driver.name,
        "seed": scenario.seed,
        "episodes": scenario.episodes,
        "sumo_arguments": _sumo_arguments(scenario, inputs),
        "simulated_seconds": outcome.simulated,
        "infeasible_starts": dict(Counter(reason.value for _, reason in outcome.excluded)),
        "starts": len(outcome.episodes),
        "candidates_seen": outcome.search.seen,
        "candidates_failed": dict(outcome.search.failed),
        "trunk_collision_steps": outcome.trunk.collision_steps,
        "trunk_teleports": outcome.trunk.teleports,
        "branch_collision_steps": outcome.branches.collision_steps,
        "branch_teleports": outcome.branches.teleports,
        "waiting_outside": outcome.backlog.waiting,
        "waiting_outside_since": outcome.backlog.since,
        "routes_sha256": routes,
    }
    manifest = run_tables.manifest(run_facts, inputs, folder)
    write_manifest(folder, manifest | {"effects": json.loads(effects.to_json(orient="records"))})
    if draw:
        from cosim.runs.episode_figure import picture  # with all of matplotlib; a batch draws nothing

        tell("picture", 0, 1)
        picture(tables, folder / "episode.png", folder=folder)
        tell("picture", 1, 1)


def _sumo_arguments(scenario: Scenario, inputs: Mapping[str, Path]) -> list[str]:
    """SUMO's arguments with the names of the files, without their folders."""
    routes, additional = "routes.rou.xml", "routes.signs.xml"
    if scenario.traffic.has_own_files:
        routes, additional = (
            ",".join(path.name for what, path in inputs.items() if what.startswith(f"{kind}."))
            for kind in ("routes", "additional")
        )
    return arguments(scenario, inputs["net"].name, routes, additional, "sumo.log")


def _inputs(scenario: Scenario, policy: Policy | None) -> dict[str, Path]:
    """The files that the run depends on; for a policy object, the file of its class where there is one."""
    if policy is None:
        return input_files(scenario)
    files = input_files(msgspec.structs.replace(scenario, policy=LeftToSumo()))
    try:
        source = Path(getsourcefile(type(policy)) or "")
    except (TypeError, OSError):  # a class that was typed into a notebook
        return files
    return {**files, "policy": source} if source.is_file() else files
