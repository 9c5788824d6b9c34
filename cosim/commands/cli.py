"""The `cosim` command."""

import json
import sys
import time
from pathlib import Path
from typing import Annotated, Literal, NoReturn

import msgspec
import typer

from cosim.commands import batch as batch_commands
from cosim.commands import show as show_commands
from cosim.commands import traffic
from cosim.commands.scenes import scenes
from cosim.commands.stress import stress
from cosim.process.terminal import Stages, console, errors, next_command, say
from gri.errors import InputError

# Each command imports what it needs: torch and SUMO take seconds to import, and `--help` should not.

app = typer.Typer(
    help="Run driving policies in closed loop with SUMO traffic.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="Name of a shipped scenario, or path of a YAML file.")],
    baseline: Annotated[
        Literal["sumo", "idm", "constant-velocity"] | None,
        typer.Option(help="Drive the same groups with a baseline instead of the scenario's policy."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Replace the scenario's seed.")] = None,
    episodes: Annotated[int | None, typer.Option(help="Replace the scenario's number of episodes.")] = None,
    recording: Annotated[Path | None, typer.Option(help="The NGSIM file that the scenario replays.")] = None,
    out: Annotated[Path | None, typer.Option(help="Run folder to write; default: a new one in runs/.")] = None,
) -> None:
    """Take three-vehicle groups out of live traffic, drive them, hand them back."""
    from cosim.runs.run import run as run_scenario
    from cosim.runs.summary import terminal_table

    began = time.monotonic()
    with Stages() as progress:
        done = run_scenario(
            scenario, baseline, seed=seed, episodes=episodes, recording=recording, folder=out, progress=progress.tell
        )
    console.print(terminal_table(done.groups))
    say(f"\n{time.monotonic() - began:.0f} s. Tables, manifest and picture: {done.folder}")
    next_command(f"cosim report {done.folder}" if baseline else f"cosim run {scenario} --baseline idm")


for _command in (traffic.traffic, traffic.calibrate, traffic.realism):
    app.command()(_command)


app.command()(scenes)
app.command()(stress)
app.command()(batch_commands.batch)
app.command()(batch_commands.results)
for _command in (show_commands.report, show_commands.render, show_commands.explain, show_commands.gui):
    app.command()(_command)


@app.command("list")
def list_() -> None:
    """List the scenarios, nets and checkpoints that come with the project."""
    from cosim.spec.loading import load_scenario, names_of
    from gri.resources import checkpoints, shipped

    say("[bold]scenarios[/bold]")
    for name in names_of("scenarios"):
        say(f"  {name}  {load_scenario(name).description}")
    say("[bold]nets[/bold]")
    for path in sorted(shipped("sumo_nets").glob("*/*.net.xml")):
        say(f"  {path.parent.name}  {path}")
    say(f"[bold]checkpoints[/bold]\n  {', '.join(checkpoints())}")
    next_command("cosim run us101_car_following")


@app.command()
def schema(
    of: Annotated[Literal["scenario", "batch"], typer.Argument(help="The kind of file.")] = "scenario",
    markdown: Annotated[bool, typer.Option("--markdown", help="All fields of both kinds, for reading.")] = False,
) -> None:
    """Print the JSON Schema of scenario or batch files, for editors, or a reference of their fields, for people."""
    if markdown:
        from cosim.commands.field_reference import markdown as reference

        sys.stdout.write(reference())
        return
    if of == "batch":
        from cosim.batch.spec import json_schema
    else:
        from cosim.spec.scenario import json_schema

    sys.stdout.write(msgspec.json.format(json.dumps(json_schema())) + "\n")


def _fail(message: str, code: int) -> NoReturn:
    errors.print(f"error: {message}", markup=False, soft_wrap=True)
    sys.exit(code)


def main() -> None:
    """Entry point: input errors are one line and exit code 2, failures exit code 1, Ctrl-C 130."""
    try:
        app(standalone_mode=True)
    except InputError as error:
        _fail(str(error), 2)
    except KeyboardInterrupt:
        _fail("stopped; nothing was left half-written", 130)
    except RuntimeError as error:
        _fail(str(error), 1)
