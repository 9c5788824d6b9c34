"""The command `cosim scenes`."""

import os
import time
from pathlib import Path
from typing import Annotated

import typer

from cosim.commands.arguments import MaxWorkOption, ScenarioArgument, SetOption
from gri.terminal import FormatOption, ProgressDisplay, finite, notice, show_tables


def scenes(
    scenario: ScenarioArgument,
    out: Annotated[Path, typer.Option(help="Folder to write scenes.parquet and report.json to.")],
    count: Annotated[int, typer.Option(min=1, help="Scenes of each kind.")] = 1000,
    kind: Annotated[
        list[str] | None, typer.Option(help="car_following, merge or triple; repeatable; default: the first two.")
    ] = None,
    gold: Annotated[
        bool, typer.Option("--gold", help="Label relations by interventions in copies of the simulation, not by rules.")
    ] = False,
    seed: Annotated[int | None, typer.Option(help="First seed; default: the scenario's.")] = None,
    per_seed: Annotated[
        int | None,
        typer.Option(min=1, help="Most scenes of each kind per seed; default: a tenth of --count, at most 250."),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(callback=finite, help="Step of the simulation [s]; 0.2 s must be a multiple of it."),
    ] = None,
    car_following: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL", help="Car-following model of all drivers: Krauss, IDM or EIDM; default: the scenario's."
        ),
    ] = None,
    any_change: Annotated[
        bool, typer.Option("--any-change", help="Take lane changes for any reason as merges, not only necessary ones.")
    ] = False,
    jitter: Annotated[
        float | None,
        typer.Option(callback=finite, help="Greatest time of a merge's lane change from the middle of its scene [s]."),
    ] = None,
    at_most: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TYPE=SHARE",
            help="Greatest share of the scenes of each kind whose rarest relation is TYPE (cut_in, yield or follow);"
            " repeatable.",
        ),
    ] = None,
    interaction: Annotated[
        float | None, typer.Option(callback=finite, help="Shortest time of interaction in a scene [s].")
    ] = None,
    spacing: Annotated[float | None, typer.Option(callback=finite, help="Greatest distance to the leader [m].")] = None,
    per_vehicle: Annotated[
        int | None, typer.Option(min=1, help="Most scenes of each kind that one vehicle may be in.")
    ] = None,
    reduction: Annotated[
        str, typer.Option(help="Relation of a pair in the graph of a scene: the strongest or the longest.")
    ] = "strongest",
    workers: Annotated[
        int | None, typer.Option(min=1, help="Seeds simulated at a time; default: one per core.")
    ] = None,
    settings: SetOption = None,
    max_work: MaxWorkOption = None,
    table_format: FormatOption = "table",
) -> None:
    """Make labelled scenes of vehicles from simulated traffic.

    The labels say which vehicle follows, yields to or cuts in on which. Scenes have three vehicles, or chains of
    group.size.
    """
    from cosim.commands.scene_options import changed, kinds_of, rules_of, with_car_following
    from cosim.spec.loading import load_scenario, override

    named = load_scenario(scenario, max_work=max_work, settings=settings or ())
    seeded = override(named, {} if seed is None else {"seed": seed})
    chosen = with_car_following(changed(seeded, scenario, step), car_following)
    rules = rules_of(
        strategic=not any_change, at_most=at_most or [], interaction=interaction, spacing=spacing,
        per_vehicle=per_vehicle, reduction=reduction, jitter=jitter,
    )  # fmt: skip
    kinds = kinds_of(kind, chosen.group.size)
    from cosim.scenes.dataset import DatasetSpec, make, remove_seeds
    from cosim.scenes.dataset_report import report_of, tables
    from gri.storage.claims import claimed_folder

    order = DatasetSpec(
        scenario=chosen,
        source=Path(scenario).stem,
        kinds=kinds,
        count=count,
        per_seed=per_seed or min(-(-count // 10), 250),
        gold=gold,
        rules=rules,
    )
    began = time.monotonic()
    with claimed_folder(out):
        with ProgressDisplay() as progress:
            made = make(
                order, out, workers or os.cpu_count() or 1, lambda done, total: progress("scenes", done, total), notice
            )
        report = report_of(order, made, time.monotonic() - began, out)
        remove_seeds(out)
    if order.kinds == ("triple",):
        following = f"gri bench relations --sumo {made.path}"
    else:
        config = "sumo_car_following" if "car_following" in order.kinds else "sumo_merge"
        following = f"gri train {config} --scene-file {made.path}"
    show_tables(list(tables(report)), table_format, report["cost"]["text"], then=following)
