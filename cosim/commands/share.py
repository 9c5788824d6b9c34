"""What `cosim run` does with a scenario in which policies drive shares of the traffic."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gri.errors import InputError
from gri.table import TableFormat
from gri.terminal import ProgressDisplay, fail, notice, show_tables


def run_share(
    scenario: str,
    seed: int | None,
    out: Path | None,
    settings: Sequence[str],
    max_work: float | None,
    allow_code: bool,
    table_format: TableFormat,
    only_for_groups: Mapping[str, Any],
) -> None:
    """Run the scenario and show its figures. Options in `only_for_groups` that have a value are refused."""
    if given := [option for option, value in only_for_groups.items() if value is not None]:
        raise InputError(f"{given[0]}: {scenario} has a share of the traffic and no groups; leave this option out")
    from cosim.runs.traffic_run import run_traffic

    began = time.monotonic()
    with ProgressDisplay() as progress:
        done = run_traffic(
            scenario,
            seed=seed,
            overrides={} if max_work is None else {"max_work": max_work},
            settings=settings,
            folder=out,
            allow_code=allow_code,
            progress=progress,
        )
    show_tables(
        [done.summary()],
        table_format,
        f"{time.monotonic() - began:.0f} s. Tables, manifest and picture: {done.folder}",
        then="cosim batch penetration",
    )
    for warning in done.warnings():
        notice(f"warning: {warning}")
    if failures := done.policy_failures:
        fail(f"the policy failed; its vehicles were left to SUMO from then on. {failures[0]}", 1)


def show_share(folder: Path, table_format: TableFormat) -> None:
    """Show the figures of a finished run again, and draw its picture."""
    from cosim.runs.space_time_figure import space_time_picture
    from cosim.runs.traffic_run import open_traffic_run

    done = open_traffic_run(folder)
    facts, picture = done.manifest["arguments"], folder / "space-time.png"
    title = ", ".join(f"{100 * share:g} % {name}" for name, share in facts["shares"].items())
    space_time_picture(done.space_time, picture, title, done.samples, facts["merge"])
    show_tables([done.summary()], table_format, f"Picture: {picture}", then="cosim batch penetration")
