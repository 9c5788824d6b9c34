"""The command `cosim stress`."""

import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from cosim.process.terminal import Stages, console, errors, next_command, say


def stress(
    scenario: Annotated[str, typer.Argument(help="Name of a shipped scenario, or path of a YAML file.")],
    policy: Annotated[
        str,
        typer.Option(help="Policies: gri, supervised, … (checkpoints by name or path), idm, constant_velocity, sumo."),
    ] = "gri,idm,sumo",
    perturbation: Annotated[str, typer.Option(help="Kinds of perturbation, separated by commas.")] = "headway_ratio",
    intensity: Annotated[str, typer.Option(help="Intensities of a single kind; default: five of its own.")] = "",
    starts: Annotated[int, typer.Option(min=1, help="Groups that are driven by every policy in every cell.")] = 100,
    workers: Annotated[int, typer.Option(min=1, help="Simulations at a time.")] = 2,
    out: Annotated[Path | None, typer.Option(help="Folder of the results; default: runs/stress/SCENARIO.")] = None,
) -> None:
    """Drive the same groups under graded perturbations by several policies; stop and continue at will."""
    from cosim.spec.loading import load_scenario
    from cosim.stress.plan import chunks, policies_of, sweeps_of

    chosen = load_scenario(scenario)
    grades = _numbers(intensity)
    sweeps = sweeps_of(_words(perturbation), grades, chosen)
    parts = chunks(chosen, policies_of(_words(policy), chosen), sweeps, starts)
    from cosim.stress.stress_test import publish, run_stress

    folder = out or Path("runs", "stress", Path(scenario).stem)
    began = time.monotonic()
    try:
        with Stages() as progress:
            rows, made = run_stress(parts, folder, workers, progress.tell)
            command = shlex.join(["cosim", *sys.argv[1:]])
            facts = {"command": command, "worker_seconds": round(made.seconds, 1), "commits": made.commits}
            facts |= {"starts": starts, "workers": workers}
            written = publish(parts, rows, folder, facts)
    except KeyboardInterrupt:
        errors.print(f"stopped; finished parts are kept in {folder}, the same command goes on", markup=False)
        raise typer.Exit(130) from None
    console.print(f"{time.monotonic() - began:.0f} s.", *map(str, written), sep="\n  ", soft_wrap=True)
    say(f"\nRead {folder / 'stress.md'}, look at {folder / 'figures'}.")
    next_command(f"python -c \"import pandas; print(pandas.read_parquet('{folder}/estimates.parquet'))\"")


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _numbers(text: str) -> list[float]:
    try:
        return [float(word) for word in _words(text)]
    except ValueError:
        from gri.errors import InputError

        raise InputError(f"--intensity: got {text!r}, expected numbers separated by commas") from None
