"""The commands `gri ngsim`: report on NGSIM files, and cut scenes out of them."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gri.table import Table
from gri.terminal import FormatOption, ProgressDisplay, finite, show_tables

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
    table_format: FormatOption = "table",
) -> None:
    """Report what a file holds, and its defects."""
    import msgspec

    from gri.data.ngsim.extract import inspect

    with ProgressDisplay() as progress:
        reports, unreadable = inspect(file, site, progress)
    remarks = []
    if json is not None:
        content = {"file": file.name, "unreadable rows": unreadable, "recordings": msgspec.to_builtins(reports)}
        json.parent.mkdir(parents=True, exist_ok=True)
        json.write_bytes(msgspec.json.format(msgspec.json.encode(content)) + b"\n")
        remarks.append(f"wrote {json}")
    show_tables(report_tables(reports, unreadable), table_format, *remarks, then=f"gri ngsim scenes {file}")


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
    table_format: FormatOption = "table",
) -> None:
    """Cut car-following and lane-changing scenes out of files."""
    from gri.data.ngsim.extract import extract
    from gri.data.ngsim.rules import Rules
    from gri.data.ngsim.smoothing import Smoothing
    from gri.storage.claims import claimed_place
    from gri.storage.verification import digest_file, write_digest

    rules = Rules(
        smoothing=Smoothing(window=window, order=order), spacing=spacing, training_stride=training_stride
    ).checked()
    with claimed_place(out), ProgressDisplay() as progress:
        digest_file(out).unlink(missing_ok=True)
        made = extract(files, out, rules, site=site, progress=progress)
        write_digest(out)
    show_tables(
        [scene_table(made), *([rejection_table(made)] if made.rejected.total() else [])],
        table_format,
        f"{sum(made.scenes.values())} scenes in {out}",
        then=f"gri train ngsim_car_following --ngsim {out}",
    )


def report_tables(reports: "Sequence[Quality]", unreadable: dict[str, int]) -> list[Table]:
    """What the recordings hold, one line each, and the defects of all of them."""
    lines, records = [], []
    for r in reports:
        lanes, road = ",".join(map(str, r.lanes)), f"{r.road[0]:.0f} to {r.road[1]:.0f}"
        counts = [str(value) for value in (r.rows, r.vehicles, r.tracks, r.seconds)]
        lines.append([r.recording, *counts, road, str(r.speed), lanes])
        sizes = {"recording": r.recording, "rows": r.rows, "vehicles": r.vehicles, "tracks": r.tracks}
        places = {"road_from": r.road[0], "road_to": r.road[1], "mean_speed": r.speed, "lanes": lanes}
        records.append(sizes | {"seconds": r.seconds} | places)
    head = ["recording", "rows", "vehicles", "tracks", "time [s]", "road [m]", "mean speed [m/s]", "lanes"]
    found: list[tuple[str, int, int | None]] = [
        (f"rows that are no numbers ({name})", count, None) for name, count in unreadable.items()
    ]
    for name in reports[0].defects:
        counts = [r.defects[name] for r in reports]
        found.append((name, sum(counts), sum(count > 0 for count in counts)))
    defects = Table(
        "defects",
        ["defect", "rows or cases", "in recordings"],
        [[name, str(n), "" if where is None else f"{where} of {len(reports)}"] for name, n, where in found],
        [{"defect": name, "count": n, "recordings": where} for name, n, where in found],
        title="Defects",
    )
    return [Table("recordings", head, lines, records), defects]


def scene_table(made: "Extracted") -> Table:
    """Numbers of scenes by site, kind and split."""
    head = ("site", "kind", "train", "validation", "test")
    rows = [
        (site, kind, *(made.scenes[site, kind, split] for split in head[2:]))
        for site, kind in sorted({(site, kind) for site, kind, _ in made.scenes})
    ]
    records = [dict(zip(head, row, strict=True)) for row in rows]
    return Table("scenes", head, [tuple(map(str, row)) for row in rows], records, title="Scenes", labels=2)


def rejection_table(made: "Extracted") -> Table:
    """Numbers of rejected candidates, by kind and the first rule that they break."""
    head = ("kind", "reason", "candidates")
    rows = [(kind, reason, count) for (kind, reason), count in sorted(made.rejected.items()) if count]
    records = [dict(zip(head, row, strict=True)) for row in rows]
    return Table("rejections", head, [tuple(map(str, row)) for row in rows], records, title="Rejections", labels=2)
