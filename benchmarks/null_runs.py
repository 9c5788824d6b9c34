"""Does traffic that nobody drives stay safe for 30 minutes? Collisions, teleports, emergency braking, speed and flow.

Simulates the shipped traffic of both sites, plain and lively, after the warm-up with several seeds. An emergency
braking is a time in which a vehicle anywhere in the net brakes with more than 5 m/s²; SUMO's own count has those that
begin with the 9 m/s² of its drivers. One row per site and seed goes into a CSV file, to which a later call adds what is
missing, and one per emergency braking into another. The table in docs/lively-traffic.md is written from the rows.

    python benchmarks/null_runs.py
"""

import argparse
import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SimulationInput, SumoFiles, prepare_simulation
from cosim.world.snapshot import Snapshot
from gri.table import markdown_table

SCENARIOS = "us101_car_following", "i80_car_following", "us101_lively", "i80_lively"
HARD = 5.0  # [m/s²] of an emergency braking; drivers of the shipped traffic wish for 3.5 at most and are able to 9
PER = 1000.0  # [vehicle-minutes] to which brakings are related
OF_SUMO = re.compile(r"performs emergency braking.* time=(\d+\.\d+)")
HEAD = (
    "",
    "vehicle-minutes",
    "mean speed [km/h]",
    "flow [veh/h]",
    "collisions",
    "teleports",
    "emergency brakings",
    "of these in the study area",
    "per 1,000 vehicle-minutes",
    "SUMO's count",
    "per 1,000",
    "hardest [m/s²]",
)
BEGIN, END = "<!-- figures: written by benchmarks/null_runs.py -->\n", "<!-- end of figures -->"


@dataclass
class Brakings:
    """Emergency brakings so far, each with the place and time of its beginning, and its hardest moment."""

    found: list[dict[str, Any]] = field(default_factory=list)
    now: dict[str, dict[str, Any]] = field(default_factory=dict)
    hardest: float = 0.0

    def add(self, snapshot: Snapshot) -> None:
        """Look at the next step."""
        self.hardest = max(self.hardest, -float(snapshot.a.min(initial=0.0)))
        braking: dict[str, dict[str, Any]] = {}
        for row in np.flatnonzero(snapshot.a < -HARD - 1e-6):
            vehicle = snapshot.ids[row]
            facts = self.now.get(vehicle)
            if facts is None:
                place = {"lane": snapshot.lane[row], "s": float(snapshot.s[row]), "v": float(snapshot.v[row])}
                facts = {"time": snapshot.time, "vehicle": vehicle, **place, "braking": 0.0}
                self.found.append(facts)
            facts["braking"] = max(facts["braking"], -float(snapshot.a[row]))
            braking[vehicle] = facts
        self.now = braking


def null_run(scenario: Scenario, minutes: float) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The row of one run, and its emergency brakings; those of the warm-up are counted apart."""
    with tempfile.TemporaryDirectory() as scratch:
        files = SumoFiles(find_net(scenario.net), Path(scratch, "r.rou.xml"), Path(scratch, "sumo.log"))
        inputs = prepare_simulation(scenario, files, 60 * minutes)
        inputs.write()
        row, brakings = _simulated(inputs, 60 * minutes)
        times = [float(time) for time in OF_SUMO.findall(files.log.read_text())]
    begin = scenario.traffic.warm_up
    of_sumo = {"of_sumo": sum(t > begin for t in times), "of_sumo_warm_up": sum(t <= begin for t in times)}
    return row | of_sumo, brakings


def _simulated(inputs: SimulationInput, duration: float) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Simulate the warm-up and `duration` [s] more."""
    scenario = inputs.scenario
    counts: dict[str, int] = dict.fromkeys(("collisions", "teleports", "collisions_warm_up", "teleports_warm_up"), 0)
    brakings, early = Brakings(), Brakings()
    first, total = scenario.steps(scenario.traffic.warm_up), scenario.steps(scenario.traffic.warm_up + duration)
    vehicle_steps, speeds, seen, entered = 0, [], set(), 0
    with simulation(inputs) as road:
        main = {lane for lane in road.world.net.lanes if lane.rpartition("_")[0] in scenario.road.edges}
        for k in range(1, total + 1):
            report = road.world.step()
            warm, snapshot = k <= first, road.world.snapshot(road.frame)
            end = "_warm_up" if warm else ""
            counts[f"collisions{end}"] += len(report.collisions)
            counts[f"teleports{end}"] += len(report.teleported)
            (early if warm else brakings).add(snapshot)
            inside = [
                row
                for row in np.flatnonzero((snapshot.s >= 0) & (snapshot.s < scenario.road.length))
                if snapshot.lane[row] in main
            ]
            new = {snapshot.ids[row] for row in inside} - seen
            seen |= new
            if not warm:
                vehicle_steps += len(snapshot.ids)
                entered += len(new)
                speeds.append((float(snapshot.v[inside].sum()), len(inside)))
        waiting = road.world.waiting()
    speed = sum(total for total, _ in speeds) / sum(number for _, number in speeds)
    row = {
        "minutes": duration / 60,
        "vehicle_minutes": vehicle_steps * scenario.step / 60,
        "speed_kmh": 3.6 * speed,
        "flow": 3600 * entered / duration,
        **counts,
        "brakings": len(brakings.found),
        "brakings_warm_up": len(early.found),
        "hardest": brakings.hardest,
        "waiting": waiting,
    }
    return row, brakings.found


