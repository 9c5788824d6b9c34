"""Arguments and options that several commands have, with their help."""

from pathlib import Path
from typing import Annotated

import typer

from gri.terminal import finite

ScenarioArgument = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="Name of a shipped scenario, or path of a YAML file.")
]
SeedOption = Annotated[int | None, typer.Option(help="Seed to use instead of the scenario's.")]
DurationOption = Annotated[float, typer.Option(min=1, callback=finite, help="Time to record after the warm-up [s].")]
WorkersOption = Annotated[int | None, typer.Option(min=1, help="Simulations at a time; default: one per core.")]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder, also one of a batch: BATCH/runs/ID.")]
EpisodeOption = Annotated[int, typer.Option(help="Number of the episode in the run.")]
MaxWorkOption = Annotated[
    float | None,
    typer.Option(
        min=0.001,
        max=10_000,
        callback=finite,
        help="Allow this many times the usual limits of steps, vehicles and memory; default: the scenario's max_work.",
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="FIELD=VALUE",
        help="Change a field of the scenario, such as group.max_gap=20; the value is written as in YAML; repeatable.",
    ),
]
AllowCodeOption = Annotated[
    bool,
    typer.Option("--allow-code", help="Run policies (kind: python) whose code is outside the folder of the file."),
]
FEWER_THAN_ASKED = 3  # exit code: all runs are complete, but the traffic had fewer groups than asked for
