"""The commands `gri bench relations`, `lanes` and `merges`: does a model see who reacts to whom?"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from gri.commands.models import one_thread
from gri.errors import InputError
from gri.progress import Progress
from gri.storage.claims import claimed_folder
from gri.terminal import ProgressDisplay, next_command, notice, say

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Measure what inferred relations are worth.")


@contextmanager
def _resumable(out: Path) -> Iterator[Progress]:
    """Progress of a benchmark, which holds its folder.

    Ctrl-C ends the command with exit code 130 and says that it can continue.
    """
    try:
        with claimed_folder(out), ProgressDisplay() as progress:
            yield progress
    except KeyboardInterrupt:
        notice("stopped; finished rows are kept, the same command continues")
        raise typer.Exit(130) from None


@app.callback()
def bench() -> None:
    """Measure what inferred relations are worth."""


@app.command()
def relations(
    out: Annotated[Path, typer.Option(help="Folder of tables and finished rows.")] = Path("runs/bench/relations"),
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Seeds of the rows that depend on one.")] = 5,
    scenes: Annotated[int, typer.Option(min=20, max=10_000, help="Scenes in each test set.")] = 300,
    row: Annotated[list[str] | None, typer.Option(help="Score only this row; repeatable.")] = None,
    recordings: Annotated[
        list[Path] | None,
        typer.Option(help="NGSIM file: score recorded traffic instead of simulated drivers; repeatable."),
    ] = None,
    sumo: Annotated[
        list[Path] | None,
        typer.Option(
            exists=True,
            dir_okay=False,
            help="Scene file of `cosim scenes --kind triple --gold`: score SUMO's drivers as well; repeatable.",
        ),
    ] = None,
    only_sumo: Annotated[bool, typer.Option("--only-sumo", help="Score nothing but the files of --sumo.")] = False,
) -> None:
    """Score relations on scenes whose true graph is known.

    Simulated drivers of six models, and controls in which nobody can react to
    anybody. With --recordings: recorded car following, and controls made of
    it. The same command continues where it was stopped.
    """
    if only_sumo and not sumo:
        raise InputError("--only-sumo: got no file, wanted some; give --sumo FILE")
    one_thread()
    from gri.bench.recorded_relations import RecordedPlan, run_recorded
    from gri.bench.relations import Plan, run
    from gri.bench.sumo_relations import SumoPlan, run_sumo

    with _resumable(out) as progress:
        if recordings and not only_sumo:
            run_recorded(RecordedPlan(out, tuple(recordings), seeds, tuple(row or ()), lanes=not row), progress)
        elif not only_sumo:
            run(Plan(out, seeds, scenes, tuple(row or ())), progress)
        if sumo:
            run_sumo(SumoPlan(out, tuple(sumo), seeds, tuple(row or ())), progress)
    written = ("recorded.md", "recorded.csv") if recordings else ("relations.md", "relations.csv", "relations.json")
    for name in () if only_sumo else written:
        say(str(out / name))
    for name in ("sumo.md", "sumo.csv", "sumo.json") if sumo else ():
        say(str(out / name))
    if not sumo and not recordings:
        notice("SUMO's drivers are left out; give files of `cosim scenes --kind triple --gold` as --sumo")
    next_command("gri evaluate CHECKPOINT --scene-file FILE")


@app.command()
def lanes(
    out: Annotated[Path, typer.Option(help="Folder of tables and finished rows.")] = Path("runs/bench/lanes"),
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Seeds of the rows that depend on one.")] = 3,
    scenes: Annotated[int, typer.Option(min=40, max=10_000, help="Scenes in each test set.")] = 200,
    row: Annotated[list[str] | None, typer.Option(help="Score only this row; repeatable.")] = None,
) -> None:
    """Score relations of simulated merges, step by step.

    Merges, refused merges, lane changes that concern nobody and lane keepers
    beside a gap, by simulated drivers of six models. The same command continues
    where it was stopped.
    """
    one_thread()
    from gri.bench.lanes import LanePlan, run_lanes

    with _resumable(out) as progress:
        run_lanes(LanePlan(out, seeds, scenes, tuple(row or ())), progress)
    for name in ("lanes.md", "lanes.csv", "lanes.json"):
        say(str(out / name))
    next_command("gri evaluate CHECKPOINT --scene-file FILE")


@app.command()
def merges(
    scenes: Annotated[list[Path], typer.Option(help="Scene file to score, of one site; repeatable.")],
    train: Annotated[list[Path], typer.Option(help="Scene file of other seeds, to learn from; repeatable.")],
    out: Annotated[Path, typer.Option(help="Folder of tables and finished rows.")] = Path("runs/bench/relations"),
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Seeds of the rows that depend on one.")] = 5,
    row: Annotated[list[str] | None, typer.Option(help="Score only this row; repeatable.")] = None,
) -> None:
    """Score relations per step of SUMO's merges.

    Scene files are those of `cosim scenes us101_merge --gold --kind merge`.
    The same command continues where it was stopped.
    """
    one_thread()
    from gri.bench.merges import Plan, run

    with _resumable(out) as progress:
        run(Plan(out, tuple(scenes), tuple(train), seeds, tuple(row or ())), progress)
    for name in ("merges.md", "merges.csv", "merges.json"):
        say(str(out / name))
