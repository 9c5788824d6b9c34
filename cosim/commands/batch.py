"""Commands about batches: run one, and list or compare its results."""

import os
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cosim.commands.arguments import FEWER_THAN_ASKED, AllowCodeOption, MaxWorkOption, SetOption
from gri.errors import InputError
from gri.terminal import FormatOption, ProgressDisplay, next_command, notice, say, show_tables

if TYPE_CHECKING:
    from cosim.batch.execute import Tally
    from cosim.batch.run_matrix import Run


BY_GROUPS = "perturbation,intensity,policy"


def batch(
    file: Annotated[str, typer.Argument(metavar="FILE", help="Name of a shipped batch, or path of a YAML file.")],
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check the file and list its runs; run nothing.")] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Runs at a time; default: one per core.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the batch; default: runs/batch/NAME.")] = None,
    executor: Annotated[
        Literal["local", "ray", "slurm"],
        typer.Option(help="Where to run: on this machine, on a Ray cluster, or as jobs of Slurm."),
    ] = "local",
    address: Annotated[str | None, typer.Option(help="Address of the Ray cluster; default: one started here.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Run only the run with this id; repeatable.")] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run again what has failed.")] = False,
    settings: SetOption = None,
    max_work: MaxWorkOption = None,
    allow_code: AllowCodeOption = False,
) -> None:
    """Run all runs of a batch file that are not finished.

    The same command continues a batch that was stopped. The exit code is 3 if all
    runs finished, some with fewer groups than asked for.
    """
    from msgspec.structs import replace

    from cosim.batch.run_matrix import expand, load_batch, refuse_foreign_code_of
    from cosim.spec.settings import overlay, settings_of

    spec, path = load_batch(file)
    if settings:
        spec = replace(spec, overrides=overlay(spec.overrides, settings_of(settings)))
    runs = _chosen(expand(spec, path, max_work), only or [])
    if only:
        spec = replace(spec, shards=None)  # single runs keep their folders, to be looked at
    if dry_run:
        for run in runs:
            say(f"{run.id}  {run.cell}")
        say(f"{len(runs)} runs, none started.")
        return next_command(f"cosim batch {file}")
    refuse_foreign_code_of(spec, path, allow_code)
    from cosim.batch.execute import execute
    from cosim.batch.store import BatchStore
    from cosim.process.worker_process import WorkerDeath, run_in_worker

    folder = out or Path("runs", "batch", path.stem)
    ended = set(BatchStore(folder).failures())
    with suppress(InputError):  # of a damaged shard, whose runs are done again
        ended |= BatchStore(folder).finished()
    if waiting := [run for run in runs if run.id not in ended]:
        # Whatever kills the check would kill the runs as well, which is what their retries and records are for.
        with suppress(WorkerDeath):  # what it prints is kept nowhere, so a killed command leaves nothing
            run_in_worker("cosim.batch.run_task:check_policies", waiting, log=Path(os.devnull), tell=lambda *_: None)
    say(f"{len(runs)} runs; results: {folder}")
    began = time.monotonic()
    how = _executor(executor, workers, address)
    try:
        with ProgressDisplay() as progress:

            def tell(tally: "Tally") -> None:
                progress("runs", tally.ended, tally.total, f"{tally.failed} failed" if tally.failed else "")

            tally = execute(spec, runs, BatchStore(folder), how, tell, file=path, retry=retry_failed, warn=notice)
    except KeyboardInterrupt:
        notice(f"stopped; finished runs are kept, `cosim batch {file}` continues")
        raise typer.Exit(130) from None
    say(f"{tally.done} of {tally.total} finished, {tally.failed} failed, {time.monotonic() - began:.0f} s.")
    if tally.left:
        notice(f"{tally.left} runs are not finished, because their records could not be written")
    if tally.failed or tally.left:
        next_command(f"cosim results {folder} --failures")
        raise typer.Exit(1)
    chosen = {run.id for run in runs}
    entries = [entry for entry in BatchStore(folder).manifest()["runs"] if entry["run"] in chosen]
    if few := sum(entry["starts"] < entry["asked"] for entry in entries):
        notice(f"{few} runs found fewer groups than asked for, because their time limit was reached")
        next_command(f"cosim results {folder} --runs")
        raise typer.Exit(FEWER_THAN_ASKED)
    next_command(f"cosim results {folder}")


def _chosen(runs: "tuple[Run, ...]", only: list[str]) -> "tuple[Run, ...]":
    if unknown := set(only) - {run.id for run in runs}:
        raise InputError(f"--only {min(unknown)}: the file has no run with this id; --dry-run lists them")
    return tuple(run for run in runs if not only or run.id in only)


def results(
    folder: Annotated[Path, typer.Argument(metavar="BATCH", help="The folder of a batch.")],
    where: Annotated[
        list[str],
        typer.Option(metavar="COLUMN=VALUE", help="Use only rows with this value, such as policy=idm; repeatable."),
    ] = [],  # noqa: B006
    by: Annotated[
        str, typer.Option(help="Columns to group by, separated by commas; with shares of the traffic: policy,share.")
    ] = BY_GROUPS,
    compare: Annotated[
        str | None, typer.Option(help="Compare two policies on the same starts, such as gri,idm.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="CSV file to write the selected groups to, one row each.")] = None,
    runs: Annotated[bool, typer.Option("--runs", help="List every run with its state.")] = False,
    failures: Annotated[bool, typer.Option("--failures", help="List the runs that failed, and why.")] = False,
    table_format: FormatOption = "table",
) -> None:
    """List, filter, compare or export the results of a batch.

    Of runs with a share of the traffic, the table has the figures of the traffic.
    """
    from cosim.batch import result_listing
    from cosim.batch.store import BatchStore
    from cosim.batch.traffic_results import DEFAULT_BY, has_traffic, traffic_rows, traffic_table

    store = BatchStore(folder)
    if failures:
        return show_tables([result_listing.failures_table(store)], table_format)
    if runs:
        return show_tables([result_listing.runs_table(store, where)], table_format)
    if has_traffic(store):
        if compare:
            raise InputError("--compare: these runs have shares of the traffic and no groups; use --by policy,share")
        rows = traffic_rows(store, where)
        if csv:
            rows.to_csv(csv, index=False)
            say(f"{len(rows)} rows: {csv}")
            return next_command(f"cosim report {folder}")
        table = traffic_table(rows, DEFAULT_BY if by == BY_GROUPS else by)
        return show_tables([table], table_format, then=f"cosim report {folder}")
    groups = result_listing.select_groups(store, where)
    if csv:
        groups.to_csv(csv, index=False)
        say(f"{len(groups)} groups: {csv}")
        return next_command(f"cosim report {folder}")
    table = result_listing.comparison_table(groups, compare) if compare else result_listing.overview_table(groups, by)
    show_tables([table], table_format, then=f"cosim report {folder}")


def _executor(name: str, workers: int | None, address: str | None):
    """What runs tasks: a function of a queue and a time limit [s]."""
    if name == "ray":
        from cosim.process.ray_pool import run_ray

        return partial(run_ray, workers=workers, address=address)
    if name == "slurm":
        from cosim.process.slurm_pool import run_slurm

        return partial(run_slurm, workers=workers)
    from cosim.process.task_pool import run_local

    return partial(run_local, workers=workers or os.cpu_count() or 1)
