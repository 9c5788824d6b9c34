"""`gri ngsim`: look at NGSIM files, and cut scenes out of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.table import Column, Table

from gri.commands.terminal import Bar, console, next_command
from gri.data.ngsim.defects import Quality
from gri.data.ngsim.extract import Extracted, extract, inspect
from gri.data.ngsim.rules import Rules
from gri.data.ngsim.smoothing import Smoothing

app = typer.Typer(no_args_is_help=True, help="NGSIM trajectory files: look at them, cut scenes out of them.")

SiteOption = Annotated[str | None, typer.Option(help="The site's name; default: the column Location, else the file's.")]


@app.command(name="inspect")
def inspect_command(
    file: Annotated[Path, typer.Argument(help="Official text or csv, plain, gzip or zip.")],
    site: SiteOption = None,
    json: Annotated[Path | None, typer.Option(help="Also write the report here, as JSON.")] = None,
) -> None:
    """1. Report what a file holds, and what is wrong with it."""
    with Bar() as progress:
        reports, unreadable = inspect(file, site, progress)
    show(reports, unreadable, console)
    if json is not None:
        content = {"file": file.name, "unreadable rows": unreadable, "recordings": msgspec.to_builtins(reports)}
        json.parent.mkdir(parents=True, exist_ok=True)
        json.write_bytes(msgspec.json.format(msgspec.json.encode(content)) + b"\n")
        console.print(f"wrote {json}", soft_wrap=True)
    next_command(f"gri ngsim scenes {file}")


@app.command()
def scenes(
    files: Annotated[list[Path], typer.Argument(help="Official text or csv files, plain, gzip or zip.")],
    out: Annotated[Path, typer.Option(help="Scene file to write.")] = Path("runs/scenes/ngsim.parquet"),
    site: SiteOption = None,
    window: Annotated[int, typer.Option(help="Frames of 0.1 s under the smoothing filter, odd.")] = Smoothing().window,
    order: Annotated[int, typer.Option(help="Degree of the filter's polynomial.")] = Smoothing().order,
    spacing: Annotated[float, typer.Option(help="Greatest distance to the vehicle ahead [m].")] = Rules().spacing,
    training_stride: Annotated[
        int, typer.Option(help="Steps between windows of the same three vehicles in training.")
    ] = Rules().training_stride,
) -> None:
    """2. Cut car-following and lane-changing scenes out of files."""
    rules = Rules(
        smoothing=Smoothing(window=window, order=order), spacing=spacing, training_stride=training_stride
    ).checked()
    with Bar() as progress:
        made = extract(files, out, rules, site=site, progress=progress)
    console.print(scene_table(made))
    if made.rejected.total():
        console.print(rejection_table(made))
    console.print(f"{sum(made.scenes.values())} scenes in {out}", soft_wrap=True)
    next_command(f"gri train ngsim_car_following --ngsim {out}")


def show(reports: Sequence[Quality], unreadable: dict[str, int], to: Console) -> None:
    """The data report, a column per recording: first what is there, then what is wrong."""
    sizes = Table(
        Column("recording", no_wrap=True), "rows", "vehicles", "tracks", "s", "road [m]", "mean [m/s]", "lanes"
    )
    for r in reports:
        lanes, road = ",".join(map(str, r.lanes)), f"{r.road[0]:.0f} to {r.road[1]:.0f}"
        counts = [str(value) for value in (r.rows, r.vehicles, r.tracks, r.seconds)]
        sizes.add_row(r.recording, *counts, road, str(r.speed), lanes)
    to.print(sizes)
    found = Table("defect", "rows or cases", "in recordings", title="Defects")
    for name, count in unreadable.items():
        found.add_row(f"rows that are no numbers ({name})", str(count), "")
    for name in reports[0].defects:
        counts = [r.defects[name] for r in reports]
        found.add_row(name, str(sum(counts)), f"{sum(c > 0 for c in counts)} of {len(counts)}")
    to.print(found)


def scene_table(made: Extracted) -> Table:
    """Scenes by site, kind and split."""
    table = Table("site", "kind", "train", "validation", "test", title="Scenes")
    for site, kind in sorted({(site, kind) for site, kind, _ in made.scenes}):
        counts = [str(made.scenes[site, kind, split]) for split in ("train", "validation", "test")]
        table.add_row(site, kind, *counts)
    return table


def rejection_table(made: Extracted) -> Table:
    """Candidates turned down, by kind and the first rule they break."""
    table = Table("kind", "turned down", "candidates", title="Rejections")
    for (kind, reason), count in sorted(made.rejected.items()):
        if count:
            table.add_row(kind, reason, str(count))
    return table
