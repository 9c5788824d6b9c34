"""The summary of a run with shares: a column per driver, a row per figure."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from cosim.runs.share_reading import ALL
from cosim.runs.summary import driver_name
from gri.table import Table


class Figure(NamedTuple):
    """A figure of the `traffic` table: its column, what it is called, its unit, and how it is shown."""

    name: str
    title: str
    unit: str = ""
    factor: float = 1.0
    digits: int = 1

    def text(self, value: float) -> str:
        return "-" if not np.isfinite(value) else f"{self.factor * value:.{self.digits}f}"

    @property
    def heading(self) -> str:
        return f"{self.title} [{self.unit}]" if self.unit else self.title


FIGURES = (
    Figure("vehicles", "vehicles", digits=0),
    Figure("driven_share", "share of the vehicles", "%", 100),
    Figure("flow", "flow", "veh/h", digits=0),
    Figure("density", "density", "veh/km"),
    Figure("mean_speed", "mean speed", "m/s", digits=2),
    Figure("speed_sd", "speed sd, all samples", "m/s", digits=2),
    Figure("speed_sd_time", "speed sd over time", "m/s", digits=2),
    Figure("speed_sd_space", "speed sd over space", "m/s", digits=2),
    Figure("travel_time", "travel time", "s"),
    Figure("travel_time_sd", "travel time sd", "s"),
    Figure("standing", "time standing", "%", 100, 2),
    Figure("stops", "stops", "1/km", digits=3),
    Figure("slow_cells", "space-time below 5 m/s", "%", 100),
    Figure("wave_speed", "speed of waves", "m/s"),
    Figure("merge_flow", "flow behind the merge", "veh/h", digits=0),
    Figure("capacity_drop", "capacity drop there", "%", 100),
    Figure("tet", "time with TTC < 1.5 s", "s/h", digits=2),
    Figure("tit", "time integrated TTC", "s²/h", digits=2),
    Figure("brakings_3", "braking > 3 m/s²", "1/km", digits=3),
    Figure("brakings_4.5", "braking > 4.5 m/s²", "1/km", digits=4),
    Figure("lane_changes", "lane changes", "1/km", digits=2),
    Figure("fuel", "fuel", "g/km"),
    Figure("co2", "CO2", "g/km"),
    Figure("nox", "NOx", "mg/km"),
    Figure("pmx", "PMx", "mg/km", digits=2),
    Figure("contacts", "contacts", digits=0),
    Figure("misplaced", "misplaced vehicles", digits=0),
    Figure("stuck", "stuck for 60 s", digits=0),
    Figure("by_policy", "speed by the policy", "% of time", 100),
    Figure("nobody_ahead", "SUMO: nobody ahead", "% of time", 100),
    Figure("must_change_lane", "SUMO: lane to leave", "% of time", 100),
    Figure("last_moment", "last-moment bound", "% of time", 100, 2),
    Figure("bounded_by_sumo", "bounded by SUMO", "% of time", 100, 2),
    Figure("speed_error", "faster than commanded", "m/s", digits=3),
    Figure("not_followed", "graphs without the edge", "%", 100),
)
BY_NAME = {figure.name: figure for figure in FIGURES}


def summary_table(traffic: pd.DataFrame) -> Table:
    """The figures of a run as a table; rows that nobody has a value for are left out."""
    columns = traffic.to_dict("records")
    shown: Sequence[Figure] = [figure for figure in FIGURES if traffic[figure.name].notna().any()]
    lines = [[figure.heading, *(figure.text(float(row[figure.name])) for row in columns)] for figure in shown]
    head = ["", *("all vehicles" if row["driver"] == ALL else driver_name(row["driver"]) for row in columns)]
    return Table(
        "traffic", head, lines, columns, title="The traffic in the study area, and the vehicles of each driver"
    )
