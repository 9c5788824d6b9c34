"""`cosim new`: a scenario for SUMO files of the user."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from gri.errors import InputError
from gri.terminal import ProgressDisplay, next_command, say


def new(
    sumocfg: Annotated[Path, typer.Argument(metavar="SUMOCFG", help="Your SUMO configuration (.sumocfg).")],
    rule: Annotated[
        Literal["car_following", "merge"] | None,
        typer.Option(help="Kind of groups; by default merges where a lane ends, else car following."),
    ] = None,
    seconds: Annotated[float, typer.Option(help="How long to watch the traffic [s].")] = 300.0,
    out: Annotated[Path | None, typer.Option(help="Scenario file to write; by default beside the SUMOCFG.")] = None,
) -> None:
    """Propose a scenario for your own SUMO files, and draw its road.

    The command runs your traffic for some minutes and looks which road most
    vehicles use and where lanes end. It writes a scenario that runs, a picture of
    the road, and says how many groups the traffic has.
    """
    from cosim.process.worker_process import run_in_worker
    from cosim.proposals.picture import draw_road
    from cosim.proposals.propose import proposal
    from cosim.proposals.scenario_file import merging_lane
    from cosim.spec.loading import load_scenario, override

    path = out or sumocfg.with_suffix(".yaml")
    if path.exists():
        raise InputError(f"{path}: the file is there already; give another one with --out FILE")
    if not 30 <= seconds <= 86_400:
        raise InputError(f"--seconds: got {seconds:g}, expected a time from 30 to 86400 s")
    log = path.with_suffix(".log")
    try:
        with ProgressDisplay() as progress:
            use = run_in_worker("cosim.proposals.propose:observe", sumocfg, seconds, 0.2, log=log, tell=progress)
            made = proposal(sumocfg, path.parent, use, rule)
            path.write_text(made.text, encoding="utf-8")
            scenario = load_scenario(str(path))
            trial = override(scenario, {"policy": {"kind": "sumo"}, "episodes": 10, "time_limit": 180.0})
            groups = run_in_worker("cosim.proposals.propose:count_groups", trial, log=log, tell=progress)
    finally:
        log.unlink(missing_ok=True)
    picture = path.with_suffix(".png")
    draw_road(made.net, made.road, merging_lane(made.road) if made.rule == "merge" else None, picture)
    road = made.road
    say(f"Main road: {' → '.join(road.edges)}, {road.length:.0f} m, {road.vehicles} vehicles in {seconds:g} s.")
    for lane in road.ending:
        goes = "joins" if lane.joins else "leads to another road" if lane.leads_off else "ends"
        fed = f", fed by {', '.join(lane.entries)}" if lane.entries else ", fed by no ramp"
        say(f"Lane {lane.lane} {goes} on the {lane.side} at s = {lane.end:g} m{fed}.")
    for option, value in made.given.replaced.items():
        say(f"Your {option} = {value} is replaced by the coupling's (docs/own-scenarios.md).")
    if made.use.waiting:
        say(f"{made.use.waiting} vehicles wait for room to enter the net after {seconds:g} s.")
    say(f"{made.rule.replace('_', ' ')}: {groups} groups found within 180 s after the warm-up (10 are enough).")
    say(f"Scenario: {path}\nPicture: {picture}")
    next_command(f"cosim run {path}")
