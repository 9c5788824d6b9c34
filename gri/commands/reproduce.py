"""The command `gri reproduce`: tables and figures of the paper."""

from pathlib import Path
from typing import Annotated

import typer

from gri.commands.models import SCENES, one_thread
from gri.errors import InputError
from gri.terminal import ProgressDisplay, next_command, notice, say

TARGETS = (
    "table1",
    "table2",
    "table3",
    "ood",
    "figures",
    "equal_terms",
    "constants",
)  # those of `gri.paper`, which imports torch; a test compares


def reproduce(
    target: Annotated[str, typer.Argument(metavar="TARGET", help=f"One of {', '.join(TARGETS)}.")],
    seeds: Annotated[int, typer.Option(help="Seeds per row.")] = 5,
    test: Annotated[int, typer.Option("--scenes", help="Number of test scenes.")] = 1000,
    out: Annotated[Path, typer.Option(help="Folder of tables and figures.")] = Path("runs/reproduce"),
    cache: Annotated[Path, typer.Option(help="Folder of finished rows and seeds.")] = Path("runs/reproduce/jobs"),
    scenes: Annotated[Path, typer.Option("--scenes-folder", help="Folder of the synthetic scenes.")] = SCENES,
    scenario: Annotated[str | None, typer.Option(help="Make only this scenario.")] = None,
    row: Annotated[list[str] | None, typer.Option(help="Make only this row; repeatable.")] = None,
    processes: Annotated[int, typer.Option(help="Trainings at a time, with one thread each.")] = 2,
    ngsim: Annotated[
        Path | None, typer.Option(help="For table2: folder of NGSIM files, or a scene file cut from them.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Use few scenes and updates, only to see that all runs.")] = False,
    finished: Annotated[bool, typer.Option("--finished", help="Use only finished rows; train nothing.")] = False,
) -> None:
    """Make a table or the figures of the paper.

    Trains what is missing and writes the results beside the printed figures. The
    same command continues where it was stopped.
    """
    if target not in TARGETS:
        raise InputError(f"got {target}, wanted one of {', '.join(TARGETS)}")
    if target == "table2" and ngsim is None:
        raise InputError("table2 needs recorded data: give --ngsim FOLDER with NGSIM files, or a scene file")
    one_thread()
    from gri.paper.plan import Plan
    from gri.paper.publish import publish
    from gri.storage.claims import claimed_folder

    plan = Plan(target, seeds, test, out, cache, scenes, scenario, tuple(row or ()), quick, processes, finished, ngsim)  # type: ignore[arg-type]
    try:
        with claimed_folder(out), claimed_folder(cache), ProgressDisplay() as progress:
            written = publish(plan, progress)
    except KeyboardInterrupt:
        notice("stopped; finished rows are kept, the same command continues")
        raise typer.Exit(130) from None
    for path in written:
        say(str(path))
    following = {
        "table1": "gri reproduce table3",
        "table3": "gri reproduce ood",
        "ood": "gri reproduce figures",
        "table2": "gri reproduce figures",
    }
    next_command(following.get(target, "cosim --help"))
