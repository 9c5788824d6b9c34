"""`cosim new`: a scenario for SUMO files of the user."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from gri.errors import InputError
from gri.storage.scratch import ScratchFolder
from gri.terminal import ProgressDisplay, ShowProgress, next_command, say

if TYPE_CHECKING:
    from cosim.proposals.propose import Proposals

TRIAL = 180.0  # [s] of traffic after the warm-up


def new(
    sumocfg: Annotated[
        Path, typer.Argument(metavar="SUMOCFG", help="Your SUMO configuration (.sumocfg), or a map (.osm.xml, .xodr).")
    ],
    rule: Annotated[
        Literal["car_following", "merge"] | None,
        typer.Option(help="Kind of groups; by default merges where a lane ends, else car following."),
    ] = None,
    seconds: Annotated[float, typer.Option(help="How long to watch the traffic [s].")] = 300.0,
    out: Annotated[Path | None, typer.Option(help="Scenario file to write; by default beside the SUMOCFG.")] = None,
) -> None:
    """Propose a scenario for your own SUMO files, and draw its road.

    The command runs your traffic for some minutes and looks which road most
    vehicles use, where lanes end and how fast vehicles are. It counts the groups
    of every rule that fits the road, writes the scenario that has some, and a
    picture of the road. Of a map it makes net, demand and configuration first.
    """
    from cosim.process.worker_process import run_in_worker
    from cosim.proposals.map_file import convert, map_suffix
    from cosim.proposals.picture import draw_road
    from cosim.proposals.propose import proposals

    if map_suffix(sumocfg) is not None:
        sumocfg = convert(sumocfg)
        say(f"Configuration: {sumocfg}, with usual flows; replace them by measured ones.")
    path = out or sumocfg.with_suffix(".yaml")
    picture = path.with_suffix(".png")
    for written in (path, picture):
        if written.exists():
            raise InputError(f"{written}: the file is there already; move it, or give another one with --out FILE")
    if not 30 <= seconds <= 86_400:
        raise InputError(f"--seconds: got {seconds:g}, expected a time from 30 to 86400 s")
    with ScratchFolder() as scratch, ProgressDisplay() as progress:
        log = Path(scratch, "worker.log")
        use = run_in_worker("cosim.proposals.propose:observe", sumocfg, seconds, 0.2, log=log, tell=progress)
        made = proposals(sumocfg, path.parent, use, rule)
        counts = _count(made, path, log, progress)
    best = max(counts, key=lambda k: (counts[k] > 0, -k))
    chosen = made.each[best]
    path.write_text(chosen.text, encoding="utf-8")
    draw_road(made.net, made.road, chosen.choice, picture)
    road = made.road
    say(f"Main road: {' → '.join(road.edges)}, {road.length:.0f} m, {road.vehicles} vehicles in {seconds:g} s.")
    for lane in road.ending:
        goes = "joins" if lane.joins else "leads to another road" if lane.leads_off else "ends"
        fed = f", fed by {', '.join(lane.entries)}" if lane.entries else ", fed by no ramp"
        say(f"Lane {lane.lane} {goes} on the {lane.side} at s = {lane.end:g} m{fed}.")
    for option, value in made.given.replaced.items():
        say(f"Your {option} = {value} is replaced by the coupling's (docs/own-scenarios.md).")
    if use.waiting:
        say(f"{use.waiting} vehicles wait for room to enter the net after {seconds:g} s.")
    for k, count in counts.items():
        choice = made.each[k].choice
        where = f" from {choice.lane.lane}" if choice.lane else ""
        taken = ", chosen" if k == best and len(counts) > 1 else ""
        say(f"{choice.rule.replace('_', ' ')}{where}: {count} groups found within {TRIAL:g} s{taken}.")
    if counts[best] == 0:
        say("Nothing fits as it is. `cosim run` says which limit of the rule fails how often.")
    say(f"Scenario: {path}\nPicture: {picture}")
    next_command(f"cosim run {path}")


def _count(made: "Proposals", path: Path, log: Path, progress: ShowProgress) -> dict[int, int]:
    """How many groups the traffic has for each proposal, up to the first one that has some."""
    from cosim.process.worker_process import run_in_worker
    from cosim.spec.loading import load_scenario, override

    counts: dict[int, int] = {}
    for k, proposal in enumerate(made.each):
        path.write_text(proposal.text, encoding="utf-8")
        try:
            scenario = load_scenario(str(path))
        finally:
            path.unlink()
        trial = override(scenario, {"policy": {"kind": "sumo"}, "episodes": 10, "time_limit": TRIAL})
        counts[k] = run_in_worker("cosim.proposals.propose:count_groups", trial, log=log, tell=progress)
        if counts[k]:
            break
    return counts
