"""The `gri` command: make scenes, train, evaluate, reproduce."""

import sys
from pathlib import Path
from typing import Annotated

import msgspec
import torch
import typer
from rich.markup import escape
from rich.table import Table

from gri import checkpoint, resources
from gri.commands.ngsim import app as ngsim_app
from gri.commands.terminal import Bar, console, next_command
from gri.data.export import write_synthetic
from gri.data.ngsim.extract import scene_file
from gri.data.ranges.recorded import RECORDED
from gri.data.recorded import scenes_to_test
from gri.data.store import Splits, recorded_splits, scenes_of, scenes_path
from gri.errors import InputError
from gri.evaluation.evaluate import Evaluation, driving_graph, evaluate
from gri.evaluation.true_relations import compare_with_truth, truth_tables
from gri.paper.reproduce import TABLES, Plan
from gri.training.train import TrainConfig, read_train_config, train

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Learn which vehicle heeds which, and drive by it: data, train, evaluate, reproduce.",
)
app.add_typer(ngsim_app, name="ngsim")

ConfigArgument = Annotated[str, typer.Argument(help="A YAML file, or the name of one in scenarios/train.")]
ScenesOption = Annotated[Path, typer.Option("--scenes", help="Folder in which scenes are kept.")]
SCENES = Path("runs/scenes")


@app.command()
def data(
    config: ConfigArgument,
    scenes: ScenesOption = SCENES,
    scene_file: Annotated[
        Path | None,
        typer.Option(help="Write them to this scene file as well, to be mixed with SUMO's and recorded ones."),
    ] = None,
) -> None:
    """1. Make the scenes of a configuration with an expert trained on the true reward."""
    chosen = _read(config)
    splits = _scenes(chosen, scenes)
    sizes = f"{len(splits.train)} + {len(splits.validation)} + {len(splits.test)}"
    console.print(f"{sizes} scenes in {scenes_path(chosen.data, scenes)}")
    if scene_file is not None:
        write_synthetic(scene_file, chosen.data, splits)
        console.print(f"and in {scene_file}", soft_wrap=True)
    next_command(f"gri train {config}")


@app.command(name="train")
def train_command(
    config: ConfigArgument,
    seed: Annotated[int, typer.Option(help="Seed of the weights and of the training.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Checkpoint to write; default runs/NAME-sSEED.pt.")] = None,
    scenes: ScenesOption = SCENES,
    ngsim: Annotated[
        Path | None,
        typer.Option(
            "--ngsim",
            "--scene-file",
            help="For ngsim_… and sumo_…: a file of `gri ngsim scenes` or `cosim scenes`; or NGSIM files to cut.",
        ),
    ] = None,
) -> None:
    """2. Train a model and write its checkpoint."""
    chosen = _read(config)
    path = out or Path("runs") / f"{chosen.name}-s{seed}.pt"
    splits = _scenes(chosen, scenes) if ngsim is None else _recorded(chosen, ngsim, scenes)
    with Bar() as progress:
        trained = train(chosen, splits, seed, progress)
    checkpoint.save(path, trained.model, trained.reward, trained.provenance)
    console.print(f"trained in {trained.provenance['seconds']} s, wrote {path}")
    next_command(f"gri evaluate {path}")


@app.command(name="evaluate")
def evaluate_command(
    path: Annotated[Path, typer.Argument(metavar="CHECKPOINT", help="A checkpoint file, or a released one's name.")],
    scenes: ScenesOption = SCENES,
    scene_file: Annotated[
        Path | None,
        typer.Option(help="Score it on this scene file instead, of `gri ngsim scenes` or `cosim scenes`."),
    ] = None,
    split: Annotated[str | None, typer.Option(help="Of the scene file; default: all its scenes.")] = None,
) -> None:
    """3. Score a checkpoint on the test scenes it was not trained on."""
    path = resources.checkpoint_at(path)
    model, made = checkpoint.load(path), checkpoint.provenance(path)
    if "config" not in made:
        raise InputError(f"{path}: does not say which scenes it belongs to; evaluate one written by `gri train`")
    config = msgspec.convert(made["config"], TrainConfig)
    found = None
    if scene_file is None:
        test = _scenes(config, scenes).test
    elif config.data.tested_on is not None:
        test, found, drawn = scenes_to_test(scene_file, config.data.tested_on, split)
        if drawn:
            console.print(f"left out: {drawn} scenes with drawn lateral motion, which are for training")
    else:
        raise InputError(
            f"{path}: was trained on scenes of range {config.data.range}, which no scene file has; give one of recorded"
            " traffic, of SUMO's, or of scenes like SUMO's (us101, highway_merge)"
        )
    console.print(_table(path.stem, evaluate(model, test), len(test)))
    infers = model.encoder is not None
    if infers and found is not None and found.hypothesis is not None and found.unambiguous is not None:
        compared = compare_with_truth(driving_graph(model, test).map, test.graph, found.hypothesis, found.unambiguous)
        for table in truth_tables(compared, model.config.vocabulary):
            console.print(table)
    next_command("cosim --help")


