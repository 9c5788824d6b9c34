"""The `cosim` command: its subcommands, and what happens when one fails."""

import json
import sys
import time
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any, Literal

import msgspec
import typer

from cosim.commands.arguments import (
    FEWER_THAN_ASKED,
    AllowCodeOption,
    MaxWorkOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
)
from cosim.commands.batch import batch, results
from cosim.commands.check import check
from cosim.commands.cutin_grid import cutin_grid
from cosim.commands.doctor import doctor
from cosim.commands.export import export
from cosim.commands.new import new
from cosim.commands.realism import realism
from cosim.commands.scenes import scenes
from cosim.commands.show import explain, gui, render, report
from cosim.commands.stress import stress
from cosim.commands.traffic import calibrate, traffic
from gri.errors import SYSTEM_ERRORS, InputError, refused_by_system
from gri.processes import stop_like_ctrl_c
from gri.table import Table
from gri.terminal import (
    FormatOption,
    ProgressDisplay,
    console,
    fail,
    next_command,
    notice,
    say,
    show_tables,
    show_version,
    use_any_encoding,
)

# Each command imports what it needs: torch and SUMO take seconds to import, and `--help` should not.
# Without a markup mode the help is plain text: units in square brackets, such as [s], would vanish as Rich markup.

INDENT = "      "
EMPTY_GRAPH = {"source": "enforced", "edges": {}, "others": "none"}  # for comparison: nobody reacts to anybody
app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


def _version(wanted: bool) -> bool:
    if wanted:
        show_version("cosim")
    return wanted


