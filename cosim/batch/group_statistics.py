"""Statistics of a batch: rates and means with intervals per part of the matrix, and paired differences.

A *start* is one group at its take-over. Groups that other vehicles broke up count as interrupted, and in nothing else
(docs/decisions/003). Differences are between the same starts: same scenario, seed, variant, vehicles and time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from cosim.batch.spec import LEFT_TO_SUMO, NOMINAL
from cosim.measures.statistics import (
    Estimate,
    PairedTest,
    bootstrap_mean,
    bootstrap_median,
    mcnemar,
    paired_difference,
    wilson,
)
from cosim.world.episode import INTERRUPTED

CELL = ("scenario", "policy", "perturbation", "intensity", "variant", "seed")
START = ("scenario", "variant", "seed", "vehicle_0", "vehicle_1", "vehicle_2", "takeover_time")
SHORT_TTC = 1.5  # [s]; a shorter time to collision is a conflict (van der Horst and Hogema 1993)


@dataclass(frozen=True)
class Measure:
    """One measure: its name, title and unit, and how it is computed from the groups table.

    With `share`, the values are boolean and the estimate is their share; with `median`, it is a median, else a mean.
    """

    name: str
    title: str
    unit: str
    column: Callable[[pd.DataFrame], pd.Series]
    share: bool = False
    median: bool = False
    better: int = 1  # 1: more is better, -1: less is
    every_start: bool = False  # over all feasible starts; otherwise over the groups that did not break up

    def values(self, groups: pd.DataFrame) -> np.ndarray:
        values = self.column(groups).to_numpy()
        return values.astype(bool) if self.share else values.astype(float)

    def estimate(self, groups: pd.DataFrame) -> Estimate:
        """The estimate over starts with its 95 % interval: Wilson's for shares, else bootstrap, of finite values."""
        values = self.values(groups)
        if self.share:
            return wilson(values)
        return (bootstrap_median if self.median else bootstrap_mean)(values[np.isfinite(values)])

    def difference(self, a: pd.DataFrame, b: pd.DataFrame) -> PairedTest:
        """a − b on the same starts, which are in the same rows of both tables."""
        values = self.values(a), self.values(b)
        if self.share:
            return mcnemar(*values)
        finite = np.isfinite(values[0]) & np.isfinite(values[1])
        return paired_difference(values[0][finite], values[1][finite])


OUTCOME = (
    Measure(
        "completed_without_contact",
        "completed without contact",
        "share",
        lambda g: g["completed_without_contact"],
        share=True,
        every_start=True,
    ),
    Measure("contact", "contact", "share", lambda g: g["contact"], share=True, better=-1, every_start=True),
    Measure("completed", "completed", "share", lambda g: g["completed"], share=True, every_start=True),
    Measure("order_kept", "order kept", "share", lambda g: g["order_kept"], share=True, every_start=True),
)
"""The outcome of a drive, over all feasible starts (docs/stress.md)."""

MEASURES = (
    *OUTCOME,
    Measure("short_ttc", f"TTC < {SHORT_TTC:g} s", "share", lambda g: g["min_ttc"] < SHORT_TTC, share=True, better=-1),
    Measure("min_gap", "minimum gap", "m", lambda g: g["min_gap"], median=True),
    Measure("mean_speed", "mean speed", "m/s", lambda g: g["mean_speed"]),
    Measure("jerk_within_3", "time with |jerk| ≤ 3 m/s³", "share", lambda g: g["jerk_within_3"]),
    Measure("min_acceleration", "minimum acceleration", "m/s²", lambda g: g["min_acceleration"]),
)
BY_NAME = {measure.name: measure for measure in MEASURES}


def with_counterparts(groups: pd.DataFrame, counterparts: pd.DataFrame) -> pd.DataFrame:
    """The driven groups, and one counterpart per start; counterparts have the policy name LEFT_TO_SUMO."""
    once = counterparts.drop_duplicates([*START, "perturbation", "intensity"])
    return pd.concat([groups, once], ignore_index=True) if len(once) else groups


def uninterrupted(groups: pd.DataFrame) -> pd.DataFrame:
    """The groups that other vehicles did not break up."""
    return groups[~groups["ending"].isin([ending.value for ending in INTERRUPTED])]


def headline(groups: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """One row per combination of the columns `by`: counts, and an `Estimate` per measure in the column of its name."""
    rows = []
    for key, part in groups.groupby(list(by), dropna=False, sort=False):
        complete = uninterrupted(part)
        rows.append(
            dict(zip(by, key if isinstance(key, tuple) else (key,), strict=True))
            | {"runs": part["run"].nunique(), "groups": len(part), "interrupted": len(part) - len(complete)}
            | {m.name: m.estimate(part if m.every_start else complete) for m in MEASURES}
        )
    return pd.DataFrame(rows)


def paired_starts(
    groups: pd.DataFrame, a: str, b: str, *, every_start: bool = False
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The starts that both policies a and b drove to the end; the same row of both tables is the same start.

    With `every_start` also those in which a group broke up.
    """
    complete = _with_cell(groups if every_start else uninterrupted(groups), counterparts=LEFT_TO_SUMO in (a, b))
    on = [*START, "_cell"]
    cell = [*START, "perturbation", "intensity"]
    first, second = (complete[complete["policy"] == policy].drop_duplicates(cell) for policy in (a, b))
    both = first.assign(_a=first.index).merge(second.assign(_b=second.index)[[*on, "_b"]], on=on)
    return first.loc[both["_a"]], second.loc[both["_b"]]


def _with_cell(groups: pd.DataFrame, *, counterparts: bool) -> pd.DataFrame:
    """The groups with `_cell`, in which two rows of one start can be compared: perturbation and intensity.

    A counterpart shares the traffic of its group, perturbed or not, but nothing else disturbs it. With `counterparts`,
    groups whose own traffic is not perturbed are therefore in the nominal cell.
    """
    cell = groups["perturbation"] + groups["intensity"].map(" {:g}".format)
    if counterparts:
        cell = cell.where(cell.isin(cell[groups["policy"] == LEFT_TO_SUMO]), f"{NOMINAL} nan")
    return groups.assign(_cell=cell)


def differences(groups: pd.DataFrame, a: str, b: str) -> dict[str, PairedTest]:
    """Each measure's difference between the policies a − b on the same starts."""
    pairs = {every: paired_starts(groups, a, b, every_start=every) for every in (False, True)}
    return {measure.name: measure.difference(*pairs[measure.every_start]) for measure in MEASURES}
