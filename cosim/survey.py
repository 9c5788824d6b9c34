"""What undisturbed traffic does: speeds, flows and lane use of a scenario in which nobody is taken over."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from rich.markup import escape
from rich.table import Table

from cosim.closed_loop import Files, Tell, simulation
from cosim.scenario import Scenario
from cosim.sumo import Snapshot
from cosim.traffic import route_file

KMH = 3.6  # km/h in a m/s
TELL_EVERY = 100  # steps


@dataclass(frozen=True)
class Survey:
    """Samples of the study area once a second after the warm-up, and what went wrong at any time.

    `samples` has a row per vehicle and second: time [s], vehicle, its length [m], lane (1 = leftmost), v [m/s].
    """

    samples: pd.DataFrame
    hardest_braking: float  # [m/s^2], of any vehicle in the net, in the sampled seconds
    waiting: int  # vehicles that could not enter the net in time
    collisions: int  # steps with a collision in SUMO's list
    teleports: int


def survey(scenario: Scenario, files: Files, duration: float, tell: Tell) -> Survey:
    """Simulate the warm-up and `duration` [s] more; nobody is taken over."""
    traffic = scenario.traffic
    files.routes.write_text(route_file(traffic, scenario.seed, traffic.warm_up + duration))
    parts, hardest, collisions, teleports = [], 0.0, 0, 0
    first, second = scenario.steps(traffic.warm_up), max(scenario.steps(1.0), 1)
    total = first + scenario.steps(duration)
    with simulation(scenario, files) as road:
        lanes = {edge: road.world.lane_count(edge) for edge in scenario.road.edges}
        for k in range(1, total + 1):
            report = road.world.step()
            collisions, teleports = collisions + bool(report.collisions), teleports + len(report.teleported)
            if k > first and k % second == 0:
                snapshot = road.world.snapshot(road.frame)
                hardest = min(hardest, float(snapshot.a.min(initial=0.0)))
                parts.append(_samples(snapshot, scenario.road.length, lanes))
            if k % TELL_EVERY == 0:
                tell("traffic", k, total)
        samples = pd.concat(parts, ignore_index=True)
        return Survey(samples, hardest, road.world.waiting(), collisions, teleports)


def _samples(snapshot: Snapshot, length: float, lanes: dict[str, int]) -> pd.DataFrame:
    """The vehicles on the main road inside the study area."""
    edge, index = zip(*(lane.rpartition("_")[::2] for lane in snapshot.lane), strict=True)
    inside = (snapshot.s >= 0) & (snapshot.s < length) & np.isin(edge, list(lanes))
    rows = np.flatnonzero(inside)
    return pd.DataFrame(
        {
            "time": snapshot.time,
            "vehicle": [snapshot.ids[row] for row in rows],
            "length": snapshot.length[rows],
            "lane": [lanes[edge[row]] - int(index[row]) for row in rows],
            "v": snapshot.v[rows],
        }
    )


def table_of(scenario: Scenario, result: Survey) -> Table:
    """The survey as a person reads it."""
    samples = result.samples
    interval = ((samples["time"] - 1e-6) // scenario.traffic.interval).astype(int)
    rows: list[tuple[str, str]] = []
    rows.append(("mean speed [km/h]", f"{KMH * samples['v'].mean():.1f}"))
    per_interval = KMH * samples["v"].groupby(interval).mean()
    rows.append(("  by demand interval", ", ".join(f"{v:.1f}" for v in per_interval)))
    per_lane = KMH * samples.groupby("lane")["v"].mean()
    rows.append(("  by lane, from the left", ", ".join(f"{v:.0f}" for v in per_lane)))
    share = 100 * samples.groupby("lane").size() / len(samples)
    rows.append(("vehicles by lane [%]", ", ".join(f"{v:.0f}" for v in share)))
    entries = samples.groupby("vehicle").first()
    duration = samples["time"].max() - samples["time"].min()
    since = entries[entries["time"] > samples["time"].min()]
    demand = _demand(scenario, float(samples["time"].min()), float(samples["time"].max()))
    rows.append(("flow into the study area [veh/h]", f"{3600 * len(since) / duration:.0f} (demand {demand:.0f})"))
    ramps = [flow.name for flow in scenario.traffic.flows if flow.edges[0] != scenario.road.edges[0]]
    from_ramp = since.index.str.rpartition(".").get_level_values(0).isin(ramps)
    rows.append(("  from the ramp [%]", f"{100 * from_ramp.mean():.1f}"))
    rows.append(("vehicles longer than 7 m [%]", f"{100 * (since['length'] > 7).mean():.1f}"))
    rows.append(("standing (< 0.5 m/s) [% of time]", f"{100 * (samples['v'] < 0.5).mean():.1f}"))
    rows.append(("hardest braking [m/s²]", f"{result.hardest_braking:.1f}"))
    rows.append(("waiting to enter at the end", str(result.waiting)))
    rows.append(("steps with a collision / teleports", f"{result.collisions} / {result.teleports}"))
    table = Table(title=f"Undisturbed traffic, seed {scenario.seed}, after the warm-up", title_justify="left")
    table.show_header = False
    for label, value in rows:
        table.add_row(escape(label), value)
    return table


def _demand(scenario: Scenario, begin: float, end: float) -> float:
    """Mean demand [veh/h] of all flows between two instants."""
    interval = scenario.traffic.interval
    return sum(
        float(np.mean([flow.per_hour[min(int(t // interval), len(flow.per_hour) - 1)] for t in np.arange(begin, end)]))
        for flow in scenario.traffic.flows
    )
