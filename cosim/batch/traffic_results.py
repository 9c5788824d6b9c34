"""Results of a batch whose runs have shares of the traffic: figures by policy and share, with intervals over seeds.

A run is one value: seeds are independent, vehicles of one run are not.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from cosim.batch.result_listing import filtered
from cosim.batch.store import BatchStore
from cosim.measures.statistics import Estimate, mean
from cosim.runs.share_reading import ALL
from cosim.runs.share_summary import BY_NAME, Figure
from gri.errors import InputError
from gri.table import NBSP, Table

DEFAULT_BY = "policy,share"
SHOWN = (
    "flow",
    "mean_speed",
    "travel_time",
    "speed_sd_time",
    "speed_sd_space",
    "standing",
    "slow_cells",
    "capacity_drop",
    "tet",
    "brakings_3",
    "lane_changes",
    "fuel",
    "co2",
    "nox",
    "contacts",
    "misplaced",
)
MAY_BE_NEGATIVE = ("wave_speed", "capacity_drop")
NOBODY = "nobody"  # the policy of runs in which no vehicle is driven


def has_traffic(store: BatchStore) -> bool:
    """Whether finished runs of the batch have shares of the traffic."""
    return store.has_table("traffic")


def traffic_rows(store: BatchStore, where: Sequence[str] = ()) -> pd.DataFrame:
    """The `traffic` tables of all runs, the rows that satisfy all conditions `column=value`; without a `driver=`
    condition the rows of all vehicles.
    """
    rows = store.table("traffic", [run["run"] for run in store.manifest()["runs"]])
    rows["policy"] = rows["policy"].astype(str).where(rows["share"].ne(0), NOBODY)
    if not any(condition.partition("=")[0] == "driver" for condition in where):
        rows = rows[rows["driver"] == ALL]
    for condition in where:
        rows = filtered(rows, condition)
    if not len(rows):
        raise InputError(f"{store.folder}: no run satisfies {' and '.join(where)}; leave out a --where")
    return rows.sort_values(["scenario", "policy", "share", "seed"], ignore_index=True)


def estimate(rows: pd.DataFrame, name: str) -> Estimate:
    """The mean of a figure over runs with its 95 % interval over seeds; runs without a value are left out."""
    values = rows[name].to_numpy(dtype=float)
    known = np.isfinite(values)
    found = mean(values[known], rows["seed"].to_numpy()[known])
    return found if name in MAY_BE_NEGATIVE else replace(found, low=float(np.maximum(found.low, 0)))


def traffic_table(rows: pd.DataFrame, by: str) -> Table:
    """The figures in SHOWN for every combination of the comma-separated columns `by`."""
    columns = [name.strip() for name in by.split(",")]
    if unknown := [name for name in columns if name not in rows]:
        raise InputError(f"--by: no column {unknown[0]!r}; the runs have policy, share, scenario, variant, seed")
    shown = [name for name in SHOWN if rows[name].notna().any()]
    lines, records = [], []
    for key, part in rows.groupby(columns, dropna=False):
        estimates = {name: estimate(part, name) for name in BY_NAME if name in part}
        labels = dict(zip(columns, key, strict=True))
        cells = [_cell(BY_NAME[name], estimates[name]) for name in shown]
        lines.append(
            [*(f"{value:g}" if isinstance(value, float) else f"{value}" for value in key), str(len(part)), *cells]
        )
        numbers = {f"{n}{end}": v for n, e in estimates.items() for end, v in _ends(e).items()}
        records.append({**labels, "runs": len(part), **numbers})
    return Table(
        "traffic",
        [*columns, "runs", *(BY_NAME[name].heading for name in shown)],
        lines,
        records,
        note=f"Means over runs; 95 % intervals take the {rows['seed'].nunique()} seeds as independent.",
        labels=len(columns),
    )


def _ends(found: Estimate) -> dict[str, float]:
    return {"": found.value, "_low": found.low, "_high": found.high}


def _cell(figure: Figure, found: Estimate) -> str:
    """The value, and its interval in a second line where it has one."""
    value, low, high = (figure.text(number) for number in (found.value, found.low, found.high))
    return value if np.isnan(found.low) else f"{value}\n({low},{NBSP}{high})"
