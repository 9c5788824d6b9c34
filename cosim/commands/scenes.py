"""`cosim scenes`."""

import os
import time
from pathlib import Path
from typing import Annotated

import typer

from cosim.process.terminal import SceneProgress, console, next_command, say


def scenes(
    scenario: Annotated[str, typer.Argument(help="Name of a shipped scenario, or path of a YAML file.")],
    out: Annotated[Path, typer.Option(help="Folder to write: scenes.parquet and report.json.")],
    count: Annotated[int, typer.Option(min=1, help="Scenes of each kind.")] = 1000,
    kind: Annotated[list[str] | None, typer.Option(help="car_following or merge; default: both.")] = None,
    gold: Annotated[bool, typer.Option("--gold", help="Label by intervention in copies of the simulation.")] = False,
    seed: Annotated[int | None, typer.Option(help="The first seed; default: the scenario's.")] = None,
    per_seed: Annotated[
        int | None, typer.Option(min=1, help="Scenes of a kind per seed, at most; default: a tenth, 250 at most.")
    ] = None,
    step: Annotated[float | None, typer.Option(help="Simulate with this step [s]; 0.2 must be a multiple.")] = None,
    any_change: Annotated[
        bool, typer.Option("--any-change", help="Merges are lane changes for any reason, not only necessary ones.")
    ] = False,
    at_most: Annotated[
        list[str] | None,
        typer.Option(help="TYPE=SHARE: so many scenes of a kind, at most, whose rarest edge is cut_in, yield, follow."),
    ] = None,
    interaction: Annotated[float | None, typer.Option(help="Least time of interaction in a scene [s].")] = None,
    spacing: Annotated[float | None, typer.Option(help="Greatest distance to the vehicle ahead [m].")] = None,
    per_vehicle: Annotated[int | None, typer.Option(min=1, help="Scenes of a kind that a vehicle may be in.")] = None,
    reduction: Annotated[str, typer.Option(help="Of the steps to one graph: strongest or longest.")] = "strongest",
    workers: Annotated[int | None, typer.Option(min=1, help="Seeds at a time; default: one per core.")] = None,
) -> None:
    """Cut three-vehicle scenes out of live traffic, with the relations that the simulator knows."""
    from cosim.commands.scene_options import changed, kinds_of, rules_of
    from cosim.spec.loading import load_scenario, override

    chosen = changed(override(load_scenario(scenario), {} if seed is None else {"seed": seed}), scenario, step)
    rules = rules_of(
        strategic=not any_change, at_most=at_most or [], interaction=interaction, spacing=spacing,
        per_vehicle=per_vehicle, reduction=reduction,
    )  # fmt: skip
    from cosim.scenes.dataset import Order, make
    from cosim.scenes.dataset_report import report_of, tables

    order = Order(
        scenario=chosen,
        source=Path(scenario).stem,
        kinds=kinds_of(kind),
        count=count,
        per_seed=per_seed or min(-(-count // 10), 250),
        gold=gold,
        rules=rules,
    )
    began = time.monotonic()
    with SceneProgress() as progress:
        made = make(order, out, workers or os.cpu_count() or 1, progress.tell)
    report = report_of(order, made, time.monotonic() - began, out)
    for table in tables(report):
        console.print(table)
    say(report["cost"]["text"])
    config = "sumo_car_following" if "car_following" in order.kinds else "sumo_merge"
    next_command(f"gri train {config} --scene-file {made.path}")
