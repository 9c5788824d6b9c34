"""Preventable contacts of a stress test: starts at which a reference driver has no contact, and a policy has one."""

import pandas as pd

from cosim.batch.group_statistics import clusters
from cosim.measures.statistics import share
from cosim.stress.estimates import CELL, START
from gri.reference_drivers.drivers import DriverName
from gri.table import markdown_table

HEADING = "### Preventable contacts\n"
NOTE = """\
Starts with a contact of the policy and none of a reference driver on the same start, in percent of the starts that both
drove [95 % interval]. Reference drivers are benchmarks and certify nothing (docs/cut-ins.md).
"""


def preventable(rows: pd.DataFrame) -> pd.DataFrame:
    """One row per cell, policy and reference driver among the policies: count and share of starts, with its interval.

    `rows` is the table `episodes` of a stress test; the result is empty where no reference driver is among its
    policies.
    """
    benchmarks = [name for name in map(str, DriverName) if (rows["policy"] == name).any()]
    found = []
    feasible = rows[rows["infeasible"] == ""]
    for key, part in feasible.groupby(CELL, dropna=False, sort=False):
        kind, intensity, policy = key
        same = (feasible["perturbation"] == kind) & (
            feasible["intensity"].isna() if intensity != intensity else feasible["intensity"] == intensity
        )
        for benchmark in benchmarks:
            if benchmark == policy:
                continue
            other = feasible[same & (feasible["policy"] == benchmark)]
            both = part.merge(other[[*START, "contact"]], on=START, suffixes=("", "_benchmark"))
            happened = (both["contact"].astype(bool) & ~both["contact_benchmark"].astype(bool)).to_numpy()
            estimate = share(happened, clusters(both))
            found.append(
                {"perturbation": kind, "intensity": intensity, "policy": policy, "benchmark": benchmark}
                | {"preventable": int(happened.sum()), "share": estimate.value}
                | {"low": estimate.low, "high": estimate.high, "n": estimate.n, "clusters": estimate.clusters}
            )
    return pd.DataFrame(found)


def preventable_text(table: pd.DataFrame, kinds: list[str]) -> str:
    """Markdown of the rows of some kinds of perturbation; empty without rows."""
    if table.empty or not (shown := table["perturbation"].isin(kinds)).any():
        return ""
    lines = [
        [
            "nominal" if pd.isna(row["intensity"]) else f"{row['intensity']:g}",
            *(row["policy"], f"not {row['benchmark']}", f"{row['preventable']}/{row['n']}", _percent(row)),
        ]
        for _, row in table[shown].iterrows()
    ]
    head = ["intensity", "contact of", "and", "starts", "share [%]"]
    return f"{HEADING}\n{NOTE}\n{markdown_table(head, lines)}"


def _percent(row: pd.Series) -> str:
    value, low, high = (f"{100 * row[name]:.0f}" for name in ("share", "low", "high"))
    return value if pd.isna(row["low"]) else f"{value} [{low}, {high}]"