def lines(rows: pd.DataFrame, brakings: pd.DataFrame) -> Iterator[list[str]]:
    """The lines of the page: one per site, all seeds together; ranges are over seeds."""
    for name, of in rows.groupby("scenario", sort=False):
        minutes, end = of["vehicle_minutes"].sum(), load_scenario(str(name)).road.length
        inside = brakings[(brakings["scenario"] == name) & (brakings["s"] >= 0) & (brakings["s"] < end)]
        yield [
            f"{name}, {len(of)} seeds",
            f"{minutes:,.0f}",
            *(_range(of[column], digits) for column, digits in (("speed_kmh", 1), ("flow", 0))),
            *(str(int(of[column].sum())) for column in ("collisions", "teleports", "brakings")),
            str(len(inside)),
            f"{PER * of['brakings'].sum() / minutes:.2f}",
            str(int(of["of_sumo"].sum())),
            f"{PER * of['of_sumo'].sum() / minutes:.2f}",
            f"{of['hardest'].max():.1f}",
        ]


def _range(values: "pd.Series[float]", digits: int) -> str:
    return f"{values.min():,.{digits}f} to {values.max():,.{digits}f}"


def write_page(page: Path, rows: Path, brakings: Path) -> None:
    """Write the table of all rows into the page."""
    before, _, rest = page.read_text().partition(BEGIN)
    table = markdown_table(HEAD, list(lines(pd.read_csv(rows), pd.read_csv(brakings))))
    page.write_text(f"{before}{BEGIN}{table}{END}{rest.partition(END)[2]}")


def append(path: Path, rows: list[Mapping[str, Any]]) -> None:
    """Add rows to a file."""
    known = [pd.read_csv(path)] if path.is_file() else []
    if rows:
        pd.concat([*known, pd.DataFrame(rows)], ignore_index=True).round(3).to_csv(path, index=False)


def _scenario(name: str, seed: int, settings: list[str]) -> Scenario:
    return msgspec.structs.replace(load_scenario(name, settings=settings), seed=seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--seeds", type=int, default=5, help="counted up from 1")
    parser.add_argument("--minutes", type=float, default=30.0, help="after the warm-up")
    parser.add_argument("--rows", type=Path, default=Path("docs/results/null_runs.csv"))
    parser.add_argument("--brakings", type=Path, default=Path("docs/results/null_run_brakings.csv"))
    parser.add_argument("--page", type=Path, default=Path("docs/lively-traffic.md"))
    parser.add_argument("--set", nargs="*", default=[], help="changes of fields; give --rows and --brakings as well")
    options = parser.parse_args()
    for seed in range(1, options.seeds + 1):
        for name in options.scenarios:
            rows = pd.read_csv(options.rows) if options.rows.is_file() else pd.DataFrame({"scenario": [], "seed": []})
            if len(rows[(rows["scenario"] == name) & (rows["seed"] == seed)]):
                continue
            row, brakings = null_run(
                msgspec.structs.replace(load_scenario(name, settings=options.set), seed=seed), options.minutes
            )
            which = {"scenario": name, "seed": seed}
            append(options.brakings, [which | braking for braking in brakings])
            append(options.rows, [which | row])
            print(f"{name}, seed {seed}: {row}", flush=True)
    if options.set:
        print(markdown_table(HEAD, list(lines(pd.read_csv(options.rows), pd.read_csv(options.brakings)))))
    else:
        write_page(options.page, options.rows, options.brakings)


if __name__ == "__main__":
    main()
