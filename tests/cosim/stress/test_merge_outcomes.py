"""Outcomes of merges, from rows made by hand."""

import pandas as pd

from cosim.stress.estimates import CELL
from cosim.stress.merge_outcomes import merge_outcomes, merge_table
from cosim.world.outcome_columns import with_outcome_columns

ENDINGS = ["merged"] * 5 + ["contact"] * 2 + ["cut_in", "lane_left", "late"]


def rows() -> pd.DataFrame:
    """Two infeasible starts, ten feasible ones of policy a; success, which asks for the order as well, only in two."""
    row = {"policy": "a", "perturbation": "latency", "intensity": 0.4, "infeasible": ""}
    feasible = [
        row | {"ending": ending, "success": k < 2, "contact": ending == "contact"} for k, ending in enumerate(ENDINGS)
    ]
    return pd.DataFrame(
        [row | {"infeasible": "overlap"} | dict.fromkeys(["ending", "success", "contact"])] * 2 + feasible
    )


def test_a_safe_merge_counts_whoever_is_ahead_and_infeasible_starts_do_not():
    [found] = merge_outcomes(rows()).to_dict("records")
    assert {name: found[name] for name in found if name not in CELL} == {
        "feasible": 10,
        "completed_without_contact": 5,
        "at_most": 7,
        "contact": 2,
        "order_kept": 2,
        "broken_up": 2,
    }


def test_what_the_policy_broke_up_is_not_in_the_upper_bound():
    """The same starts as rows of today: the policy broke up the one with the ending lane_left."""
    today = with_outcome_columns(rows())
    causes = today["broken_up_by"].mask(today["ending"] == "lane_left", "policy")
    [found] = merge_outcomes(today.assign(broken_up_by=causes)).to_dict("records")
    assert (found["completed_without_contact"], found["at_most"], found["broken_up"]) == (5, 6, 2)


def test_the_table_has_shares_of_all_feasible_starts_and_their_upper_bound():
    table = merge_table({"here": rows()}, {"seen late": ("latency", 0.4)}, ["a"])
    assert table == "| seen late | here | 50–70, 20 |"
