"""One chunk of a stress test: one simulation, and at each round one branch per cell and policy."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from msgspec.structs import replace

from cosim.loop.drive_effects import effects_of
from cosim.loop.driving import Driver, RoundStart, drive, start_round
from cosim.loop.intervention import Intervention
from cosim.loop.perturbed_round import plan_intervention
from cosim.loop.round_recorder import Round
from cosim.loop.trunk import Trunk
from cosim.loop.vehicles_ahead import SpeedRecord
from cosim.perturb.effects import Effect
from cosim.process.fork import CAN_FORK, fork
from cosim.runs.policy_loading import driver_of
from cosim.runs.traffic_effects import traffic_effects
from cosim.spec.input_files import find_net
from cosim.spec.scenario import Scenario
from cosim.stress.parts import write_part
from cosim.stress.plan import Cell, Chunk, perturbed_scenario, scenario_for
from cosim.stress.result_rows import result_row
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.scratch_files import scratch_files
from cosim.traffic.simulation_input import prepare_simulation
from cosim.traffic.warm_up import warm_up
from cosim.world.groups import Group, isolated
from cosim.world.snapshot import Snapshot
from gri.errors import InputError

PAUSE = 4  # times that the trunk looks for groups, once a second, and that are skipped after a round

Rows = list[dict[str, Any]]
EFFECT_COLUMNS = ["policy", "start", *(field.name for field in fields(Effect))]


def stress_chunk(chunk: Chunk, paths: Mapping[str, Path], facts: Mapping[str, Any], tell: Callable[..., None]) -> None:
    """Compute a chunk and write each of its parts to the path of its key, with `facts` (`cosim.stress.parts`).

    The wall-clock time [s] is shared evenly among the parts.
    """
    torch.set_num_threads(1)
    began, parts = time.monotonic(), chunk.parts
    place = next(iter(paths.values())).parent
    found, effects = chunk_rows(chunk, tell, place)
    effects += _effects_on_traffic(chunk, place)
    reached, rows = pd.DataFrame(effects, columns=EFFECT_COLUMNS), pd.DataFrame(found).assign(seed=chunk.scenario.seed)
    rows = rows.astype({"intensity": float})  # nominal rows only would give a column of objects
    seconds = round((time.monotonic() - began) / len(parts), 2)
    for part in parts:
        path, (name,) = paths[part.key], part.policies
        kind = part.cells[0].perturbation
        mine = rows[(rows["policy"] == name) & (rows["perturbation"] == kind)]
        of_mine = reached[(reached["policy"] == name) & (reached["perturbation"] == kind)]
        write_part(path, mine.assign(chunk=part.key), of_mine, {**facts, "seconds": seconds})


def _effects_on_traffic(chunk: Chunk, cache: Path) -> Rows:
    """The effects of a perturbation of the traffic, the same for every policy; none for other perturbations."""
    if chunk.unperturbed is None:
        return []
    whole = perturbed_scenario(replace(chunk.scenario, traffic=chunk.unperturbed), chunk.cells[0])
    effects = traffic_effects(whole, lambda *_: None, cache, cache)
    return [{"policy": name, "start": "", **asdict(effect)} for name in chunk.policies for effect in effects]


def chunk_rows(chunk: Chunk, tell: Callable[..., None], scratch: Path | None = None) -> tuple[Rows, Rows]:
    """One row per start, cell and policy, and one per effect of a perturbation on these starts.

    There are fewer starts than asked for where the scenario's time limit is reached before.

    Raises `InputError` if the traffic has no start at all, or without fork.
    """
    if not CAN_FORK:
        raise InputError("stress tests share one warm-up by forking the process, which this system cannot")
    scenario, rows, effects, starts = chunk.scenario, [], [], 0
    drivers = {name: driver_of(scenario_for(name, policy, scenario)) for name, policy in chunk.policies.items()}
    cells = {cell: perturbed_scenario(scenario, cell) for cell in chunk.cells}
    with scratch_files(find_net(scenario.net), scratch) as files:
        inputs = prepare_simulation(replace(scenario, perturbations=()), files, scenario.time_limit)
        inputs.write()
        with simulation(inputs) as running:
            trunk = Trunk(running, inputs.scenario, warm_up(running.world, inputs.scenario, lambda *_: None))
            while starts < chunk.starts and trunk.time < inputs.end:
                history = trunk.observe_history()
                found = trunk.find_groups(history, limit=chunk.starts - starts)
                if found.groups:
                    # The other sets would need branches of their own for every cell and policy.
                    this_round = dataclasses.replace(found, groups=isolated(found.groups, history[-1])[0])
                    starts += len(this_round.groups)
                    speeds = fork(lambda: trunk.leave_to_sumo(history, this_round)[1]).result()  # noqa: B023
                    driven, reached = round_rows(running, history, this_round, speeds, cells, drivers)
                    rows, effects = rows + driven, effects + reached
                    tell("starts", starts, chunk.starts)
                    for _ in range(PAUSE):
                        trunk.observe_history()
    if not starts:
        raise InputError(
            f"group: found no start within {scenario.time_limit:g} s (seed {scenario.seed}); loosen the gaps of the"
            " group rule or raise time_limit"
        )
    return rows, effects


def round_rows(
    running: RunningSimulation,
    history: Sequence[Snapshot],
    this_round: Round,
    speeds: SpeedRecord,
    cells: dict[Cell, Scenario],
    drivers: dict[str, Driver | None],
) -> tuple[Rows, Rows]:
    """The rows of one round and the effects of the perturbations, each cell and policy in a branch of its own.

    The vehicles ahead of the groups repeat the given speeds, which they have without perturbations and policies.
    """
    rows: Rows = []
    effects: Rows = []
    for cell, scenario in cells.items():
        intervention = plan_intervention(scenario, history[-1], this_round).repeating(speeds, history[-1])
        for name, driver in drivers.items():
            labels = {"policy": name, "perturbation": cell.perturbation, "intensity": cell.intensity}
            found = [_labels(group) | {"infeasible": reason.value} for group, reason in intervention.excluded]
            if intervention.round.groups:
                start = start_round(running.frame, history, intervention, driver)
                branch = fork(lambda: branch_rows(running, start, intervention, history[-1]))  # noqa: B023
                driven, reached = branch.result()
                found += driven
                effects += [{"policy": name, **effect} for effect in reached]
            rows += [labels | row for row in found]
    return rows, effects


def branch_rows(
    running: RunningSimulation, start: RoundStart, intervention: Intervention, before: Snapshot
) -> tuple[Rows, Rows]:
    """Drive a perturbed round and return its rows and the effects of the perturbation.

    This changes the simulation, so it runs in a branch.
    """
    episodes = drive(running.world, running.frame, start)
    driven, third_gone = start.round.driven_roles, intervention.removes_third
    until = max(episode.end for episode in episodes)
    trace = [now for now in intervention.snapshots if now.time <= until + 1e-6]
    rows = [
        _labels(episode.group) | {"infeasible": ""} | result_row(episode, change, before, trace, driven, third_gone)
        for episode, change in zip(episodes, intervention.changes, strict=True)
    ]
    reached = [
        {"start": " ".join(episode.group.ids), **asdict(effect)}
        for episode, effects in zip(episodes, effects_of(start, episodes), strict=True)
        for effect in effects
    ]
    return rows, reached


def _labels(group: Group) -> dict[str, Any]:
    return {"start": " ".join(group.ids), "takeover_time": group.time}
