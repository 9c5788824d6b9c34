"""The figures of a batch: rates and means per part of the matrix with intervals, and paired differences.

A *start* is one group at its take-over. Groups that others broke up count as interrupted and in nothing else
(docs/decisions/003). Differences are between the same starts: same scenario, seed, variant, vehicles and instant.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from cosim.measures.statistics import (
    Estimate,
    PairedTest,
    bootstrap_mean,
    bootstrap_median,
    mcnemar,
    paired_difference,
    wilson,
)
from cosim.world.episode import INTERRUPTED, LEFT_ALONE

CELL = ("scenario", "policy", "perturbation", "intensity", "variant", "seed")
START = ("scenario", "variant", "seed", "vehicle_0", "vehicle_1", "vehicle_2", "takeover_time")
SHORT_TTC = 1.5  # [s]; a shorter time to collision is a conflict (van der Horst and Hogema 1993)
SUMO = "left to SUMO"  # the policy of the counterparts


@dataclass(frozen=True)
class Measure:
    """One figure: its name, unit and how it comes out of the groups table; shares are of boolean columns."""

    name: str
    title: str
    unit: str
    column: Callable[[pd.DataFrame], pd.Series]
    share: bool = False
    median: bool = False
    better: int = 1  # 1: more is better, -1: less is

    def values(self, groups: pd.DataFrame) -> np.ndarray:
        values = self.column(groups).to_numpy()
        return values.astype(bool) if self.share else values.astype(float)

    def estimate(self, groups: pd.DataFrame) -> Estimate:
        """The figure over starts with its 95 % interval; shares by Wilson, others by bootstrap."""
        values = self.values(groups)
        if self.share:
            return wilson(values)
        return (bootstrap_median if self.median else bootstrap_mean)(values[np.isfinite(values)])

    def difference(self, a: pd.DataFrame, b: pd.DataFrame) -> PairedTest:
        """a − b on the same starts, which stand in the same rows."""
        values = self.values(a), self.values(b)
        if self.share:
            return mcnemar(*values)
        finite = np.isfinite(values[0]) & np.isfinite(values[1])
        return paired_difference(values[0][finite], values[1][finite])


MEASURES = (
    Measure("success", "success", "share", lambda g: g["success"], share=True),
    Measure("contact", "collision", "share", lambda g: g["contact"], share=True, better=-1),
    Measure("short_ttc", f"TTC < {SHORT_TTC:g} s", "share", lambda g: g["min_ttc"] < SHORT_TTC, share=True, better=-1),
    Measure("min_gap", "minimum gap", "m", lambda g: g["min_gap"], median=True),
    Measure("mean_speed", "mean speed", "m/s", lambda g: g["mean_speed"]),
    Measure("jerk_within_3", "time with |jerk| ≤ 3 m/s³", "share", lambda g: g["jerk_within_3"]),
    Measure("min_acceleration", "hardest braking", "m/s²", lambda g: g["min_acceleration"]),
)
BY_NAME = {measure.name: measure for measure in MEASURES}


def driven(groups: pd.DataFrame) -> pd.DataFrame:
    """The groups that the policies of the batch drove, without their counterparts left to SUMO."""
    left_alone = groups["driver"].isin(LEFT_ALONE)
    return groups[~left_alone | left_alone.groupby(groups["run"]).transform("all")]


def with_counterparts(groups: pd.DataFrame) -> pd.DataFrame:
    """The driven groups, and once per start its counterpart left to SUMO, as a policy of its own."""
    own = driven(groups)
    left = groups.drop(index=own.index).assign(policy=SUMO, perturbation="nominal", intensity=np.nan)
    return pd.concat([own, left.drop_duplicates(list(START))], ignore_index=True)


def complete(groups: pd.DataFrame) -> pd.DataFrame:
    """The groups that nobody else broke up."""
    return groups[~groups["ending"].isin([ending.value for ending in INTERRUPTED])]


def headline(groups: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """One row per part of the matrix: counts, and an Estimate per measure in the column of its name."""
    rows = []
    for key, part in groups.groupby(list(by), dropna=False, sort=False):
        whole = complete(part)
        rows.append(
            dict(zip(by, key if isinstance(key, tuple) else (key,), strict=True))
            | {"runs": part["run"].nunique(), "groups": len(part), "interrupted": len(part) - len(whole)}
            | {measure.name: measure.estimate(whole) for measure in MEASURES}
        )
    return pd.DataFrame(rows)


def paired(groups: pd.DataFrame, a: str, b: str) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The starts that both policies drove to an end, row by row."""
    on = [*START, "perturbation", "intensity"]
    whole = complete(groups)
    first, second = (whole[whole["policy"] == policy].drop_duplicates(on) for policy in (a, b))
    if SUMO in (a, b):
        on = list(START)  # counterparts are never perturbed
    both = first.assign(_a=first.index).merge(second.assign(_b=second.index)[[*on, "_b"]], on=on)
    return first.loc[both["_a"]], second.loc[both["_b"]]


def compare(groups: pd.DataFrame, a: str, b: str) -> dict[str, PairedTest]:
    """a − b of every measure on the same starts."""
    first, second = paired(groups, a, b)
    return {measure.name: measure.difference(first, second) for measure in MEASURES}
