"""The command `cosim stress`."""

import shlex
import sys
import time
from pathlib import Path
from typing import Annotated

import typer

from cosim.commands.arguments import FEWER_THAN_ASKED, AllowCodeOption, MaxWorkOption, ScenarioArgument, SetOption
from gri.terminal import ProgressDisplay, console, finite, next_command, notice, say


def stress(
    scenario: ScenarioArgument,
    policy: Annotated[
        str,
        typer.Option(
            help="Policies, separated by commas: idm, constant_velocity, sumo, gri (the scenario's checkpoint),"
            " supervised, own (the scenario's policy of kind: python), names and paths of checkpoints, or reference"
            " drivers (r157, careful_human, fsm, rss). With +rss at the end, such as gri+rss: with the safety filter;"
            " with +predict: told what late states are by now; with +ahead: also follows who is ahead in its lane."
        ),
    ] = "gri,idm,sumo",
    perturbation: Annotated[
        str,
        typer.Option(
            help="Kinds of perturbation, separated by commas, each with intensities of its own if you like:"
            " leader_braking:4:8,dropout. docs/stress.md lists them. all: every kind that makes sense for the scenario."
        ),
    ] = "all",
    intensity: Annotated[
        str,
        typer.Option(
            help="Intensities of a single kind, separated by commas, in its unit (m/s² for leader_braking);"
            " default: those of each kind."
        ),
    ] = "",
    levels: Annotated[
        int | None,
        typer.Option(min=1, max=5, help="Default intensities of each kind to use; default: 5, or 2 for all kinds."),
    ] = None,
    reinfer_s: Annotated[
        float | None,
        typer.Option(
            min=0,
            help="Time between two inferences of the graph [s], 0: only the first; default: the scenario's, or 1.",
        ),
    ] = None,
    starts: Annotated[
        int, typer.Option(min=1, max=100_000, help="Groups that every policy drives at every intensity.")
    ] = 100,
    until_decided: Annotated[
        str,
        typer.Option(
            metavar="A:B",
            help="Stop as soon as one of two policies is better at a single intensity; --starts is the maximum.",
        ),
    ] = "",
    error: Annotated[
        float,
        typer.Option(
            min=0.001, max=0.5, callback=finite, help="With --until-decided: probability of a wrong decision."
        ),
    ] = 0.05,
    workers: Annotated[int, typer.Option(min=1, help="Simulations at a time.")] = 2,
    out: Annotated[Path | None, typer.Option(help="Folder of the results; default: runs/stress/SCENARIO.")] = None,
    settings: SetOption = None,
    max_work: MaxWorkOption = None,
    allow_code: AllowCodeOption = False,
) -> None:
    """Compare policies on the same groups under perturbations.

    Every policy drives the same groups at every intensity of every perturbation.
    The same command continues a stress test that was stopped.
    """
    import msgspec

    from cosim.spec.input_files import refuse_foreign_code
    from cosim.spec.loading import find_file, load_scenario

    chosen = load_scenario(scenario, max_work=max_work, settings=settings or ())  # mistakes need not wait for torch
    grades = _numbers(intensity)
    from cosim.stress.plan import chunks, policies_of, senseless, sweeps_of

    sweeps = sweeps_of(_words(perturbation), grades, chosen, levels)
    if "all" in _words(perturbation):
        for kind, reason in senseless(chosen).items():
            notice(f"left out: {kind}, because {reason}")
    policies = policies_of(_words(policy), chosen)
    if "own" in {name.partition("+")[0] for name in policies}:
        refuse_foreign_code(
            msgspec.to_builtins(chosen.policy), find_file(scenario, "scenarios", "scenario"), allow_code
        )
    from cosim.show.stress_page import write_stress_page
    from cosim.stress.stress_test import fewer_starts, publish, run_stress
    from cosim.stress.until_decided import STARTS_PER_SEED, contest_of, run_until_decided, sentence
    from gri.storage.claims import claimed_folder

    contest = contest_of(until_decided, list(policies), sweeps, error) if until_decided else None
    per_seed = {"starts_per_seed": STARTS_PER_SEED} if contest else {}
    parts = chunks(chosen, policies, sweeps, starts, reinfer_s=reinfer_s, **per_seed)
    decided = ""
    folder = out or Path("runs", "stress", Path(scenario).stem)
    began = time.monotonic()
    try:
        with claimed_folder(folder), ProgressDisplay() as progress:
            if contest:
                parts, rows, computation, decision = run_until_decided(
                    parts, contest, folder, workers, progress, notice
                )
                decided = sentence(contest, decision)
            else:
                rows, computation = run_stress(parts, folder, workers, progress, notice)
            command = shlex.join(["cosim", *sys.argv[1:]])
            facts = {
                "command": command,
                "worker_seconds": round(computation.worker_seconds, 1),
                "commits": computation.commits,
            }
            facts |= {"starts": starts, "workers": workers}
            fewer = fewer_starts(parts, rows)
            written = publish(parts, rows, computation.effects, folder, facts, decided, fewer)
            written.append(write_stress_page(folder))
    except KeyboardInterrupt:
        notice(f"stopped; finished parts are kept in {folder}, the same command continues")
        raise typer.Exit(130) from None
    if decided:
        say(f"{decided}\n")
    console.print(f"{time.monotonic() - began:.0f} s.", *map(str, written), sep="\n  ", soft_wrap=True)
    say(f"\nReport: {folder / 'stress.md'}; for a browser: {folder / 'stress.html'}")
    next_command(f"python -c \"import pandas; print(pandas.read_parquet('{folder}/estimates.parquet'))\"")
    if fewer:
        notice(f"warning: {fewer}")
        raise typer.Exit(FEWER_THAN_ASKED)


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _numbers(text: str) -> list[float]:
    from gri.errors import InputError

    try:
        return [finite(float(word)) for word in _words(text)]
    except InputError:
        raise InputError(f"--intensity: got {text!r}, expected finite numbers") from None
    except ValueError:
        raise InputError(f"--intensity: got {text!r}, expected numbers separated by commas") from None
