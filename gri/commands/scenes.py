"""The commands `gri scenes`: report on recordings of any layout, and cut scenes out of them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gri.commands.ngsim import (
    ORDER,
    SPACING,
    TRAINING_STRIDE,
    WINDOW,
    SiteOption,
    rejection_table,
    report_tables,
    scene_table,
)
from gri.table import Table
from gri.terminal import FormatOption, ProgressDisplay, finite, next_command, notice, say, show_tables

if TYPE_CHECKING:
    from gri.data.recordings.parts import ReadingOptions
    from gri.data.recordings.scenes import Report

app = typer.Typer(
    no_args_is_help=True, rich_markup_mode=None, help="Check recordings of any layout and cut scenes out of them."
)

FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="A recording: a file, folder or zip; NGSIM, highD, exiD, SUMO's FCD, …")
]
LayoutOption = Annotated[
    str | None,
    typer.Option(
        help="Layout, if it is not recognised: ngsim, highd, exid, interaction, tgsim, i24, sumo_fcd, run, tidy."
    ),
]
MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="COLUMN=NAME",
        help="Name of a column of the tidy table in the file, or NAME*FACTOR; repeatable.",
    ),
]
AxisOption = Annotated[
    tuple[float, float, float, float] | None,
    typer.Option(
        metavar="X0 Y0 X1 Y1",
        callback=finite,
        help="Two points of a straight road in the plane, in driving direction [m]; default: estimated from the paths.",
    ),
]
EdgesOption = Annotated[
    str | None,
    typer.Option(help="Lateral positions of the lines between lanes [m], such as -3.5,-7; default: estimated."),
]
PointOption = Annotated[
    Literal["front", "centre", "rear"] | None,
    typer.Option(help="Point of a vehicle that positions refer to; default: that of the layout."),
]
TypesOption = Annotated[
    Path | None, typer.Option(help="For SUMO's FCD: route or additional file with the vehicle types, for lengths.")
]


@app.command(name="inspect")
def inspect_command(
    file: FileArgument,
    site: SiteOption = None,
    layout: LayoutOption = None,
    columns: MapOption = None,
    axis: AxisOption = None,
    lane_edges: EdgesOption = None,
    point: PointOption = None,
    types: TypesOption = None,
    table_format: FormatOption = "table",
) -> None:
    """Report what a recording holds: vehicles, classes, defects."""
    from gri.data.recordings.scenes import inspect_file

    options = _options(layout, columns, site, axis, lane_edges, point, types)
    with ProgressDisplay() as progress:
        report = inspect_file(file, options, progress)
    for note in report.notes:
        notice(f"note: {note}")
    tables = [*report_tables(report.recordings, report.unreadable), class_table(report)]
    show_tables(tables, table_format, f"layout: {report.layout}", then=f"gri scenes make {file}")


@app.command()
def make(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Recordings of one layout.")],
    out: Annotated[Path, typer.Option(help="Scene file to write.")] = Path("runs/scenes/recorded.parquet"),
    site: SiteOption = None,
    layout: LayoutOption = None,
    columns: MapOption = None,
    axis: AxisOption = None,
    lane_edges: EdgesOption = None,
    point: PointOption = None,
    types: TypesOption = None,
    split: Annotated[
        Literal["by-number", "all-test"],
        typer.Option(help="Splits by vehicle number (70 % training), or every scene for testing."),
    ] = "by-number",
    window: Annotated[int, typer.Option(help="Width of the smoothing filter in frames of 0.1 s; odd.")] = WINDOW,
    order: Annotated[int, typer.Option(help="Degree of the polynomial of the filter.")] = ORDER,
    spacing: Annotated[float, typer.Option(callback=finite, help="Greatest distance to the leader [m].")] = SPACING,
    training_stride: Annotated[
        int, typer.Option(help="Steps of 0.2 s between training scenes of the same three vehicles.")
    ] = TRAINING_STRIDE,
    table_format: FormatOption = "table",
) -> None:
    """Cut car-following and lane-changing scenes out of recordings."""
    from gri.data.ngsim.rules import Rules
    from gri.data.ngsim.smoothing import Smoothing
    from gri.data.recordings.scenes import ALL_TEST, make_scenes

    options = _options(layout, columns, site, axis, lane_edges, point, types)
    rules = Rules(
        smoothing=Smoothing(window=window, order=order),
        spacing=spacing,
        training_stride=training_stride,
        block=ALL_TEST if split == "all-test" else Rules().block,
    ).checked()
    with ProgressDisplay() as progress:
        made, notes = make_scenes(files, out, rules, options, progress)
    for note in notes:
        notice(f"note: {note}")
    show_tables(
        [scene_table(made), *([rejection_table(made)] if made.rejected.total() else [])],
        table_format,
        f"{sum(made.scenes.values())} scenes in {out}",
        then=f"gri evaluate ngsim_car_following --scene-file {out}"
        if split == "all-test"
        else f"gri train ngsim_car_following --scene-file {out}",
    )


@app.command()
def tidy(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Recordings of any layout.")],
    out: Annotated[Path, typer.Option(help="File to write: Parquet, or text if it ends in .csv.")],
    layout: LayoutOption = None,
    columns: MapOption = None,
    axis: AxisOption = None,
    lane_edges: EdgesOption = None,
    point: PointOption = None,
    types: TypesOption = None,
) -> None:
    """Write recordings as a tidy table.

    It can be read without options, by these commands, cosim realism and replay.
    """
    from gri.data.recordings.scenes import write_tidy

    options = _options(layout, columns, None, axis, lane_edges, point, types)
    with ProgressDisplay() as progress:
        *notes, written = write_tidy(files, out, options, progress)
    for note in notes:
        notice(f"note: {note}")
    say(written)
    next_command(f"cosim realism us101_car_following --against {out}")


def _options(
    layout: str | None,
    columns: list[str] | None,
    site: str | None,
    axis: tuple[float, float, float, float] | None,
    lane_edges: str | None,
    point: Literal["front", "centre", "rear"] | None,
    types: Path | None,
) -> "ReadingOptions":
    from gri.data.recordings.names import read_edges, read_map
    from gri.data.recordings.parts import ReadingOptions

    return ReadingOptions(
        layout=layout,
        columns=read_map(columns or []),
        site=site,
        axis=axis,
        lane_edges=read_edges(lane_edges),
        point=point,
        types=types,
    )


def class_table(report: "Report") -> Table:
    """Numbers of vehicles by class and recording."""
    names = sorted({name for counts in report.classes for name in counts})
    head = ["recording", *names, "lateral position"]
    pairs = list(zip(report.recordings, report.classes, report.lateral, strict=True))
    records = [
        {"recording": r.recording, **{n: counts[n] for n in names}, "lateral_position": lateral}
        for r, counts, lateral in pairs
    ]
    lines = [
        [r.recording, *(str(counts[n]) for n in names), "yes" if lateral else "no"] for r, counts, lateral in pairs
    ]
    return Table("classes", head, lines, records, title="Vehicles by class")
