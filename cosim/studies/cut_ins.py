"""Policies and reference drivers in the grid of cut-ins: their collisions, and which of them were preventable.

A collision is preventable if a reference driver has none in the same cell. `gri.reference_drivers` describes the grid.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from cosim.loop.graph_source import graph_from_source
from cosim.measures.statistics import Estimate, share
from cosim.runs.policy_loading import following_next_ahead
from cosim.runs.user_policy import own_policy
from cosim.spec.input_files import checkpoint_path
from cosim.spec.scenario import CarFollowing, GroundTruth, GroupRule, Merge, UserPolicy
from cosim.world.road_frame import NOMINAL_LENGTH
from gri import checkpoint
from gri.core.dynamics import DUBINS, DynamicsName
from gri.core.graph import LANE_CHANGING
from gri.core.merging_policy import MergingDriver
from gri.core.policy import ConstantVelocity, IntelligentDriver, Policy
from gri.errors import InputError
from gri.progress import Progress, no_progress
from gri.reference_drivers.cut_in_grid import RATE, Driven, Grid, drive_reference
from gri.reference_drivers.drivers import DRIVERS, DriverName
from gri.reference_drivers.policy_in_grid import check_policy, drive_policy
from gri.table import NBSP, Table

GIVEN = "+given"  # after the name of a checkpoint: under the graph that the scene implies
FOLLOWING = "+ahead"  # after the name of a checkpoint: it also follows whoever is next ahead in its lane
BENCHMARKS = (DriverName.R157, DriverName.CAREFUL_HUMAN, DriverName.FSM, DriverName.RSS)
NEEDLESS = 1.0  # [m/s]: slower by this beside a vehicle that stays in its lane is needless braking
Drive = Callable[[Grid], Driven]


@dataclass(frozen=True)
class GridResult:
    """The cells of a grid and what happened in each, by policy; the benchmarks are always among `driven`."""

    name: str
    grid: Grid
    driven: Mapping[str, Driven]

    def preventable(self, policy: str, benchmark: str) -> np.ndarray:
        """The cells in which the policy collides and the benchmark does not."""
        return self.driven[policy].collided & ~self.driven[benchmark].collided


def driver_named(name: str, gri_checkpoint: str) -> Drive:
    """A reference driver, `idm`, `constant_velocity`, a checkpoint, `gri` (`gri_checkpoint`), or "file.py:Name".

    After a checkpoint's name GIVEN tells it the graph, and `FOLLOWING` (at the end) lets it follow who is next ahead.

    Raises:
        InputError: there is no such policy, or it cannot drive in the grid.
    """
    if name in DRIVERS:
        return partial(drive_reference, DRIVERS[DriverName(name)])
    if name == "idm":
        return partial(drive_policy, MergingDriver(IntelligentDriver(1 / RATE, length=NOMINAL_LENGTH)))
    if name == "constant_velocity":
        return partial(drive_policy, ConstantVelocity(1 / RATE, DUBINS))
    if name == "sumo":
        raise InputError("--policy: got sumo, but there is no SUMO in the grid of cut-ins; leave it out")
    if ":" in name:
        policy: Policy = own_policy(UserPolicy(object=name), 1 / RATE)
        check_policy(policy)
        return partial(drive_policy, policy)
    by_graph = name.removesuffix(FOLLOWING)
    wanted = by_graph.removesuffix(GIVEN)
    path = checkpoint_path(gri_checkpoint if wanted == "gri" else wanted, "--policy")
    model = checkpoint.load(path)
    check_policy(model)
    policy = model if by_graph == name else following_next_ahead(model, path)
    if not by_graph.endswith(GIVEN):
        return partial(drive_policy, policy)
    planar = model.dynamics.name is DynamicsName.DUBINS and model.config.vocabulary == LANE_CHANGING
    rule: GroupRule = Merge(lane="_0", zone=(0, 1)) if planar else CarFollowing()
    return partial(drive_policy, policy, change_graph=partial(graph_from_source, source=GroundTruth(), rule=rule))


def run_grid(name: str, grid: Grid, drivers: Mapping[str, Drive], progress: Progress = no_progress) -> GridResult:
    """Drive a grid by all drivers, and by the benchmarks."""
    missing = {b.value: partial(drive_reference, DRIVERS[b]) for b in BENCHMARKS if b.value not in drivers}
    driven: dict[str, Driven] = {}
    everybody = {**drivers, **missing}
    for k, (policy, drive) in enumerate(everybody.items()):
        driven[policy] = drive(grid)
        progress(f"grid {name}", k + 1, len(everybody), 0.0)
    return GridResult(name, grid, driven)


def cells_table(results: Sequence[GridResult]) -> pd.DataFrame:
    """One row per grid, policy and cell: speeds [km/h], gap [m], lateral speed [m/s], collision, speed lost [m/s]."""
    return pd.concat(
        [
            pd.DataFrame(
                {
                    "grid": result.name,
                    "policy": policy,
                    "ego_speed": result.grid.ego,
                    "other_speed": result.grid.other,
                    "gap": result.grid.gap,
                    "lateral_speed": result.grid.lateral,
                    "collision": driven.collided,
                    "speed_lost": driven.slowed,
                }
            )
            for result in results
            for policy, driven in result.driven.items()
        ],
        ignore_index=True,
    )


def collisions_table(result: GridResult, policies: Sequence[str]) -> Table:
    """Collisions of each policy, in all cells and by ego speed, and where it brakes for nothing."""
    speeds = np.unique(result.grid.ego).tolist()
    stays = result.grid.lateral == 0
    head = ["policy", "collisions", *(f"{speed:g} km/h" for speed in speeds), "brakes for nothing"]
    lines, records = [], []
    for policy in policies:
        driven = result.driven[policy]
        by_speed = [int(driven.collided[result.grid.ego == speed].sum()) for speed in speeds]
        needless = int((driven.slowed[stays] > NEEDLESS).sum())
        shown = f"{needless}/{int(stays.sum())}" if stays.any() else "-"
        lines.append([policy, f"{int(driven.collided.sum()):,}", *(f"{n:,}" for n in by_speed), shown])
        records += [
            {"grid": result.name, "policy": policy, "ego_speed": speed, "collisions": n, "cells": int(cells)}
            for speed, n in zip(speeds, by_speed, strict=True)
            if (cells := (result.grid.ego == speed).sum())
        ]
    title = f"Collisions in the grid of cut-ins, {result.name}: {len(result.grid):,} cells, by speed of the ego"
    note = (
        f"Brakes for nothing: cells in which the other stays in its lane and the ego gets more than {NEEDLESS:g} m/s"
        " slower. Benchmark drivers are models for comparison; they certify nothing."
    )
    return Table(f"collisions_{result.name}", head, lines, records, title, note)


def preventable_table(result: GridResult, policies: Sequence[str]) -> Table:
    """Preventable collisions of each policy: share of all cells, with 95 % intervals over pairs of speeds."""
    head = ["policy", *(f"not by {benchmark} [%]" for benchmark in BENCHMARKS)]
    lines, records = [], []
    pair = result.grid.ego * 1000 + result.grid.other
    for policy in policies:
        line = [policy]
        for benchmark in map(str, BENCHMARKS):
            happened = result.preventable(policy, benchmark)
            estimate = share(happened, pair)
            line.append("-" if policy == benchmark else f"{int(happened.sum()):,} ({_percent(estimate)})")
            records.append(
                {"grid": result.name, "policy": policy, "benchmark": benchmark, "preventable": int(happened.sum())}
                | {"share": estimate.value, "low": estimate.low, "high": estimate.high, "cells": estimate.n}
            )
        lines.append(line)
    title = f"Preventable collisions, {result.name}: cells in which the policy collides and a benchmark driver does not"
    note = "Percent of all cells [95 % interval, pairs of speeds as clusters]."
    return Table(f"preventable_{result.name}", head, lines, records, title, note)


def _percent(estimate: Estimate) -> str:
    value, low, high = (f"{100 * x:.1f}" for x in (estimate.value, estimate.low, estimate.high))
    return value if np.isnan(estimate.low) else f"{value}{NBSP}[{low},{NBSP}{high}]"


def write_cells(results: Sequence[GridResult], tables: Sequence[Table], folder: Path) -> list[Path]:
    """Write the cells (Parquet and CSV) and the tables (CSV) to a folder; returns the files."""
    from gri.table import csv_text

    folder.mkdir(parents=True, exist_ok=True)
    cells = cells_table(results)
    files = [folder / "cells.parquet", folder / "cells.csv"]
    cells.to_parquet(files[0], index=False)
    cells.to_csv(files[1], index=False, float_format="%.6g")
    for table in tables:
        files.append(folder / f"{table.name}.csv")
        files[-1].write_text(csv_text(table), encoding="utf-8")
    return files
