"""The command `cosim cutin-grid`."""

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cosim.commands.arguments import AllowCodeOption
from gri.errors import InputError
from gri.terminal import FormatOption, ProgressDisplay, show_tables

if TYPE_CHECKING:
    from gri.reference_drivers.cut_in_grid import Grid

RANGE = "FROM:TO:STEP"


def cutin_grid(
    policy: Annotated[
        str,
        typer.Option(
            help="Drivers, separated by commas: r157, careful_human, careful_human_wandering, fsm, rss, idm,"
            " constant_velocity, gri (the scenario's checkpoint), names and paths of checkpoints (with +given: under"
            " the graph that the scene implies), or file.py:Name."
        ),
    ] = "r157,careful_human,fsm,rss,idm",
    grid: Annotated[
        Literal["low", "high", "both"], typer.Option(help="Speeds of the ego: 20 to 60, 70 to 130.")
    ] = "low",
    ego: Annotated[str, typer.Option(metavar=RANGE, help="Speeds of the ego [km/h] instead of the grid's.")] = "",
    other: Annotated[str, typer.Option(metavar=RANGE, help="Speeds of the vehicle that cuts in [km/h].")] = "",
    gap: Annotated[str, typer.Option(metavar=RANGE, help="Gaps at the start [m].")] = "",
    lateral: Annotated[str, typer.Option(metavar=RANGE, help="Lateral speeds [m/s].")] = "",
    scenario: Annotated[str, typer.Option(help="Scenario whose checkpoint is meant by gri.")] = "us101_merge",
    out: Annotated[Path | None, typer.Option(help="Folder for the cells and tables; default: none is written.")] = None,
    allow_code: AllowCodeOption = False,
    table_format: FormatOption = "table",
) -> None:
    """Let drivers meet a grid of cut-ins.

    The ego keeps its lane while a slower vehicle cuts in: ego speed, speed of the
    other, gap and lateral speed vary. Reference drivers of UN Regulation 157 and
    RSS show which collisions were preventable. They are benchmarks and certify
    nothing.
    """
    names = [name.strip() for name in policy.split(",") if name.strip()]
    if not names or len(set(names)) < len(names):
        raise InputError(f"--policy: got {policy!r}, expected names of drivers, each one once")
    if not allow_code and (code := [name for name in names if ":" in name]):
        raise InputError(f"--policy: {code[0]} is code that would be run; trust it with --allow-code, or leave it out")
    grids = _grids(grid, {"ego": ego, "other": other, "gap": gap, "lateral": lateral})
    from cosim.spec.loading import load_scenario
    from cosim.spec.scenario import TrainedPolicy

    named = load_scenario(scenario).policy
    from cosim.studies.cut_ins import collisions_table, driver_named, preventable_table, run_grid, write_cells

    began = time.monotonic()
    own = named.checkpoint if isinstance(named, TrainedPolicy) else "us101_merge"
    drivers = {name: driver_named(name, own) for name in names}
    with ProgressDisplay() as progress:
        results = [run_grid(name, cells, drivers, progress) for name, cells in grids.items()]
    tables = [make(result, names) for result in results for make in (collisions_table, preventable_table)]
    remarks = [f"{time.monotonic() - began:.0f} s."]
    if out is not None:
        remarks.append("Written: " + ", ".join(map(str, write_cells(results, tables, out))))
    show_tables(tables, table_format, *remarks, then="cosim cutin-grid --policy r157,fsm,gri --grid high")


def _grids(which: str, ranges: dict[str, str]) -> "dict[str, Grid]":
    """The grids by name: the usual ones, or one with own ranges."""
    from gri.reference_drivers.cut_in_grid import EGOS, GAPS, LATERALS, OTHERS, Grid

    kinds = ("low", "high") if which == "both" else (which,)
    given = {name: _range(name, text) for name, text in ranges.items() if text}
    if given and which == "both":
        raise InputError("--grid: got both with ranges of its own, expected low or high, whose other ranges are used")
    usual = {kind: {"ego": EGOS[kind], "other": OTHERS[kind], "gap": GAPS[kind], "lateral": LATERALS} for kind in kinds}
    return {("own" if given else kind): Grid.of(**(usual[kind] | given)) for kind in kinds}


def _range(name: str, text: str) -> tuple[float, ...]:
    """The numbers from FROM to TO, the end included; a single number stands for itself."""
    try:
        first, last, step = (
            ([float(part) for part in text.split(":")] * 3)[:3] if ":" not in text else map(float, text.split(":"))
        )
    except ValueError:
        raise InputError(f"--{name}: got {text!r}, expected {RANGE} or one number, such as 20:60:10") from None
    if not all(map(math.isfinite, (first, last, step))) or last < first or (step <= 0 and last > first):
        raise InputError(f"--{name}: got {text!r}, expected finite numbers FROM <= TO and a STEP above 0")
    count = 1 if last == first else int((last - first) / step + 1e-9) + 1
    if count > 10_000:
        raise InputError(f"--{name}: got {count} values, expected at most 10,000; use a greater STEP")
    return tuple(first + step * k for k in range(count))
