"""Commands that show results: of one run, one episode, or a whole batch."""

from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from cosim.commands.arguments import EpisodeOption, RunArgument
from gri.errors import InputError
from gri.table import TableFormat
from gri.terminal import FormatOption, ProgressDisplay, next_command, say, show_tables

Format = Literal["html", "gif", "mp4", "png"]


def report(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of a run, a batch or a stress test.")],
    episode: Annotated[int | None, typer.Option(help="For a run: episode to draw; default: the most eventful.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="For a batch: file to write; default: report.html or penetration.svg in its folder."),
    ] = None,
    table_format: FormatOption = "table",
) -> None:
    """Show a run as a table and picture, a batch as an HTML file.

    A batch with shares of the traffic is shown as curves over the share.
    Of a stress test, its tables, figures and pages are written again.
    """
    if (folder / "runs").is_dir():
        return _batch_report(folder, out)
    if (folder / "stress.json").is_file():
        from cosim.show.stress_page import write_stress_page
        from cosim.stress.stress_test import publish_again

        publish_again(folder)
        return say(f"Report: {folder / 'stress.md'}, for a browser: {write_stress_page(folder)}")
    if (folder / "traffic.parquet").is_file():
        from cosim.commands.share import show_share

        if episode is not None:
            raise InputError(f"--episode: {folder} is a run with a share of the traffic and no episodes; leave it out")
        return show_share(folder, table_format)
    from cosim.runs.episode_figure import picture
    from cosim.runs.run_reading import read_tables
    from cosim.runs.summary import summary_table

    tables = read_tables(folder)
    known = int(tables["groups"]["episode"].max())
    if episode is not None and not 0 <= episode <= known:
        raise InputError(f"--episode: got {episode}, {folder} has the episodes 0 to {known}")
    path = folder / ("episode.png" if episode is None else f"episode-{episode}.png")
    picture(tables, path, episode, folder)
    show_tables(
        [summary_table(tables["groups"], tables["counterparts"])],
        table_format,
        f"Picture: {path}",
        then=f"cosim explain {folder} --episode {episode or 0}",
    )


def _batch_report(folder: Path, out: Path | None) -> None:
    from cosim.batch.store import BatchStore
    from cosim.batch.traffic_results import has_traffic, traffic_rows
    from cosim.show.batch_report import batch_report
    from gri.storage.whole_files import write_whole

    if has_traffic(store := BatchStore(folder)):
        from cosim.show.penetration_curves import penetration_picture

        penetration_picture(traffic_rows(store), path := out or folder / "penetration.svg")
        say(f"Curves: {path}")
        return next_command(f"cosim results {folder}")
    path = out or folder / "report.html"
    write_whole(path, batch_report(BatchStore(folder)))
    say(f"Report: {path}")
    next_command(f"cosim results {folder}")


def render(
    run: RunArgument,
    episode: EpisodeOption = 0,
    kind: Annotated[
        Format | None, typer.Option("--format", help="Format of the file; default: the ending of --out, else html.")
    ] = None,
    beside: Annotated[
        Path | None,
        typer.Option(metavar="RUN", help="Show the same start in this other run beside it (HTML only)."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default: in the run folder.")] = None,
) -> None:
    """Draw one episode as a picture, film or HTML page.

    The page plays it with the lanes, the vehicles around and, as outlines,
    the same group left to SUMO. No display is needed.
    """
    from cosim.runs.road_view import road_view
    from cosim.runs.run_reading import read_tables
    from cosim.show.episode_view import episode_view, same_start

    tables = read_tables(run)
    view = episode_view(tables, episode)
    drives = [(view, road_view(tables, episode, run))]
    kind = kind or _format_of(out)
    path = out or run / f"episode-{episode}.{kind}"
    if beside is not None:
        if kind != "html":
            raise InputError(f"--beside: got the format {kind}, wanted html; leave out --format and --out, or --beside")
        others = read_tables(beside)
        number = same_start(others, view)
        drives.append((episode_view(others, number), road_view(others, number, beside)))
    if kind == "png":
        from cosim.runs.episode_figure import picture

        picture(tables, path, episode, run)
    elif kind == "html":
        from cosim.runs.summary import driver_name
        from cosim.show.animation import html
        from gri.storage.whole_files import write_whole

        names = " beside ".join(driver_name(drive.driver) for drive, _ in drives)
        title = f"Episode {episode}: {names}" + " drives" * (len(drives) == 1)
        write_whole(path, html(drives, title))
    else:
        from cosim.show.video import write_video

        write_video(view, drives[0][1], path)
    say(f"{path}")
    next_command(f"cosim explain {run} --episode {episode}")


def _format_of(out: Path | None) -> Format:
    """The format that the ending of the file names; html without a file."""
    if out is None:
        return "html"
    for kind in get_args(Format):
        if out.suffix.lower() == f".{kind}":
            return kind
    wanted = ", ".join(f".{kind}" for kind in get_args(Format))
    raise InputError(f"--out {out}: got the ending {out.suffix!r}, wanted one of {wanted}; or give --format")


def explain(
    run: RunArgument,
    episode: EpisodeOption = 0,
    measure: Annotated[
        bool, typer.Option("--measure", help="Drive all starts again without each edge and vehicle, and compare.")
    ] = False,
    over: Annotated[float, typer.Option(min=0.4, max=60, help="With --measure: time from the take-over [s].")] = 3.0,
    out: Annotated[
        Path | None,
        typer.Option(help="With --measure: CSV file to write; default: measured_effects.csv beside the run."),
    ] = None,
    table_format: FormatOption = "table",
) -> None:
    """Explain in words why the policy drove as it did.

    The text is made from the graph that the policy inferred and from its reward.
    With --measure the stated effects of all episodes are compared with those
    of drives without the edge, and without the vehicle.
    """
    if measure:
        return _measure(run, over, out, table_format)
    from cosim.runs.run_reading import read_surroundings, read_tables
    from cosim.show.episode_view import episode_view
    from cosim.show.explanation import explanation

    say(explanation(episode_view(read_tables(run) | read_surroundings(run), episode), run))
    next_command(f"cosim render {run} --episode {episode}")


def _measure(run: Path, over: float, out: Path | None, table_format: TableFormat) -> None:
    from cosim.runs.finished_run import read_scenario
    from cosim.runs.run_reading import read_surroundings, read_tables
    from cosim.show.measured_effects import faithfulness, faithfulness_table, is_in_lane, measured_effects
    from gri.storage.whole_files import write_whole

    scenario = read_scenario(run)
    with ProgressDisplay() as display:
        rows = measured_effects(scenario, read_tables(run) | read_surroundings(run), over, display)
    if rows.empty:
        raise InputError(f"--measure: no drive of {run} lasts a step; run more episodes")
    path = out or run.with_name(run.name + "-measured_effects.csv")
    write_whole(path, rows.to_csv(index=False))
    show_tables([faithfulness_table(faithfulness(rows, is_in_lane(scenario)), over)], table_format, f"Effects: {path}")


def gui(run: RunArgument, episode: EpisodeOption = 0) -> None:
    """Replay one episode in sumo-gui.

    Grey vehicles are around the group, transparent ones are the same group
    left to SUMO.

    Needs the extra `sumo` of the installation.
    """
    from cosim.runs.run_reading import read_tables
    from cosim.runs.surroundings_table import read_surroundings
    from cosim.show.episode_view import episode_view
    from cosim.show.sumo_gui import poses_of, replay

    tables = read_tables(run)
    view = episode_view(tables, episode)
    has_ghost = bool((tables["counterparts"]["episode"] == episode).any())
    ghost = episode_view(tables, episode, counterpart=True) if has_ghost else None
    replay(view, poses_of(view, ghost, read_surroundings(run, episode, counterpart=False)), run)
