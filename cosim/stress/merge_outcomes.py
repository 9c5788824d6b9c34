"""Outcomes of the merges of a stress test: completed without contact with its upper bound, and contacts.

A merge is completed when vehicle 0 stays in the target lane, ahead of the leader or behind it. The paper's success
(`order_kept`) asks in addition that vehicle 0 ends behind the leader (Sec. VI-E).
"""

from collections.abc import Mapping, Sequence

import pandas as pd

from cosim.stress.estimates import CELL
from cosim.world.outcome_columns import could_have_completed, with_outcome_columns

SHOWN = ("completed_without_contact", "at_most", "contact")


def merge_outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    """Counts over all feasible starts, one row per perturbation, intensity and policy.

    `rows` is the table `episodes` of a stress test, also of version 0.1 (see `with_outcome_columns`; there contacts are
    those of the drive alone). The columns of the result: `feasible`, `completed_without_contact`, `at_most` (the same
    if no group had been broken up by others or by an unknown cause), `contact`, `order_kept`, `broken_up`. The rest ran
    out of time, lane or road.
    """
    feasible = with_outcome_columns(rows[rows["infeasible"] == ""])
    completed = feasible["completed_without_contact"].astype(bool)
    facts = feasible[CELL].assign(
        feasible=1,
        completed_without_contact=completed.astype(int),
        at_most=(completed | could_have_completed(feasible)).astype(int),
        contact=feasible["contact"].astype(int),
        order_kept=feasible["order_kept"].astype(int),
        broken_up=(feasible["broken_up_by"] != "").astype(int),
    )
    return facts.groupby(CELL, dropna=False, sort=False).sum().reset_index()


def merge_table(
    sites: Mapping[str, pd.DataFrame], conditions: Mapping[str, tuple[str, float | None]], policies: Sequence[str]
) -> str:
    """Markdown, one line per condition and site: "completed without contact, contact" per policy.

    Both are percentages of the feasible starts. The first is a range, such as 81–85, where groups were broken up by
    others or by an unknown cause. `conditions` names a perturbation and its intensity (None: undisturbed).
    """
    lines = []
    for condition, (perturbation, intensity) in conditions.items():
        for site, rows in sites.items():
            same = rows["intensity"].isna() if intensity is None else rows["intensity"] == intensity
            cell = merge_outcomes(rows[(rows["perturbation"] == perturbation) & same]).set_index("policy")
            shares = 100 * cell[list(SHOWN)].div(cell["feasible"], axis=0)
            entries = [_entry(*shares.loc[[policy]].to_numpy()[0].tolist()) for policy in policies]
            lines.append(f"| {condition} | {site} | " + " | ".join(entries) + " |")
    return "\n".join(lines)


def _entry(completed: float, at_most: float, contact: float) -> str:
    least, most = f"{completed:.0f}", f"{at_most:.0f}"
    return f"{least if least == most else f'{least}–{most}'}, {contact:.0f}"
