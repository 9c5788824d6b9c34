"""Estimates with intervals, and paired differences on the same starts, from the rows of a stress test."""

from collections.abc import Callable
from itertools import product

import numpy as np
import pandas as pd

from cosim.batch.group_statistics import OUTCOME, SHORT_TTC, Measure
from cosim.measures.statistics import corrected
from cosim.world.outcome_columns import broken_up

CELL = ["perturbation", "intensity", "policy"]
START = ["seed", "start", "takeover_time"]
# Larger values count as these, so that infinite ones (no conflict, or a contact) can be averaged.
TIME_CAP = 30.0  # [s]
DECELERATION_CAP = 20.0  # [m/s²]
GAP_CAP = 100.0  # [m]


def _capped(column: str, cap: float = np.inf, sign: int = 1) -> Callable[[pd.DataFrame], pd.Series]:
    """Reads a column, times `sign`, with values above `cap` counted as `cap`."""
    return lambda rows: sign * rows[column].astype(float).clip(upper=cap)


def _min_distance(rows: pd.DataFrame) -> pd.Series:
    """Least distance between boxes, which tables of version 0.1 call `min_gap`."""
    return _capped("min_distance" if "min_distance" in rows else "min_gap", GAP_CAP)(rows)


def _brakes_hard(rows: pd.DataFrame) -> pd.Series:
    """Whether a driven vehicle brakes harder than 3 m/s²; tables of version 0.1 only tell about 4.5 m/s²."""
    return rows["brakings_3" if "brakings_3" in rows else "hard_brakings"] > 0


MEASURES = (
    *OUTCOME,
    Measure("min_ttc", "minimum TTC", "s", _capped("min_ttc", TIME_CAP), median=True),
    Measure("short_ttc", f"TTC < {SHORT_TTC:g} s", "share", lambda g: g["min_ttc"] < SHORT_TTC, share=True, better=-1),
    Measure("max_drac", "maximum DRAC", "m/s²", _capped("max_drac", DECELERATION_CAP), median=True, better=-1),
    Measure("min_pet", "minimum PET", "s", _capped("min_pet", TIME_CAP), median=True),
    Measure("min_gap", "minimum gap", "m", _min_distance, median=True),
    Measure("min_headway", "minimum time headway", "s", _capped("min_headway", TIME_CAP), median=True),
    Measure("jerk_50", "|jerk|, median", "m/s³", _capped("jerk_50"), median=True, better=-1),
    Measure("jerk_95", "|jerk|, 95th percentile", "m/s³", _capped("jerk_95"), median=True, better=-1),
    Measure("jerk_99", "|jerk|, 99th percentile", "m/s³", _capped("jerk_99"), median=True, better=-1),
    Measure("hard_brake", "hard braking", "share", _brakes_hard, share=True, better=-1),
    Measure("lateral_change", "Δy", "m", _capped("lateral_change"), better=-1),
    Measure(
        "follower_braking",
        "hardest braking of follower",
        "m/s²",
        _capped("follower_min_acceleration", sign=-1),
        better=-1,
    ),
    Measure("follower_speed_loss", "speed loss of follower", "m/s", _capped("follower_speed_loss"), better=-1),
)
COMPARED = ("completed_without_contact", "contact", "min_ttc", "max_drac", "min_gap", "jerk_95", "follower_braking")


def counted(rows: pd.DataFrame) -> pd.DataFrame:
    """The counted rows: feasible starts whose group did not break up."""
    started = rows[rows["infeasible"] == ""]
    return started[started["counted"].astype(bool)]


def counts(rows: pd.DataFrame) -> pd.DataFrame:
    """One row per cell and policy with numbers of starts.

    Columns: starts, infeasible (with reasons in `why`), broken_up (by cause, e.g. "1 policy"), n (counted), and hits
    (contacts, e.g. "2 0→1"). `filter` says in which share of the steps of driven vehicles the safety filter intervened
    along and across the road, and its greatest change of an acceleration; it is empty without a filter.
    """
    found = []
    for key, part in rows.groupby(CELL, dropna=False, sort=False):
        started, complete = part[part["infeasible"] == ""], counted(part)
        found.append(
            dict(zip(CELL, key, strict=True))
            | {
                "starts": len(part),
                "infeasible": len(part) - len(started),
                "why": _frequencies(part.loc[part["infeasible"] != "", "infeasible"]),
                "broken_up": broken_up(started),
                "n": len(complete),
                "hits": _frequencies(started.loc[started["contact_with"] != "", "contact_with"]),
                "filter": _filter_use(started),
            }
        )
    return pd.DataFrame(found)


def _filter_use(rows: pd.DataFrame) -> str:
    """How often the safety filter intervened along and across the road, and how hard; "" without a filter."""
    if "filter_along" not in rows or not (used := rows["filter_along"].notna()).any():
        return ""
    along, across = (100 * rows.loc[used, f"filter_{name}"].mean() for name in ("along", "across"))
    return f"{along:.1f} %, {across:.1f} %, {rows.loc[used, 'filter_hardest'].max():.1f} m/s²"


def _frequencies(values: pd.Series) -> str:
    return ", ".join(f"{n} {value}" for value, n in values.value_counts().items())


def estimates(rows: pd.DataFrame) -> pd.DataFrame:
    """One row per cell, policy and measure: value, 95 % interval and upper bound over its starts."""
    found = []
    for key, part in rows[rows["infeasible"] == ""].groupby(CELL, dropna=False, sort=False):
        complete = counted(part)
        for measure in MEASURES:
            estimate = measure.estimate(part if measure.every_start else complete)
            found.append(
                dict(zip(CELL, key, strict=True))
                | {"measure": measure.name, "unit": measure.unit, "value": estimate.value}
                | {"low": estimate.low, "high": estimate.high, "most": estimate.most}
                | {"n": estimate.n, "clusters": estimate.clusters}
            )
    return pd.DataFrame(found)


def differences(rows: pd.DataFrame) -> pd.DataFrame:
    """One row per cell, policy and measure in COMPARED: this policy minus the first one on the same starts.

    `p_corrected` is corrected for the number of tests in this table.
    """
    policies = list(dict.fromkeys(rows["policy"]))
    found = []
    for (kind, intensity), part in rows[rows["infeasible"] == ""].groupby(CELL[:2], dropna=False, sort=False):
        for other, measure in product(policies[1:], (m for m in MEASURES if m.name in COMPARED)):
            of = part if measure.every_start else counted(part)
            first, second = (of[of["policy"] == name].set_index(START) for name in (policies[0], other))
            both = first.index.intersection(second.index)
            test = measure.difference(second.loc[both].reset_index(), first.loc[both].reset_index())
            found.append(
                {"perturbation": kind, "intensity": intensity, "policy": other, "against": policies[0]}
                | {"measure": measure.name, "unit": measure.unit, "difference": test.difference.value}
                | {"low": test.difference.low, "high": test.difference.high, "p": test.p}
                | {"n": len(both), "clusters": test.difference.clusters}
            )
    table = pd.DataFrame(found)
    if len(table):
        table.insert(table.columns.get_loc("n"), "p_corrected", corrected(table["p"].to_numpy()))  # type: ignore
    return table
