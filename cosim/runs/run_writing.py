"""From the outcome of a run to its folder: tables, manifest and a picture."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from cosim.loop.closed_loop import Outcome
from cosim.loop.driving import Driver
from cosim.perturb.effects import Effect, effects_table
from cosim.runs import run_tables
from cosim.runs.finished_run import SCENARIO, write_manifest
from cosim.runs.surroundings_table import write_surroundings
from cosim.spec.scenario import Scenario, tag_of
from cosim.traffic.route_file import arguments
from cosim.world.group_search import why_not_more
from cosim.world.groups import expected_graph
from gri.errors import InputError


def write_run(
    scenario: Scenario,
    folder: Path,
    outcome: Outcome,
    driver: Driver | None,
    inputs: Mapping[str, Path],
    routes: str | None,
    tell: Callable[..., None],
    *,
    traffic_effects: Iterable[Effect],
    labels: Mapping[str, Any] | None,
    counterpart_labels: Mapping[str, Any] | None,
    draw: bool,
) -> None:
    """Write the tables, the manifest and a picture of a run into its folder.

    Args:
        scenario: what was run.
        folder: an existing folder.
        outcome: what came of it.
        driver: who drove; None where SUMO did.
        inputs: the files that the run depends on.
        routes: SHA-256 of the route file; None with routes of the user.
        tell: called with (stage, done, total).
        traffic_effects: what perturbations of the traffic reached.
        labels: constant columns to put in front of the groups table.
        counterpart_labels: the same for the counterparts table; by default `labels`.
        draw: whether to draw a picture of one episode.

    Raises:
        InputError: no group was found.
    """
    if not outcome.episodes:
        why = why_not_more(tag_of(scenario.group), outcome.search.seen, outcome.search.failed, scenario.group.size)
        raise InputError(
            f"group: no group fits the rule within {scenario.time_limit:g} s; loosen it or raise time_limit ({why})"
        )
    effects = effects_table([*outcome.effects, *traffic_effects])
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
