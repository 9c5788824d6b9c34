"""A whole stress test: run its chunks in worker processes, then write tables, figures and the report."""

import multiprocessing
import platform
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from cosim.batch.group_statistics import cluster_note
from cosim.perturb.effects import KEY, pooled
from cosim.process.worker_process import GRACE, run_in_worker
from cosim.spec.input_files import checkpoint_path, find_net, sha256
from cosim.spec.scenario import Merge, Scenario, TrainedPolicy
from cosim.stress import estimates, figures
from cosim.stress.parts import FIX, is_finished, read_part
from cosim.stress.plan import NOMINAL, PACKAGES, Cell, Chunk
from cosim.stress.preventable import preventable
from cosim.stress.report import stress_report
from cosim.stress.result_rows import compared_with_sumo
from cosim.world.outcome_columns import with_outcome_columns
from gri.errors import InputError, guarded_reading
from gri.processes import end_group
from gri.storage.verification import check_digest, digest, read_sealed, write_sealed
from gri.storage.whole_files import sweep, whole_file, write_whole

Tell = Callable[[str, int, int], None]
Warn = Callable[[str], None]
FACTS = "stress.json"
RENAMED = {"taken_at": "takeover_time", "driven_for": "drive_duration"}  # columns of version 0.1


@dataclass(frozen=True)
class Computation:
    """How the rows were computed: wall-clock time summed over workers [s], and the commits of the source trees.

    `effects` are the effects of the perturbations, pooled by policy, kind, intensity and quantity.
    """

    worker_seconds: float
    commits: list[str]
    effects: pd.DataFrame


def run_stress(
    chunks: Sequence[Chunk], folder: Path, workers: int, tell: Tell, warn: Warn = lambda text: None
) -> tuple[pd.DataFrame, Computation]:
    """The rows of all chunks in their order, and how they were computed.

    Finished parts in `folder`, which nobody else may use meanwhile, are reused. `tell` is called with "starts", the
    starts driven and all starts, `warn` with a sentence about each finished part that is damaged and computed again.
    """
    results = folder / "chunks"
    results.mkdir(parents=True, exist_ok=True)
    sweep(results)
    paths = {part.key: results / f"{part.key}.parquet" for chunk in chunks for part in chunk.parts}
    missing = {chunk.key: [part for part in chunk.parts if not is_finished(paths[part.key], warn)] for chunk in chunks}
    starts = {chunk.key: 0 if missing[chunk.key] else chunk.starts for chunk in chunks}
    total, facts = sum(chunk.starts for chunk in chunks), {"commit": _commit()}
    tell("starts", sum(starts.values()), total)

    def compute(chunk: Chunk) -> None:
        def progress(_: str, done: int, __: int) -> None:
            starts[chunk.key] = done
            tell("starts", sum(starts.values()), total)

        wanted, log = chunk.covering(missing[chunk.key]), results / f"{chunk.key}.log"
        run_in_worker("cosim.stress.chunk:stress_chunk", wanted, paths, facts, log=log, tell=progress)

    with ThreadPoolExecutor(workers) as pool:
        _finish([pool.submit(compute, chunk) for chunk in chunks if missing[chunk.key]])
    found = {key: read_part(path) for key, path in paths.items()}
    rows = pd.concat([_rows(chunk, {key: part[0] for key, part in found.items()}) for chunk in chunks])
    rows = rows.reset_index(drop=True)
    records = [facts for _, _, facts in found.values()]
    effects = pd.concat([reached for _, reached, _ in found.values()])
    effects = effects.fillna({"unit": "", "remark": "", "start": ""})
    return compared_with_sumo(rows), Computation(
        sum(part["seconds"] for part in records),
        sorted({part["commit"] for part in records}),
        pooled(effects, ["policy", *KEY]),
    )


def fewer_starts(chunks: Sequence[Chunk], rows: pd.DataFrame) -> str:
    """A sentence about the cells that have fewer starts than asked for; "" if there are none."""
    asked: dict[Cell, int] = {}
    for chunk in chunks:
        for cell in chunk.cells:
            asked[cell] = asked.get(cell, 0) + chunk.starts
    of_one = rows[rows["policy"] == next(iter(chunks[0].policies))]
    short = []
    for cell, wanted in asked.items():
        graded = of_one["intensity"].isna() if cell.intensity is None else of_one["intensity"].eq(cell.intensity)
        found = int((of_one["perturbation"].eq(cell.perturbation) & graded).sum())
        if found < wanted:
            name = cell.perturbation if cell.intensity is None else f"{cell.perturbation} {cell.intensity:g}"
            short.append(f"{name}: {found} of {wanted}")
    limit = f"{chunks[0].scenario.time_limit:g} s"
    return f"Fewer starts than asked for within the time limit of {limit}: {'; '.join(short)}." if short else ""


