"""The outcome of a drive as columns of a table, and the counts over such tables.

`groups` of a run, and `episodes` of a stress test, have these columns. Tables of version 0.1 have `success` instead:
`with_outcome_columns` adds the columns to them.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from cosim.world.episode import ARRIVED, INTERRUPTED, BrokenUpBy, Episode

MOST_ROLES = 8
"""Vehicles of a group, at most."""


def outcome_columns(episode: Episode) -> dict[str, Any]:
    """The outcome of one drive; the contacts are those that count (`Episode.counted_contacts`)."""
    outcome, contacts = episode.outcome, episode.counted_contacts
    return {
        "contact": outcome.contact,
        "completed": outcome.completed,
        "order_kept": outcome.order_kept,
        "completed_without_contact": outcome.completed and not outcome.contact,
        "broken_up_by": episode.broken_up_by.value,
        "contact_with": ",".join(contact.who for contact in contacts),
        "contact_speed_difference": max((contact.speed_difference for contact in contacts), default=float("nan")),
        "contact_after_hand_back": bool(contacts) and contacts[0].after_hand_back,
        "judged_after": episode.judged_after,
    }


def filter_columns(episode: Episode) -> dict[str, float]:
    """How often and how hard the safety filter intervened; missing without a filter."""
    use, missing = episode.filter_use, float("nan")
    return {
        "filter_along": missing if use is None else use.along,
        "filter_across": missing if use is None else use.across,
        "filter_hardest": missing if use is None else use.hardest,
    }


def with_outcome_columns(table: pd.DataFrame) -> pd.DataFrame:
    """A table with the outcome columns; one of version 0.1, which has `success`, gets them from what it knows.

    In such a table `contact` is about the drive alone, and a group that broke up is broken up by UNKNOWN. The paper's
    success is `order_kept`; a stress test's `hit` is `contact_with`.
    """
    if "completed" in table or "success" not in table:
        return table
    endings, contact = table["ending"], table["contact"].eq(True)
    completed = endings.isin([ending.value for ending in ARRIVED])
    broken_up = endings.isin([ending.value for ending in INTERRUPTED])
    return table.drop(columns=["success", "hit"], errors="ignore").assign(
        completed=completed,
        order_kept=table["success"],
        completed_without_contact=completed & ~contact,
        broken_up_by=broken_up.map({True: BrokenUpBy.UNKNOWN.value, False: BrokenUpBy.NOBODY.value}),
        contact_with=table.get("hit", ""),
        contact_speed_difference=float("nan"),
        contact_after_hand_back=False,
        judged_after=0.0,
    )


def group_size(group: Mapping[Any, Any]) -> int:
    """The number of vehicles of a group, a row of the groups table."""
    return sum(f"vehicle_{role}" in group and not pd.isna(group[f"vehicle_{role}"]) for role in range(MOST_ROLES))


@dataclass(frozen=True)
class Headline:
    """Groups that completed without contact, of all `groups`.

    `count` of them did; up to `most` would have if those that broke up by others or by an unknown cause had stayed
    together. A group that the policy broke up, or that touched another vehicle, is in neither.
    """

    count: int
    most: int
    groups: int


def headline(table: pd.DataFrame) -> Headline:
    """The headline figure over all rows of a table with the outcome columns."""
    completed = table["completed_without_contact"].astype(bool)
    return Headline(int(completed.sum()), int((completed | could_have_completed(table)).sum()), len(table))


def broken_up(table: pd.DataFrame) -> str:
    """The number of groups that broke up, by cause, such as "1 policy, 2 unknown"; "0" if none did."""
    counts = table["broken_up_by"].value_counts()
    found = [f"{counts[cause]} {cause.value}" for cause in BrokenUpBy if cause.value and cause.value in counts]
    return ", ".join(found) or "0"


def could_have_completed(table: pd.DataFrame) -> pd.Series:
    """Whether a group had no contact and broke up, but not by its policy as far as is known."""
    not_by_policy = table["broken_up_by"].isin([BrokenUpBy.OTHERS.value, BrokenUpBy.UNKNOWN.value])
    return not_by_policy & ~table["contact"].astype(bool)
