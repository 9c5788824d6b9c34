"""Statistics of a batch: rates and means with intervals per part of the matrix, and paired differences.

A *start* is one group at its take-over: same scenario, seed, variant, vehicles and time. A start that is driven at two
intensities is one start with two groups. Starts of one seed share their traffic and form a cluster; intervals and tests
take clusters as independent (`cosim.measures.statistics`). Differences are between the same starts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from cosim.batch.spec import LEFT_TO_SUMO, NOMINAL
from cosim.measures.statistics import (
    Estimate,
    PairedTest,
    mean,
    median,
    paired_difference,
    share,
    with_correction,
)
from cosim.world.episode import INTERRUPTED
from cosim.world.outcome_columns import MOST_ROLES, broken_up, could_have_completed

CELL = ("scenario", "policy", "perturbation", "intensity", "variant", "seed")
START = ("scenario", "variant", "seed", *(f"vehicle_{role}" for role in range(MOST_ROLES)), "takeover_time")
MIN_SEEDS = 6  # a sign-flip test of five clusters cannot reach p < 5 %
SHORT_TTC = 1.5  # [s]; a shorter time to collision is a conflict (van der Horst and Hogema 1993)


@dataclass(frozen=True)
class Measure:
    """One measure: its name, title and unit, and how it is computed from the groups table.

    With `share`, the values are boolean and the estimate is their share; with `median`, it is a median, else a mean.
    `most` are the values of a share with all unknown outcomes counted as happened.
    """

    name: str
    title: str
    unit: str
    column: Callable[[pd.DataFrame], pd.Series]
    share: bool = False
    median: bool = False
    better: int = 1  # 1: more is better, -1: less is
    most: Callable[[pd.DataFrame], pd.Series] | None = None
    every_start: bool = False  # over all feasible starts; otherwise over the groups that did not break up

    def values(self, groups: pd.DataFrame) -> np.ndarray:
        values = self.column(groups).to_numpy()
        return values.astype(bool) if self.share else values.astype(float)

    def estimate(self, groups: pd.DataFrame) -> Estimate:
        """The estimate over starts with its 95 % interval; values that are not finite are left out."""
        values, cluster = self.values(groups), clusters(groups)
        if not self.share:
            finite = np.isfinite(values)
            found = (median if self.median else mean)(values[finite], cluster[finite])
            if self.unit != "share":
                return found
            return replace(found, low=max(found.low, 0.0), high=min(found.high, 1.0))
        found = share(values, cluster)
        if self.most is None:
            return found
        most = share(self.most(groups).to_numpy(dtype=bool), cluster)
        return replace(found, high=most.high, most=most.value)

    def difference(self, a: pd.DataFrame, b: pd.DataFrame) -> PairedTest:
        """a − b on the same starts, which are in the same rows of both tables."""
        first, second = self.values(a), self.values(b)
        finite = np.isfinite(first) & np.isfinite(second)
        return paired_difference(first[finite], second[finite], clusters(a)[finite])


OUTCOME = (
    Measure(
        "completed_without_contact",
        "completed without contact",
        "share",
        lambda g: g["completed_without_contact"],
        share=True,
        most=lambda g: g["completed_without_contact"].astype(bool) | could_have_completed(g),
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


def clusters(groups: pd.DataFrame) -> np.ndarray:
    """The cluster of each group, as a number: its seed, or with fewer than MIN_SEEDS seeds its round.

    A round is the instant at which groups of one seed are taken over. Rounds of a seed resemble each other, too, so
    that intervals and tests over rounds promise more than they keep.
    """
    labels = [name for name in ("scenario", "seed") if name in groups]
    seed = groups.groupby(labels).ngroup().to_numpy()
    if len(np.unique(seed)) >= MIN_SEEDS:
        return seed
    return groups.groupby([*labels, "takeover_time"]).ngroup().to_numpy()


def cluster_note(groups: pd.DataFrame) -> str:
    """One sentence on what intervals and tests of these groups take as independent."""
    labels = [name for name in ("scenario", "seed") if name in groups]
    seeds = groups.groupby(labels).ngroups
    if seeds >= MIN_SEEDS:
        return f"Intervals and tests take the {seeds} seeds as independent, not the starts."
    return (
        f"Intervals and tests take rounds as independent, because there are only {seeds} seeds; with {MIN_SEEDS} seeds"
        " or more they take seeds, which is safer."
    )


def count_starts(groups: pd.DataFrame) -> int:
    """Number of different starts; a start that was driven at two intensities counts once."""
    return len(groups.drop_duplicates(_start_columns(groups)))


def _start_columns(groups: pd.DataFrame) -> list[str]:
    """The columns that name a start; tables of smaller groups have fewer of them."""
    return [name for name in START if name in groups]


def starts_text(starts: int, groups: int) -> str:
    """Number of starts, and of groups where a start was driven more than once."""
    return f"{starts}" if starts == groups else f"{starts} ({groups} groups)"


def with_counterparts(groups: pd.DataFrame, counterparts: pd.DataFrame) -> pd.DataFrame:
    """The driven groups, and one counterpart per start; counterparts have the policy name LEFT_TO_SUMO."""
    once = counterparts.drop_duplicates([*_start_columns(counterparts), "perturbation", "intensity"])
    return pd.concat([groups, once], ignore_index=True) if len(once) else groups


def uninterrupted(groups: pd.DataFrame) -> pd.DataFrame:
    """The groups that did not break up."""
    return groups[~groups["ending"].isin([ending.value for ending in INTERRUPTED])]


def headline(groups: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """One row per combination of the columns `by`: counts, and an `Estimate` per measure in the column of its name."""
    rows = []
    for key, part in groups.groupby(list(by), dropna=False, sort=False):
        complete = uninterrupted(part)
        rows.append(
            dict(zip(by, key if isinstance(key, tuple) else (key,), strict=True))
            | {"runs": part["run"].nunique(), "starts": count_starts(part), "groups": len(part)}
            | {"broken_up": broken_up(part)}
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
    on = [*_start_columns(complete), "_cell"]
    cell = [*_start_columns(complete), "perturbation", "intensity"]
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
    """Each measure's difference between the policies a − b on the same starts; p is corrected for all these tests."""
    pairs = {every: paired_starts(groups, a, b, every_start=every) for every in (False, True)}
    tests = [measure.difference(*pairs[measure.every_start]) for measure in MEASURES]
    return dict(zip(BY_NAME, with_correction(tests), strict=True))
