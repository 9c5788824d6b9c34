"""`cosim check`: what fits in a scenario and what does not, before it runs."""

from pathlib import Path
from textwrap import fill

import typer

from cosim.commands.arguments import AllowCodeOption, ScenarioArgument
from gri.storage.scratch import ScratchFolder
from gri.terminal import ProgressDisplay, next_command, say


def check(scenario: ScenarioArgument, allow_code: AllowCodeOption = False) -> None:
    """Say what fits in a scenario and what does not.

    The command reads the scenario and its files, starts SUMO, and simulates a
    minute of the traffic. It prints a line for every part: ok, a warning, or an
    error. The exit code is 2 if the scenario cannot run.
    """
    import msgspec

    from cosim.process.worker_process import run_in_worker
    from cosim.proposals.check import Verdict
    from cosim.spec.input_files import input_files, refuse_foreign_code
    from cosim.spec.loading import find_file, load_scenario

    loaded = load_scenario(scenario)
    refuse_foreign_code(msgspec.to_builtins(loaded.policy), find_file(scenario, "scenarios", "scenario"), allow_code)
    files = input_files(loaded)
    say(_told("ok", f"files: {', '.join(path.name for path in files.values())}"))
    with ScratchFolder() as scratch, ProgressDisplay() as progress:
        log = Path(scratch, "sumo.log")
        findings = run_in_worker("cosim.proposals.check:check_scenario", loaded, log=log, tell=progress)
    for finding in findings:
        say(_told(finding.verdict.value, finding.text))
    if any(finding.verdict is Verdict.ERROR for finding in findings):
        raise typer.Exit(2)
    next_command(f"cosim run {scenario}")


def _told(verdict: str, text: str) -> str:
    """A finding in lines of at most 80 columns."""
    return fill(f"{verdict:<7} {text}", 80, subsequent_indent=" " * 8, break_long_words=False)
