"""The commands about models: make scenes, train, evaluate."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from gri import resources
from gri.errors import InputError
from gri.table import Table
from gri.terminal import FormatOption, ProgressDisplay, next_command, notice, say, show_tables

if TYPE_CHECKING:
    from gri.data.store import Splits
    from gri.evaluation.evaluate import Evaluation
    from gri.networks.model import RelationalModel
    from gri.training.train import TrainConfig
    from gri.training.training_state import TrainingState

ConfigArgument = Annotated[
    str, typer.Argument(metavar="CONFIG", help="A YAML file, or the name of one in scenarios/train.")
]
ScenesOption = Annotated[Path, typer.Option("--scenes", help="Folder of the synthetic scenes.")]
SCENES = Path("runs/scenes")


class Tracker(StrEnum):
    """Where the course of a training is written."""

    CSV = "csv"
    TENSORBOARD = "tensorboard"


def data(
    config: ConfigArgument,
    scenes: ScenesOption = SCENES,
    scene_file: Annotated[
        Path | None,
        typer.Option(help="Scene file to write as well, for mixing with scenes of SUMO and recordings."),
    ] = None,
) -> None:
    """Make the synthetic scenes of a configuration.

    An expert that is trained on the true reward drives the vehicles.
    """
    chosen = _read(config)
    from gri.data.export import write_synthetic
    from gri.data.store import scenes_path

    splits = _scenes(chosen, scenes)
    sizes = f"{len(splits.train)} training, {len(splits.validation)} validation and {len(splits.test)} test"
    say(f"{sizes} scenes in {scenes_path(chosen.data, scenes)}")
    if scene_file is not None:
        write_synthetic(scene_file, chosen.data, splits)
        say(f"and in {scene_file}")
    next_command(f"gri train {config}")


def train(
    config: ConfigArgument,
    seed: Annotated[int, typer.Option(help="Seed of the initial weights and of the training.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Checkpoint to write; default: runs/NAME-sSEED.safetensors.")] = None,
    scenes: ScenesOption = SCENES,
    ngsim: Annotated[
        Path | None,
        typer.Option(
            "--ngsim",
            "--scene-file",
            help="Scene file of `gri ngsim scenes` or `cosim scenes`, or NGSIM files to cut; for the configurations"
            " ngsim_* and sumo_*.",
        ),
    ] = None,
    track: Annotated[
        list[Tracker] | None,
        typer.Option(help="Write the objective after every update beside the checkpoint; repeat for both."),
    ] = None,
) -> None:
    """Train a model and write its checkpoint.

    Ctrl-C stops the training after the update under way. The same command goes on
    from there; the result is the same as without a stop.
    """
    chosen = _read(config)
    from gri import checkpoint
    from gri.storage.claims import claimed_place
    from gri.training.tracking import remove_tracks, tracked
    from gri.training.train import train as train_model
    from gri.training.training_state import TrainingState, identity

    path = out or Path("runs") / f"{chosen.name}-s{seed}.safetensors"
    with claimed_place(path):
        splits = _scenes(chosen, scenes) if ngsim is None else _recorded(chosen, ngsim, scenes)
        state = TrainingState(path.with_suffix(".state"), identity(chosen, seed, splits.train))
        if track and not state.at:
            remove_tracks(path)
        with (
            resumable(state),
            ProgressDisplay() as shown,
            tracked(shown, [kind.value for kind in track or ()], path) as progress,
        ):
            trained = train_model(chosen, splits, seed, progress, state)
        checkpoint.save(path, trained.model, trained.reward, trained.provenance)
        state.finish()
    say(f"trained in {trained.provenance['seconds']} s, wrote {path}")
    next_command(f"gri evaluate {path}")


@contextmanager
def resumable(state: "TrainingState") -> Iterator["TrainingState"]:
    """Say where a training goes on, and where it was stopped; a stop ends the command with code 130."""
    if state.at:
        say(f"going on after {state.at}")
    try:
        with state.stoppable():
            yield state
    except KeyboardInterrupt:
        kept = state.path is not None and state.path.exists()
        notice(f"stopped; run the same command again to {f'go on (kept in {state.path})' if kept else 'begin anew'}")
        raise typer.Exit(130) from None


def teach(
    path: Annotated[
        Path, typer.Argument(metavar="CHECKPOINT", help="A checkpoint file, or the name of a released one.")
    ],
    out: Annotated[Path, typer.Option(help="Checkpoint to write.")],
    seed: Annotated[int, typer.Option(help="Seed of the drawn scenes, the initial weights and the training.")] = 0,
    scenes: ScenesOption = SCENES,
    recordings: Annotated[
        list[Path] | None,
        typer.Option(
            help="NGSIM files: the encoder learns from their windows against windows broken on purpose, instead of from"
            " drawn scenes; repeat for more."
        ),
    ] = None,
    merges: Annotated[
        list[Path] | None,
        typer.Option(
            help="Scene files of `cosim scenes --kind merge` for a merge model: it learns the label-free posterior of"
            " merges; repeat for more."
        ),
    ] = None,
    updates: Annotated[
        int | None,
        typer.Option(
            min=1, help="Updates of the encoder; default: 12,000, with --recordings 800 of each member, --merges 3,500."
        ),
    ] = None,
) -> None:
    """Teach a model's encoder who reacts to whom.

    Reward and policy stay as they are (docs/training.md). Ctrl-C stops after the update
    under way. The same command goes on from there, with the same result.
    """
    one_thread()
    from gri import checkpoint
    from gri.storage.claims import claimed_place

    path = resources.find_checkpoint(path)
    model, made = checkpoint.load(path), checkpoint.provenance(path)
    config, kept = trained_with(path, made), out.with_suffix(".state")
    with claimed_place(out):
        if merges:
            if recordings:
                raise InputError("got --merges and --recordings, wanted one of them; merges are for merge models")
            taught, how, state = _taught_merges(path, model, config, merges, seed, updates, kept)
        elif recordings:
            taught, how, state = _taught_recorded(model, recordings, seed, updates, kept)
        else:
            taught, how, state = _taught_following(path, model, config, seed, updates, scenes, kept)
        checkpoint.save(out, taught, checkpoint.load_reward(path), {**made, "teaching": how})
        state.finish()
    say(f"taught in {how['cpu_seconds']} s of CPU, wrote {out}")
    next_command(f"gri evaluate {out}")


def _taught_following(
    path: Path,
    model: "RelationalModel",
    config: "TrainConfig",
    seed: int,
    updates: int | None,
    scenes: Path,
    kept: Path,
) -> "tuple[RelationalModel, Mapping[str, Any], TrainingState]":
    """A car-following model with a taught encoder, how it was taught, and the state that is kept in the file `kept`."""
    from gri.training.relations.teach_checkpoint import teach_model, teaching_identity
    from gri.training.relations.teach_encoder import TeachingSettings
    from gri.training.training_state import TrainingState

    settings = TeachingSettings() if updates is None else TeachingSettings(updates=updates)
    if config.data.recorded is not None:
        raise InputError(f"{path}: got no recordings, wanted those that it learned from; give them with --recordings")
    known = _scenes(config, scenes).train.observed[:, :, : model.history_steps]
    identity = teaching_identity(model, known, settings, seed)
    with resumable(TrainingState(kept, identity)) as state, ProgressDisplay() as progress:
        return *teach_model(model, known, settings, seed, progress, state), state


def _taught_recorded(
    model: "RelationalModel", recordings: Sequence[Path], seed: int, updates: int | None, kept: Path
) -> "tuple[RelationalModel, Mapping[str, Any], TrainingState]":
    """A car-following model with an encoder that was taught on recordings, and as above."""
    from gri.data.ngsim.following_triples import read_sites
    from gri.training.relations.recorded_windows import ContrastSettings, contrast_windows
    from gri.training.relations.teach_recorded import recorded_teaching_identity, teach_recorded_model
    from gri.training.training_state import TrainingState

    settings = ContrastSettings() if updates is None else ContrastSettings(updates=updates)
    with ProgressDisplay() as progress:
        windows = contrast_windows(read_sites(recordings, progress=progress), settings)
    identity = recorded_teaching_identity(model, windows, settings, seed)
    with resumable(TrainingState(kept, identity)) as state, ProgressDisplay() as progress:
        return *teach_recorded_model(model, windows, settings, seed, progress, state), state


def _taught_merges(
    path: Path,
    model: "RelationalModel",
    config: "TrainConfig",
    merges: Sequence[Path],
    seed: int,
    updates: int | None,
    kept: Path,
) -> "tuple[RelationalModel, Mapping[str, Any], TrainingState]":
    """A merge model with a taught encoder, how it was taught, and the state that is kept in the file `kept`."""
    from gri.inference.step_relations import released_merge_constants
    from gri.training.relations.teach_merges import (
        MergeTeachingSettings,
        merge_teaching_identity,
        merges_with_posterior,
        teach_merge_model,
    )
    from gri.training.training_state import TrainingState

    scenes, constants = config.data.scene_file_range, released_merge_constants()
    if scenes is None:
        raise InputError(f"{path}: this model is for no scene file; give a merge model, such as us101_merge")
    settings = MergeTeachingSettings() if updates is None else MergeTeachingSettings(updates=updates)
    with ProgressDisplay() as progress:
        known = merges_with_posterior(model, scenes, merges, constants, settings, progress)
    identity = merge_teaching_identity(model, known, settings, seed)
    with resumable(TrainingState(kept, identity)) as state, ProgressDisplay() as progress:
        taught, how = teach_merge_model(model, known, settings, seed, progress, state)
    return taught, {**how, "constants": constants}, state


def evaluate(
    path: Annotated[
        Path, typer.Argument(metavar="CHECKPOINT", help="A checkpoint file, or the name of a released one.")
    ],
    scenes: ScenesOption = SCENES,
    scene_file: Annotated[
        Path | None,
        typer.Option(help="Scene file of `gri ngsim scenes` or `cosim scenes` to use instead of the test scenes."),
    ] = None,
    split: Annotated[str | None, typer.Option(help="Split of the scene file to use; default: all scenes.")] = None,
    table_format: FormatOption = "table",
) -> None:
    """Score a checkpoint on test scenes."""
    one_thread()
    from gri import checkpoint
    from gri.data.recorded import scenes_to_test
    from gri.evaluation import evaluate as evaluation
    from gri.evaluation.true_relations import compare_with_truth, truth_tables

    path = resources.find_checkpoint(path)
    model, made = checkpoint.load(path), checkpoint.provenance(path)
    config = trained_with(path, made)
    found, remarks = None, []
    if scene_file is None:
        test = _scenes(config, scenes).test
    elif config.data.scene_file_range is not None:
        test, found, drawn = scenes_to_test(scene_file, config.data.scene_file_range, split)
        if drawn:
            remarks.append(f"left out: {drawn} scenes with drawn lateral motion, which are for training only")
    else:
        raise InputError(
            f"{path}: the checkpoint was trained on scenes of range {config.data.range}, and no scene file has such"
            " scenes; leave out --scene-file, or give a checkpoint of recorded traffic, of SUMO's traffic (sumo_*), or"
            " of scenes like SUMO's (us101, highway_merge)"
        )
    tables = [_table(path.stem, evaluation.evaluate(model, test), len(test))]
    infers = model.encoder is not None
    if infers and found is not None and found.hypothesis is not None and found.unambiguous is not None:
        compared = compare_with_truth(
            evaluation.driving_graph(model, test).map, test.graph, found.hypothesis, found.unambiguous
        )
        tables += truth_tables(compared, model.config.vocabulary)
    show_tables(tables, table_format, *remarks, then="cosim --help")


def one_thread() -> None:
    """Let torch use one thread: the matrices are small, and more threads are slower."""
    import torch

    torch.set_num_threads(1)


def _read(config: str) -> "TrainConfig":
    """The configuration of a YAML file, or of a name in scenarios/train."""
    path = Path(config)
    if not path.suffix:
        shipped = resources.shipped("scenarios", "train")
        names = sorted(file.stem for file in shipped.glob("*.yaml"))
        if config not in names:
            raise InputError(f"got {config}, wanted a YAML file or one of {', '.join(names)}")
        path = shipped / f"{config}.yaml"
    one_thread()
    from gri.training.train import read_train_config

    return read_train_config(path)


def trained_with(path: Path, provenance: Mapping[str, Any]) -> "TrainConfig":
    """The configuration that a checkpoint was trained with. Errors: `InputError` if the file does not say."""
    from gri.training.train import TrainConfig

    if "config" not in provenance:
        raise InputError(
            f"{path}: the checkpoint does not say which scenes it was trained on; give one that `gri train` wrote"
        )
    return msgspec.convert(provenance["config"], TrainConfig)


def _scenes(config: "TrainConfig", folder: Path) -> "Splits":
    from gri.data.store import scenes_of

    with ProgressDisplay() as progress:
        return scenes_of(config.data, folder, progress)


def _recorded(config: "TrainConfig", source: Path, folder: Path) -> "Splits":
    from gri.data.ngsim.extract import scene_file
    from gri.data.store import recorded_splits

    if config.data.recorded is None:
        raise InputError(f"got --ngsim, but {config.name} learns from synthetic scenes; leave it out")
    with ProgressDisplay() as progress:
        file = scene_file(source, folder, progress)
    return recorded_splits(config.data.recorded, [file])


def _table(name: str, result: "Evaluation", scenes: int) -> Table:
    from gri.evaluation.true_relations import summary_record

    rows = {f"RMSE_{name} [{'m/s' if name == 'v' else 'm'}]": value for name, value in result.rmse.items()}
    rows["accuracy, 6 edges"] = result.accuracy
    rows["accuracy, 4 edges into driven vehicles"] = result.driven_accuracy
    if result.chain_accuracy is not None:
        rows[f"accuracy in {result.chain_accuracy.scenes} scenes with the paper's graph"] = result.chain_accuracy
    f1 = {f"F1 of type {kind}": value for kind, value in result.f1.items()}
    return Table(
        "evaluation",
        ["metric", "mean ± std over scenes", "95 % ±"],
        [[metric, str(value), f"{value.half_width:.4f}"] for metric, value in rows.items()]
        + [[metric, f"{value:.4f}", ""] for metric, value in f1.items()],
        [{"metric": metric, **summary_record(value)} for metric, value in rows.items()]
        + [{"metric": metric, "mean": value} for metric, value in f1.items()],
        title=f"{name}, {scenes} test scenes",
    )
