"""`gri infer`: who reacts to whom in the scenes of a file."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gri import resources
from gri.commands.models import one_thread, trained_with
from gri.errors import InputError
from gri.storage.claims import claimed_place
from gri.terminal import FormatOption, ProgressDisplay, say, show_tables

if TYPE_CHECKING:
    from gri.inference.step_relations import StepRelations
    from gri.progress import Progress

POSTERIOR = "merge_posterior"


def infer(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="A checkpoint file, the name of a released one, or merge_posterior: the label-free posterior of"
            " merges.",
        ),
    ],
    scene_file: Annotated[
        Path, typer.Argument(metavar="SCENES", help="Scene file of `gri scenes make` or `cosim scenes`.")
    ],
    out: Annotated[Path | None, typer.Option(help="Parquet table to write; default: runs/relations-SCENES.")] = None,
    every_s: Annotated[
        float, typer.Option("--every-s", min=0, max=60, help="Time between two inferences [s]; 0: every step.")
    ] = 0.0,
    online: Annotated[
        bool,
        typer.Option("--online", help="merge_posterior sees only what is before each step. Checkpoints always do so."),
    ] = False,
    kind: Annotated[
        str | None, typer.Option(help="Kind of scenes for merge_posterior, vehicle 0 changing lanes; default: merge.")
    ] = None,
    split: Annotated[str | None, typer.Option(help="Split of the scene file to use; default: all scenes.")] = None,
    table_format: FormatOption = "table",
) -> None:
    """Infer who reacts to whom in the scenes of a file, step by step.

    Where the file knows the relations, the answer is scored beside two constants.
    """
    one_thread()
    from gri.inference.relation_tables import scores, shares, write

    if model != POSTERIOR and (online or kind is not None):
        raise InputError(f"got {'--online' if online else '--kind'} with {model}, which is for {POSTERIOR} only")
    path = out or Path("runs") / f"relations-{scene_file.stem}.parquet"
    with claimed_place(path), ProgressDisplay() as progress:
        if model == POSTERIOR:
            results = _by_posterior(scene_file, every_s, online, kind or "merge", split, progress)
        else:
            results = _by_checkpoint(model, scene_file, every_s, split, progress)
        write(path, results)
    tables = [table for found in results for table in (shares(found), scores(scene_file, found, split)) if table]
    show_tables(tables, table_format)
    say(f"Relations of each step: {path}")


def _by_posterior(
    scene_file: Path, every_s: float, online: bool, kind: str, split: str | None, progress: "Progress"
) -> list["StepRelations"]:
    from gri.inference.step_relations import by_merge_posterior, released_merge_constants

    return by_merge_posterior(scene_file, released_merge_constants(), every_s, online, kind, split, progress)


def _by_checkpoint(
    model: str, scene_file: Path, every_s: float, split: str | None, progress: "Progress"
) -> list["StepRelations"]:
    from gri import checkpoint
    from gri.inference.step_relations import by_model

    path = resources.find_checkpoint(model)
    loaded, made = checkpoint.load(path), checkpoint.provenance(path)
    scenes = trained_with(path, made).data.scene_file_range
    if loaded.encoder is None or scenes is None:
        raise InputError(
            f"{path}: this model {'infers no graph' if loaded.encoder is None else 'is for no scene file'}; give one"
            f" of traffic, such as us101_car_following, or {POSTERIOR}"
        )
    return by_model(loaded, scenes, scene_file, every_s, split, progress)
