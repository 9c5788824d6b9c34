"""From the rows of a stress test to estimates with intervals, and to differences on the same starts."""

from collections.abc import Callable

import numpy as np
import pandas as pd

from cosim.batch.group_statistics import SHORT_TTC, Measure

CELL = ["perturbation", "intensity", "policy"]
START = ["seed", "start"]
LONG = 30.0  # [s], times longer than that count as that
HARD = 20.0  # [m/s^2], likewise for decelerations that a contact would have taken
WIDE = 100.0  # [m], likewise for gaps


def _of(column: str, cap: float = np.inf, sign: int = 1) -> Callable[[pd.DataFrame], pd.Series]:
    return lambda rows: sign * rows[column].astype(float).clip(upper=cap)


MEASURES = (
    Measure("success", "success", "share", lambda g: g["success"], share=True),
    Measure("contact", "collision", "share", lambda g: g["contact"], share=True, better=-1),
    Measure("min_ttc", "min TTC", "s", _of("min_ttc", LONG), median=True),
    Measure("short_ttc", f"TTC < {SHORT_TTC:g} s", "share", lambda g: g["min_ttc"] < SHORT_TTC, share=True, better=-1),
    Measure("max_drac", "max DRAC", "m/s²", _of("max_drac", HARD), median=True, better=-1),
    Measure("min_pet", "min PET", "s", _of("min_pet", LONG), median=True),
    Measure("min_gap", "min gap", "m", _of("min_gap", WIDE), median=True),
    Measure("min_headway", "min time headway", "s", _of("min_headway", LONG), median=True),
    Measure("jerk_50", "|jerk| 50 %", "m/s³", _of("jerk_50"), median=True, better=-1),
    Measure("jerk_95", "|jerk| 95 %", "m/s³", _of("jerk_95"), median=True, better=-1),
    Measure("jerk_99", "|jerk| 99 %", "m/s³", _of("jerk_99"), median=True, better=-1),
    Measure("hard_brake", "hard brake", "share", lambda g: g["hard_brakings"] > 0, share=True, better=-1),
    Measure("lateral_change", "Δy", "m", _of("lateral_change"), better=-1),
    Measure("follower_braking", "follower brakes", "m/s²", _of("follower_min_acceleration", sign=-1), better=-1),
    Measure("follower_speed_loss", "follower loses", "m/s", _of("follower_speed_loss"), better=-1),
)
COMPARED = ("success", "contact", "min_ttc", "max_drac", "min_gap", "jerk_95", "follower_braking")


def counted(rows: pd.DataFrame) -> pd.DataFrame:
    """The drives that started, and that nobody else broke up."""
    started = rows[rows["infeasible"] == ""]
    return started[started["counted"].astype(bool)]


def counts(rows: pd.DataFrame) -> pd.DataFrame:
    """Per cell and policy: starts, infeasible ones with reasons, interrupted ones, counted ones, and who hit whom."""
    found = []
    for key, part in rows.groupby(CELL, dropna=False, sort=False):
        started, whole = part[part["infeasible"] == ""], counted(part)
        found.append(
            dict(zip(CELL, key, strict=True))
            | {
                "starts": len(part),
                "infeasible": len(part) - len(started),
                "why": _listed(part.loc[part["infeasible"] != "", "infeasible"]),
                "interrupted": len(started) - len(whole),
                "n": len(whole),
                "hits": _listed(whole.loc[whole["hit"] != "", "hit"]),
            }
        )
    return pd.DataFrame(found)


def _listed(values: pd.Series) -> str:
    return ", ".join(f"{n} {value}" for value, n in values.value_counts().items())


def estimates(rows: pd.DataFrame) -> pd.DataFrame:
    """One row per cell, policy and measure: value and 95 % interval over counted starts."""
    found = []
    for key, part in counted(rows).groupby(CELL, dropna=False, sort=False):
        for measure in MEASURES:
            estimate = measure.estimate(part)
            found.append(
                dict(zip(CELL, key, strict=True))
                | {"measure": measure.name, "unit": measure.unit, "value": estimate.value}
                | {"low": estimate.low, "high": estimate.high, "n": estimate.n}
            )
    return pd.DataFrame(found)


def differences(rows: pd.DataFrame) -> pd.DataFrame:
    """Every other policy minus the first one, on the starts that both drove to an end."""
    policies = list(dict.fromkeys(rows["policy"]))
    found = []
    for (kind, intensity), part in counted(rows).groupby(CELL[:2], dropna=False, sort=False):
        first = part[part["policy"] == policies[0]].set_index(START)
        for other in policies[1:]:
            second = part[part["policy"] == other].set_index(START)
            both = first.index.intersection(second.index)
            for measure in (m for m in MEASURES if m.name in COMPARED):
                test = measure.difference(second.loc[both], first.loc[both])
                found.append(
                    {"perturbation": kind, "intensity": intensity, "policy": other, "against": policies[0]}
                    | {"measure": measure.name, "unit": measure.unit, "difference": test.difference.value}
                    | {"low": test.difference.low, "high": test.difference.high, "p": test.p, "n": len(both)}
                )
    return pd.DataFrame(found)