def _rows(chunk: Chunk, parts: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """The rows of a chunk's parts, in the order of its cells and policies."""
    rows = pd.concat([parts[part.key] for part in chunk.parts], ignore_index=True)
    cells = {(cell.perturbation, cell.intensity): k for k, cell in enumerate(chunk.cells)}
    graded = zip(rows["perturbation"], rows["intensity"], strict=True)
    order = pd.Series([cells[kind, None if np.isnan(x) else x] for kind, x in graded])
    return rows.loc[order.sort_values(kind="stable").index]


def _finish(futures: Sequence[Future[None]]) -> None:
    """Wait for all; at the first failure, or at Ctrl-C, end the workers of the others."""
    try:
        wait(futures, return_when="FIRST_EXCEPTION")  # each has its limits: see `run_in_worker`
        for future in futures:
            if future.done():
                future.result()
    except BaseException:
        running = [future for future in futures if not future.cancel()]
        patience = time.monotonic() + GRACE
        while wait(running, timeout=0.2).not_done:  # repeatedly, because one may be about to start its worker
            for process in multiprocessing.active_children():
                end_group(process, signal.SIGTERM if time.monotonic() < patience else signal.SIGKILL)
        raise


def publish(
    chunks: Sequence[Chunk],
    rows: pd.DataFrame,
    effects: pd.DataFrame,
    folder: Path,
    facts: dict[str, Any],
    decided: str = "",
    fewer: str = "",
) -> list[Path]:
    """Write rows, counts, estimates, differences, effects, figures and report to `folder`; returns the files.

    `facts` is written to `stress.json`, together with what is needed to compute the rows again. `decided` is the result
    of a sequential test, `fewer` what `fewer_starts` says.
    """
    (folder / FACTS).unlink(missing_ok=True)
    said = {"decided": decided, "fewer_starts": fewer}
    files = write_results(rows, effects, chunks[0].scenario, folder, *said.values())
    _write_facts(folder, facts | {name: text for name, text in said.items() if text} | provenance(chunks))
    return [*files, folder / FACTS]


def _write_facts(folder: Path, facts: Mapping[str, Any]) -> None:
    """Write how the tables were made, with their hashes."""
    write_sealed(folder / FACTS, {**facts, "results": {path.name: digest(path) for path in _tables_in(folder)}})


def _tables_in(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.parquet"))


def write_results(
    rows: pd.DataFrame,
    effects: pd.DataFrame | None,
    scenario: Scenario,
    folder: Path,
    decided: str = "",
    fewer: str = "",
    *,
    draw: bool = True,
) -> list[Path]:
    """Write the tables of the rows (Parquet and CSV), the figures and the report to `folder`; returns the files.

    `effects` are those of the perturbations; tests of version 0.1 have none.
    """
    kinds = [kind for kind in dict.fromkeys(rows["perturbation"]) if kind != NOMINAL]
    tables = {
        "counts": estimates.counts(rows),
        "estimates": estimates.estimates(rows),
        "differences": estimates.differences(rows),
        **({} if effects is None else {"effects": effects}),
        **({"preventable": prevented} if len(prevented := preventable(rows)) else {}),
    }
    for name, table in {"episodes": rows, **tables}.items():
        with whole_file(folder / f"{name}.parquet") as file:
            table.to_parquet(file, index=False)
    for name, table in tables.items():
        with whole_file(folder / f"{name}.csv") as file:
            table.to_csv(file, index=False)
    if draw:
        figures.draw(tables["estimates"], kinds, folder / "figures", lane_changes=isinstance(scenario.group, Merge))
    drawn = sorted((folder / "figures").glob("*.[ps][nv]g"))
    title = f"Stress test: {scenario.description or scenario.net}"
    shown = (tables["counts"], tables["estimates"], tables["differences"])
    text = stress_report(
        title, *shown, kinds, {path.stem for path in drawn}, cluster_note(rows), [decided, fewer], effects, prevented
    )
    report = folder / "stress.md"
    write_whole(report, text)
    return [report, folder / "episodes.parquet", *(folder / f"{name}.parquet" for name in tables), *drawn]


def publish_again(folder: Path, *, draw: bool = True) -> list[Path]:
    """Write the tables, figures and report of a finished stress test again, from its rows; returns the files.

    Rows of version 0.1 get the outcome columns from what they know.

    Raises:
        InputError: the folder is none of a stress test, or its tables are not what was written.
    """
    rows, facts = folder / "episodes.parquet", folder / FACTS
    if not rows.is_file() or not facts.is_file():
        raise InputError(
            f"{folder}: no episodes.parquet and stress.json in it; give a folder that `cosim stress` wrote"
        )
    content = read_sealed(facts, FIX)
    for name, wanted in content.get("results", {}).items():
        check_digest(folder / name, wanted, FIX)
    with guarded_reading(facts, "file of a stress test", FIX):
        scenario = msgspec.convert(content["scenario"], Scenario)
    table = with_outcome_columns(pd.read_parquet(rows).rename(columns=RENAMED))
    known = folder / "effects.parquet"
    effects = pd.read_parquet(known) if known.is_file() else None
    said = [content.get(name, "") for name in ("decided", "fewer_starts")]
    files = write_results(table, effects, scenario, folder, *said, draw=draw)
    if "results" in content:
        _write_facts(folder, content)
    return files


def provenance(chunks: Sequence[Chunk]) -> dict[str, Any]:
    """Everything that is needed to compute the same rows again."""
    trained = {name: driver for name, driver in chunks[0].policies.items() if isinstance(driver, TrainedPolicy)}
    return {
        "seeds": sorted({chunk.scenario.seed for chunk in chunks}),
        "scenario": msgspec.to_builtins(chunks[0].scenario),
        "policies": msgspec.to_builtins(chunks[0].policies),
        "cells": [f"{c.perturbation} {c.intensity}" for c in dict.fromkeys(c for chunk in chunks for c in chunk.cells)],
        "net_sha256": sha256(find_net(chunks[0].scenario.net)),
        "checkpoint_sha256": {name: sha256(checkpoint_path(driver.checkpoint)) for name, driver in trained.items()},
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    }


def _commit() -> str:
    """The commit of the source tree; "unknown" outside a git repository."""
    try:
        found = subprocess.run(
            ["git", "rev-parse", "HEAD"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return found.stdout.strip()
