"""The commands `gri ngsim`: report on NGSIM files, and cut scenes out of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from gri.terminal import ProgressDisplay, console, finite, next_command, say

if TYPE_CHECKING:
    from gri.data.ngsim.defects import Quality
    from gri.data.ngsim.extract import Extracted

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Check NGSIM trajectory files and cut scenes.")

SiteOption = Annotated[
    str | None, typer.Option(help="Name of the site; default: the column Location, else the name of the file.")
]
# The defaults of `gri.data.ngsim.rules.Rules`, which would bring scipy and pandas into `--help`; a test compares.
WINDOW, ORDER, SPACING, TRAINING_STRIDE = 21, 3, 50.0, 5


@app.command(name="inspect")
def inspect_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Official text or csv, plain, gzip or zip.")],
    site: SiteOption = None,
    json: Annotated[Path | None, typer.Option(help="JSON file to write the report to as well.")] = None,
) -> None:
    """Report what a file holds, and its defects."""
    import msgspec

    from gri.data.ngsim.extract import inspect

    with ProgressDisplay() as progress:
        reports, unreadable = inspect(file, site, progress)
    show(reports, unreadable, console)
    if json is not None:
        content = {"file": file.name, "unreadable rows": unreadable, "recordings": msgspec.to_builtins(reports)}
        json.parent.mkdir(parents=True, exist_ok=True)
        json.write_bytes(msgspec.json.format(msgspec.json.encode(content)) + b"\n")
        say(f"wrote {json}")
    next_command(f"gri ngsim scenes {file}")


@app.command()
def scenes(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Official text or csv files, plain, gzip or zip.")
    ],
    out: Annotated[Path, typer.Option(help="Scene file to write.")] = Path("runs/scenes/ngsim.parquet"),
    site: SiteOption = None,
    window: Annotated[int, typer.Option(help="Width of the smoothing filter in frames of 0.1 s; odd.")] = WINDOW,
    order: Annotated[int, typer.Option(help="Degree of the polynomial of the filter.")] = ORDER,
    spacing: Annotated[float, typer.Option(callback=finite, help="Greatest distance to the leader [m].")] = SPACING,
    training_stride: Annotated[
        int, typer.Option(help="Steps of 0.2 s between training scenes of the same three vehicles.")
    ] = TRAINING_STRIDE,
) -> None:
    """Cut car-following and lane-changing scenes out of files."""
    from gri.data.ngsim.extract import extract
    from gri.data.ngsim.rules import Rules
    from gri.data.ngsim.smoothing import Smoothing

    rules = Rules(
        smoothing=Smoothing(window=window, order=order), spacing=spacing, training_stride=training_stride
    ).checked()
    with ProgressDisplay() as progress:
        made = extract(files, out, rules, site=site, progress=progress)
    console.print(scene_table(made))
    if made.rejected.total():
        console.print(rejection_table(made))
    say(f"{sum(made.scenes.values())} scenes in {out}")
    next_command(f"gri train ngsim_car_following --ngsim {out}")


def show(reports: "Sequence[Quality]", unreadable: dict[str, int], to: Console) -> None:
    """Print what the recordings hold, one row each, and the defects of all of them."""
    sizes = Table(
        Column("recording", no_wrap=True),
        *("rows", "vehicles", "tracks"),
        *(escape(heading) for heading in ("time [s]", "road [m]", "mean speed [m/s]")),
        "lanes",
    )
    for r in reports:
        lanes, road = ",".join(map(str, r.lanes)), f"{r.road[0]:.0f} to {r.road[1]:.0f}"
        counts = [str(value) for value in (r.rows, r.vehicles, r.tracks, r.seconds)]
        sizes.add_row(escape(r.recording), *counts, road, str(r.speed), lanes)
    to.print(sizes)
    found = Table("defect", "rows or cases", "in recordings", title="Defects")
    for name, count in unreadable.items():
        found.add_row(escape(f"rows that are no numbers ({name})"), str(count), "")
    for name in reports[0].defects:
        counts = [r.defects[name] for r in reports]
        found.add_row(escape(name), str(sum(counts)), f"{sum(c > 0 for c in counts)} of {len(counts)}")
    to.print(found)


def scene_table(made: "Extracted") -> Table:
    """Numbers of scenes by site, kind and split."""
    table = Table("site", "kind", "train", "validation", "test", title="Scenes")
    for site, kind in sorted({(site, kind) for site, kind, _ in made.scenes}):
        counts = [str(made.scenes[site, kind, split]) for split in ("train", "validation", "test")]
        table.add_row(escape(site), kind, *counts)
    return table


def rejection_table(made: "Extracted") -> Table:
    """Numbers of rejected candidates, by kind and the first rule that they break."""
    table = Table("kind", "reason", "candidates", title="Rejections")
    for (kind, reason), count in sorted(made.rejected.items()):
        if count:
            table.add_row(kind, escape(reason), str(count))
    return table