@app.command(name="reproduce")
def reproduce_command(
    target: Annotated[str, typer.Argument(help=f"One of {', '.join([*TABLES, 'table2'])}.")],
    seeds: Annotated[int, typer.Option(help="Seeds per row.")] = 5,
    test: Annotated[int, typer.Option("--scenes", help="Test scenes.")] = 1000,
    out: Annotated[Path, typer.Option(help="Folder for tables and figures.")] = Path("runs/reproduce"),
    cache: Annotated[Path, typer.Option(help="Folder of finished rows and seeds.")] = Path("runs/reproduce/jobs"),
    scenes: Annotated[Path, typer.Option("--scenes-folder", help="Folder in which scenes are kept.")] = SCENES,
    scenario: Annotated[str | None, typer.Option(help="Only this scenario.")] = None,
    row: Annotated[list[str] | None, typer.Option(help="Only this row; may be given several times.")] = None,
    processes: Annotated[int, typer.Option(help="Trainings at a time, one thread each.")] = 2,
    ngsim: Annotated[
        Path | None, typer.Option(help="For table2: a folder of NGSIM files, or a scene file cut from them.")
    ] = None,
    quick: Annotated[bool, typer.Option(help="Few scenes and updates: shows that all runs, no more.")] = False,
    finished: Annotated[bool, typer.Option("--finished", help="Take what is finished, train nothing.")] = False,
) -> None:
    """4. Train what a table or figure of the paper needs, and write it beside the printed figures."""
    from gri.paper.publish import publish  # brings pandas and matplotlib, which the other commands need not wait for

    if target == "table2":
        _reproduce_table2(ngsim, scenario, seeds, out, cache, tuple(row or ()), finished)
        return
    if target not in TABLES:
        raise InputError(f"got {target}, wanted one of {', '.join([*TABLES, 'table2'])}")
    plan = Plan(target, seeds, test, out, cache, scenes, scenario, tuple(row or ()), quick, processes, finished)  # type: ignore[arg-type]
    try:
        with Bar() as progress:
            written = publish(plan, progress)
    except KeyboardInterrupt:
        console.print("interrupted; the same command goes on from here")
        raise SystemExit(130) from None
    for path in written:
        console.print(str(path), soft_wrap=True)
    following = {"table1": "gri reproduce table3", "table3": "gri reproduce ood", "ood": "gri reproduce figures"}
    next_command(following.get(target, "cosim --help"))


def _reproduce_table2(
    ngsim: Path | None,
    scenario: str | None,
    seeds: int,
    out: Path,
    cache: Path,
    rows: tuple[str, ...],
    finished: bool,
) -> None:
    from gri.paper.table2_report import Order, publish  # brings matplotlib

    if ngsim is None:
        raise InputError("table2 needs recorded data: give --ngsim FOLDER with NGSIM files, or a scene file")
    if scenario is not None and scenario not in RECORDED:
        raise InputError(f"got scenario {scenario}, wanted one of {', '.join(RECORDED)}")
    written = []
    with Bar() as progress:
        for name in [scenario] if scenario else RECORDED:
            folder = out / name.removeprefix("ngsim_")
            written += publish(Order(name, ngsim, seeds, folder, cache, rows, finished), progress)
    for path in written:
        console.print(str(path), soft_wrap=True)
    next_command("gri reproduce figures")


def _read(config: str) -> TrainConfig:
    path = Path(config)
    if path.suffix:
        return read_train_config(path)
    shipped = resources.shipped("scenarios", "train")
    names = sorted(file.stem for file in shipped.glob("*.yaml"))
    if config not in names:
        raise InputError(f"got {config}, wanted a YAML file or one of {', '.join(names)}")
    return read_train_config(shipped / f"{config}.yaml")


def _scenes(config: TrainConfig, folder: Path) -> Splits:
    with Bar() as progress:
        return scenes_of(config.data, folder, progress)


def _recorded(config: TrainConfig, source: Path, folder: Path) -> Splits:
    if config.data.recorded is None:
        raise InputError(f"got --ngsim, but {config.name} learns from synthetic scenes; leave it out")
    with Bar() as progress:
        return recorded_splits(config.data.recorded, [scene_file(source, folder, progress)])


def _table(name: str, result: Evaluation, scenes: int) -> Table:
    table = Table("metric", "mean ± std over scenes", "95 % ±", title=f"{name}, {scenes} test scenes")
    rows = {f"RMSE_{name} [{'m/s' if name == 'v' else 'm'}]": value for name, value in result.rmse.items()}
    rows["accuracy, 6 edges"] = result.accuracy
    rows["accuracy, 4 edges into driven vehicles"] = result.driven_accuracy
    if result.chain_accuracy is not None:
        rows[f"accuracy in {result.chain_accuracy.scenes} scenes with the paper's graph"] = result.chain_accuracy
    for metric, value in rows.items():
        table.add_row(escape(metric), str(value), f"{value.half_width:.4f}")
    for kind, value in result.f1.items():
        table.add_row(f"F1 of type {kind}", f"{value:.4f}", "")
    return table


def main() -> None:
    """Entry point: bad input is one line on stderr and exit code 2."""
    torch.set_num_threads(1)  # the matrices are small; more threads are slower
    try:
        app()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
