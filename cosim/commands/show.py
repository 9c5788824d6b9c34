"""Commands that show results: of one run, one episode, or a whole batch."""

from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from cosim.commands.arguments import EpisodeOption, RunArgument
from gri.errors import InputError
from gri.terminal import FormatOption, next_command, say, show_tables

Format = Literal["html", "gif", "mp4", "png"]


def report(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of a run, a batch or a stress test.")],
    episode: Annotated[int | None, typer.Option(help="For a run: episode to draw; default: the most eventful.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="For a batch: file to write; default: report.html in its folder.")
    ] = None,
    table_format: FormatOption = "table",
) -> None:
    """Show a run as a table and picture, a batch as an HTML file.

    Of a stress test, its tables, figures and Markdown page are written again.
    """
    if (folder / "runs").is_dir():
        return _batch_report(folder, out or folder / "report.html")
    if (folder / "stress.json").is_file():
        from cosim.stress.stress_test import publish_again

        publish_again(folder)
        return say(f"Report: {folder / 'stress.md'}")
    from cosim.runs.episode_figure import picture
    from cosim.runs.run_tables import read_tables
    from cosim.runs.summary import summary_table

    tables = read_tables(folder)
    known = int(tables["groups"]["episode"].max())
    if episode is not None and not 0 <= episode <= known:
        raise InputError(f"--episode: got {episode}, {folder} has the episodes 0 to {known}")
    path = folder / ("episode.png" if episode is None else f"episode-{episode}.png")
    picture(tables, path, episode)
    show_tables(
        [summary_table(tables["groups"], tables["counterparts"])],
        table_format,
        f"Picture: {path}",
        then=f"cosim explain {folder} --episode {episode or 0}",
    )


def _batch_report(folder: Path, path: Path) -> None:
    from cosim.batch.store import BatchStore, write_whole
    from cosim.show.batch_report import batch_report

    write_whole(path, batch_report(BatchStore(folder)))
    say(f"Report: {path}")
    next_command(f"cosim results {folder}")


def render(
    run: RunArgument,
    episode: EpisodeOption = 0,
    kind: Annotated[
        Format | None, typer.Option("--format", help="Format of the file; default: the ending of --out, else html.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; default: in the run folder.")] = None,
) -> None:
    """Draw one episode as a picture, film or HTML page.

    No display is needed.
    """
    from cosim.runs.run_tables import read_tables
    from cosim.show.episode_view import episode_view

    tables = read_tables(run)
    view = episode_view(tables, episode)
    kind = kind or _format_of(out)
    path = out or run / f"episode-{episode}.{kind}"
    if kind == "png":
        from cosim.runs.episode_figure import picture

        picture(tables, path, episode)
    elif kind == "html":
        from cosim.batch.store import write_whole
        from cosim.show.animation import html

        write_whole(path, html(view, f"Episode {episode}: {view.driver} drives"))
    else:
        from cosim.show.video import write_video

        write_video(view, path)
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


def explain(run: RunArgument, episode: EpisodeOption = 0) -> None:
    """Explain in words why the policy drove as it did.

    The text is made from the graph that the policy inferred and from its reward.
    """
    from cosim.runs.run_tables import read_tables
    from cosim.show.episode_view import episode_view
    from cosim.show.explanation import explanation

    say(explanation(episode_view(read_tables(run), episode), run))
    next_command(f"cosim render {run} --episode {episode}")


def gui(run: RunArgument, episode: EpisodeOption = 0) -> None:
    """Replay one episode in sumo-gui.

    Needs the extra `sumo` of the installation.
    """
    from cosim.runs.run_tables import read_tables
    from cosim.show.episode_view import episode_view
    from cosim.show.sumo_gui import replay

    replay(episode_view(read_tables(run), episode), run)
