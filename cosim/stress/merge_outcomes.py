"""Outcomes of the merges of a stress test: merged without contact, contact, or broken up by other vehicles.

"Success" in the other tables asks in addition that vehicle 0 ends behind the leader (Sec. VI-E of the paper). A safe
merge ahead of the leader is no success there; here it counts as merged.
"""

from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import pandas as pd

from cosim.stress.estimates import CELL
from cosim.world.episode import INTERRUPTED, Ending


def merge_outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    """Counts over all feasible starts, one row per perturbation, intensity and policy.

    `rows` is the table `episodes` of a stress test. The columns of the result: `feasible`, `merged` (inside the target
    lane, no contact before), `contact`, `broken_up` (another vehicle cut in, or vehicle 1 or 2 left its lane or the
    simulation). The rest ran out of time, lane or road.
    """
    feasible = rows[rows["infeasible"] == ""]
    broken_up = feasible["ending"].isin([ending.value for ending in INTERRUPTED])
    facts = feasible[CELL].assign(
        feasible=1,
        merged=(feasible["ending"] == Ending.MERGED.value).astype(int),
        contact=(feasible["ending"] == Ending.CONTACT.value).astype(int),
        broken_up=broken_up.astype(int),
    )
    return facts.groupby(CELL, dropna=False, sort=False).sum().reset_index()


def merge_table(
    sites: Mapping[str, pd.DataFrame], conditions: Mapping[str, tuple[str, float | None]], policies: Sequence[str]
) -> str:
    """Markdown, one line per condition and site: "merged, contact (merged of the groups not broken up)" per policy.

    Counts are given as percentages of the feasible starts. `conditions` names a perturbation and its intensity (None:
    undisturbed).
    """
    lines = []
    for condition, (perturbation, intensity) in conditions.items():
        for site, rows in sites.items():
            same = rows["intensity"].isna() if intensity is None else rows["intensity"] == intensity
            cell = merge_outcomes(rows[(rows["perturbation"] == perturbation) & same])
            counts = {str(count["policy"]): count for count in cell.to_dict("records")}
            entries = [_entry(counts[policy]) for policy in policies]
            lines.append(f"| {condition} | {site} | " + " | ".join(entries) + " |")
    return "\n".join(lines)


def _entry(cell: Mapping[Hashable, Any]) -> str:
    share = 100 / cell["feasible"]
    whole = cell["feasible"] - cell["broken_up"]
    return f"{share * cell['merged']:.0f}, {share * cell['contact']:.0f} ({100 * cell['merged'] / whole:.0f} %)"