@app.callback()
def cosim(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Run driving policies in closed loop with SUMO traffic."""


@app.command()
def run(
    scenario: ScenarioArgument,
    policy: Annotated[
        str | None,
        typer.Option(
            help="Policy to use instead of the scenario's: sumo, idm, constant_velocity, the name or path of a"
            " checkpoint, or file.py:Name of your own."
        ),
    ] = None,
    baseline: Annotated[
        Literal["sumo", "idm", "constant-velocity", "empty-graph"] | None,
        typer.Option(
            help="Drive the same groups with a baseline instead of the scenario's policy; empty-graph: with that"
            " policy, but without any relation."
        ),
    ] = None,
    seed: SeedOption = None,
    episodes: Annotated[int | None, typer.Option(help="Number of episodes to use instead of the scenario's.")] = None,
    recording: Annotated[Path | None, typer.Option(help="The recording that the scenario replays.")] = None,
    out: Annotated[Path | None, typer.Option(help="Run folder to write; default: a new one in runs/.")] = None,
    settings: SetOption = None,
    max_work: MaxWorkOption = None,
    allow_code: AllowCodeOption = False,
    table_format: FormatOption = "table",
) -> None:
    """Take groups out of live traffic, drive them, hand them back.

    A policy drives every group of vehicles for the horizon of the scenario. The
    table compares it with the same groups left to SUMO. The exit code is 3 if the
    traffic had fewer groups than asked for.

    In a scenario with a `share`, policies drive this share of all vehicles from
    entry to exit instead, and the table shows the traffic.
    """
    from cosim.spec.input_files import find_net
    from cosim.spec.loading import load_scenario
    from cosim.spec.settings import settings_of

    if policy and baseline:
        raise InputError("--policy and --baseline: both name what drives the groups; give one of them")
    driver = policy or (None if baseline == "empty-graph" else baseline)
    own = {"policy": driver, "seed": seed, "episodes": episodes, "max_work": max_work}
    for field in own.keys() & settings_of(settings or ()):
        if (value := own[field]) is not None:
            raise InputError(f"--set: {field} is also given by an option of its own ({value}); give one of them")
    chosen = load_scenario(scenario, max_work=max_work, settings=settings or ())
    find_net(chosen.net)  # before torch is imported
    if chosen.has_shares:
        from cosim.commands.share import run_share

        for_groups = {"--policy": policy, "--baseline": baseline, "--episodes": episodes, "--recording": recording}
        return run_share(scenario, seed, out, settings or (), max_work, allow_code, table_format, for_groups)
    from cosim.runs.run import run as run_scenario

    changes: dict[str, Any] = {} if max_work is None else {"max_work": max_work}
    if baseline == "empty-graph":
        changes["graph"] = EMPTY_GRAPH
    began = time.monotonic()
    with ProgressDisplay() as progress:
        done = run_scenario(
            scenario,
            driver,
            seed=seed,
            episodes=episodes,
            recording=recording,
            overrides=changes,
            settings=settings or (),
            folder=out,
            allow_code=allow_code,
            progress=progress,
        )
    from cosim.perturb.effects import shown_effects  # with all of pandas, which a run in its worker does not wait for
    from cosim.runs.summary import summary_table

    show_tables(
        [
            summary_table(done.groups, done.counterparts, done.manifest["arguments"]["episodes"]),
            *([shown_effects(done.effects)] if len(done.effects) else []),
        ],
        table_format,
        f"{time.monotonic() - began:.0f} s. Tables, manifest and picture: {done.folder}",
        then=f"cosim report {done.folder}" if baseline or policy else f"cosim run {scenario} --baseline idm",
    )
    for note in done.notes():
        notice(note)
    for warning in done.warnings():
        notice(f"warning: {warning}")
    if failures := done.policy_failures:
        more = f" (and {len(failures) - 1} more groups)" if len(failures) > 1 else ""
        fail(f"the policy failed; its groups count as not completed. {failures[0]}{more}", 1)
    if done.missing_episodes:
        raise typer.Exit(FEWER_THAN_ASKED)


for _command in (
    new,
    check,
    report,
    explain,
    render,
    export,
    gui,
    traffic,
    calibrate,
    realism,
    scenes,
    stress,
    cutin_grid,
    batch,
    results,
    doctor,
):
    app.command()(_command)


@app.command("list")
def list_(table_format: FormatOption = "table") -> None:
    """List the shipped scenarios, nets and checkpoints."""
    from cosim.spec.loading import load_scenario, shipped_names
    from gri.resources import checkpoints, shipped

    named = [
        ("scenario", [(name, load_scenario(name).description) for name in shipped_names("scenarios")]),
        ("net", [(path.parent.name, str(path)) for path in sorted(shipped("sumo_nets").glob("*/*.net.xml"))]),
        ("checkpoint", [(name, "") for name in checkpoints()]),
    ]
    if table_format != "table":
        rows = [(kind, name, text) for kind, found in named for name, text in found]
        head = ("kind", "name", "description")
        return show_tables(
            [Table("shipped", head, rows, [dict(zip(head, row, strict=True)) for row in rows])], table_format
        )
    for kind, found in named:
        console.print(f"{kind}s", style="bold")
        for name, text in found:
            say(f"  {name}")
            if text:
                say(fill(text, 78, initial_indent=INDENT, subsequent_indent=INDENT, break_long_words=False))
    next_command("cosim run us101_car_following")


@app.command()
def schema(
    of: Annotated[
        Literal["scenario", "batch"], typer.Argument(metavar="KIND", help="Kind of file: scenario or batch.")
    ] = "scenario",
    markdown: Annotated[bool, typer.Option("--markdown", help="Print a reference of all fields for reading.")] = False,
) -> None:
    """Print the JSON Schema of scenario or batch files.

    Editors use it to complete and check YAML files. With --markdown, print a
    reference of the fields of both kinds instead.
    """
    if markdown:
        from cosim.commands.field_reference import markdown as reference

        sys.stdout.write(reference())
        return
    if of == "batch":
        from cosim.batch.spec import json_schema
    else:
        from cosim.spec.loading import json_schema

    sys.stdout.write(msgspec.json.format(json.dumps(json_schema())) + "\n")


def main() -> None:
    """Entry point. Errors are one line on stderr; the exit code is 2 for bad input, 1 for failures, 130 for Ctrl-C.

    A run or batch that is complete but found fewer episodes than asked for ends with 3.
    """
    stop_like_ctrl_c()
    use_any_encoding()
    try:
        app(standalone_mode=True)
    except InputError as error:
        fail(str(error), 2)
    except KeyboardInterrupt:
        fail("stopped; nothing was left half-written", 130)
    except RuntimeError as error:
        fail(str(error), 1)
    except SYSTEM_ERRORS as error:
        fail(refused_by_system(error), 1)
