"""Tables of a run in which policies drive shares of the traffic (columns and units: docs/reference/run-tables.md)."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from cosim.loop.share_of_traffic import ShareOutcome
from cosim.loop.speed_share import Counts
from cosim.loop.traffic_recorder import TrafficEvent
from cosim.measures.traffic_measures import (
    figures,
    merge_figures,
    ordered,
    pattern_figures,
    space_time,
    vehicles_table,
)
from cosim.runs.share_reading import ALL

KINDS = ("contact", "misplaced", "stuck")  # of events that are counted


def share_tables(
    outcome: ShareOutcome, asked: Mapping[str, float], length: float, merge: tuple[float, float] | None
) -> dict[str, pd.DataFrame]:
    """All tables of a run; `asked` are the shares of the scenario, `length` [m] is that of the study area."""
    recording = outcome.recording
    samples = ordered(recording.samples)
    vehicles = vehicles_table(samples, recording.brakings, length)
    cells = space_time(samples, length, outcome.begin, outcome.end)
    common = {**pattern_figures(cells), **merge_figures(samples, merge, outcome.begin, outcome.end, length)}
    rows = []
    for name in (ALL, *asked, "sumo"):
        part = samples if name == ALL else samples[samples["driver"] == name]
        of = vehicles if name == ALL else vehicles[vehicles["driver"] == name]
        if not len(of) and name != ALL:
            continue
        events = _event_counts(recording.events, outcome.driver_of, None if name == ALL else name)
        row = {"driver": name, "share": sum(asked.values()) if name == ALL else asked.get(name, np.nan)}
        row |= {"driven_share": _driven_share(vehicles, name)}
        row |= figures(part, of, length, outcome.end - outcome.begin, events)
        row |= common if name == ALL else dict.fromkeys(common, np.nan)
        rows.append(row | _driving(outcome.counts.get(name)))
    return {
        "traffic": pd.DataFrame(rows),
        "vehicles": vehicles,
        "space_time": cells,
        "incidents": _incidents(recording.events, outcome.driver_of),
        "pair_graphs": _graphs(outcome),
        "samples": samples,
    }


def _driven_share(vehicles: pd.DataFrame, name: str) -> float:
    """Share of the vehicles that this policy drove, or any policy."""
    of = vehicles["driver"] != "sumo" if name == ALL else vehicles["driver"] == name
    return float(of.mean()) if len(of) else np.nan


def _event_counts(events: Sequence[TrafficEvent], driver_of: Mapping[str, str], name: str | None) -> dict[str, int]:
    chosen = [
        event.kind
        for event in events
        if name is None or name in {driver_of.get(vehicle, "sumo") for vehicle in event.vehicles}
    ]
    return {"contacts" if kind == "contact" else kind: chosen.count(kind) for kind in KINDS}


def _driving(counts: Counts | None) -> dict[str, float]:
    """How the vehicles of a policy were driven: shares of their time; NaN where no policy gives speeds."""
    names = ("by_policy", "nobody_ahead", "must_change_lane", "last_moment", "bounded_by_sumo", "speed_error")
    if counts is None or not counts.total:
        return dict.fromkeys((*names, "not_followed"), np.nan)
    commanded = max(counts.commanded, 1)
    values = (
        counts.commanded / counts.total,
        counts.nobody_ahead / counts.total,
        counts.lane_change / counts.total,
        counts.last_moment / commanded,
        counts.bounded_by_sumo / commanded,
        counts.largest_error,
    )
    followed = counts.not_followed / counts.inferences if counts.inferences else np.nan
    return {**dict(zip(names, values, strict=True)), "not_followed": followed}


def _incidents(events: Sequence[TrafficEvent], driver_of: Mapping[str, str]) -> pd.DataFrame:
    rows = [
        (e.time, e.kind, " ".join(e.vehicles), " ".join(driver_of.get(v, "sumo") for v in e.vehicles), e.detail)
        for e in events
    ]
    return pd.DataFrame(rows, columns=["time", "kind", "vehicles", "drivers", "detail"]).astype({"time": float})


def _graphs(outcome: ShareOutcome) -> pd.DataFrame:
    rows = [
        (name, row.time, row.sender, row.receiver, row.follows, row.unknown)
        for name, graphs in outcome.graphs.items()
        for row in graphs
    ]
    columns = ["driver", "time", "sender", "receiver", "follows", "unknown"]
    return pd.DataFrame(rows, columns=columns).astype({"time": float, "follows": float, "unknown": float})
