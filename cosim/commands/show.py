"""The commands that show results: one run, one episode, or a whole batch."""

from pathlib import Path
from typing import Annotated, Literal, get_args

import typer

from cosim.process.terminal import console, next_command, say
from gri.errors import InputError

Run = Annotated[Path, typer.Argument(help="A run folder, also one of a batch: BATCH/runs/ID.")]
Format = Literal["html", "gif", "mp4", "png"]
EpisodeNumber = Annotated[int, typer.Option(help="Which episode of the run.")]


def report(
    folder: Annotated[Path, typer.Argument(help="A run folder, or the folder of a batch.")],
    episode: Annotated[int | None, typer.Option(help="Of a run: draw this episode, not the most eventful.")] = None,
    out: Annotated[Path | None, typer.Option(help="Of a batch: the file to write; default: its report.html.")] = None,
) -> None:
    """Show a finished run as a table and a picture, or a batch as one HTML file."""
    if (folder / "runs").is_dir():
        return _batch_report(folder, out or folder / "report.html")
    from cosim.runs.episode_figure import picture
    from cosim.runs.run_tables import read_tables
    from cosim.runs.summary import terminal_table

    tables = read_tables(folder)
    known = int(tables["groups"]["episode"].max())
    if episode is not None and not 0 <= episode <= known:
        raise InputError(f"--episode: got {episode}, {folder} has the episodes 0 to {known}")
    console.print(terminal_table(tables["groups"]))
    path = folder / ("episode.png" if episode is None else f"episode-{episode}.png")
    picture(tables, path, episode)
    say(f"\nPicture: {path}")
    next_command(f"cosim explain {folder} --episode {episode or 0}")


def _batch_report(folder: Path, path: Path) -> None:
    from cosim.batch.store import Store, write_whole
    from cosim.show.batch_report import report as page

    write_whole(path, page(Store(folder)))
    say(f"Report: {path}")
    next_command(f"cosim results {folder}")


def render(
    run: Run,
    episode: EpisodeNumber = 0,
    kind: Annotated[
        Format | None, typer.Option("--format", help="What to make; default: what --out ends with, else html.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The file to write; default: in the run folder.")] = None,
) -> None:
    """Draw one episode as a picture, a film or a page that plays it; no display is needed."""
    from cosim.runs.run_tables import read_tables
    from cosim.show.episode_view import view

    tables = read_tables(run)
    seen = view(tables, episode)
    kind = kind or _format_of(out)
    path = out or run / f"episode-{episode}.{kind}"
    if kind == "png":
        from cosim.runs.episode_figure import picture

        picture(tables, path, episode)
    elif kind == "html":
        from cosim.batch.store import write_whole
        from cosim.show.animation import html

        write_whole(path, html(seen, f"Episode {episode}: {seen.driver} drives"))
    else:
        from cosim.show.film import film

        film(seen, path)
    say(f"{path}")
    next_command(f"cosim explain {run} --episode {episode}")


def _format_of(out: Path | None) -> Format:
    """What a file of this name is expected to hold."""
    if out is None:
        return "html"
    for kind in get_args(Format):
        if out.suffix.lower() == f".{kind}":
            return kind
    wanted = ", ".join(f".{kind}" for kind in get_args(Format))
    raise InputError(f"--out {out}: got the ending {out.suffix!r}, wanted one of {wanted}; or say what with --format")


def explain(run: Run, episode: EpisodeNumber = 0) -> None:
    """Say in words what the policy believed and did, from its own graph and its own reward."""
    from cosim.runs.run_tables import read_tables
    from cosim.show.episode_view import view
    from cosim.show.explanation import explanation

    say(explanation(view(read_tables(run), episode), run))
    next_command(f"cosim render {run} --episode {episode}")


def gui(run: Run, episode: EpisodeNumber = 0) -> None:
    """Replay one episode in sumo-gui, where that is installed."""
    from cosim.runs.run_tables import read_tables
    from cosim.show.episode_view import view
    from cosim.show.sumo_gui import replay

    replay(view(read_tables(run), episode), run)
