"""Outcomes of merges, from rows made by hand."""

import pandas as pd

from cosim.stress.merge_outcomes import merge_outcomes, merge_table

ENDINGS = ["merged"] * 5 + ["contact"] * 2 + ["cut_in", "lane_left", "late"]


def rows() -> pd.DataFrame:
    """Two infeasible starts, ten feasible ones of policy a; success, which asks for the order as well, only in two."""
    row = {"policy": "a", "perturbation": "latency", "intensity": 0.4, "infeasible": ""}
    feasible = [row | {"ending": ending, "success": k < 2} for k, ending in enumerate(ENDINGS)]
    return pd.DataFrame([row | {"infeasible": "overlap", "ending": None, "success": None}] * 2 + feasible)


def test_a_safe_merge_counts_whoever_is_ahead_and_infeasible_starts_do_not():
    [found] = merge_outcomes(rows()).to_dict("records")
    assert {name: found[name] for name in ("feasible", "merged", "contact", "broken_up")} == {
        "feasible": 10,
        "merged": 5,
        "contact": 2,
        "broken_up": 2,
    }


def test_the_table_has_shares_of_all_feasible_starts_and_of_groups_not_broken_up():
    table = merge_table({"here": rows()}, {"seen late": ("latency", 0.4)}, ["a"])
    assert table == "| seen late | here | 50, 20 (62 %) |"
