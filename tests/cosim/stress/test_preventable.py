"""Preventable contacts: those that a reference driver does not have on the same start."""

import pandas as pd

from cosim.stress.preventable import preventable, preventable_text


def rows(**contacts: list[bool]) -> pd.DataFrame:
    """Four starts of four seeds under one perturbation, and the contacts of each policy."""
    return pd.concat(
        [
            pd.DataFrame(
                {
                    "seed": range(4),
                    "start": "a b c",
                    "takeover_time": 10.0,
                    "perturbation": "neighbour_cut_in",
                    "intensity": 3.0,
                    "policy": policy,
                    "infeasible": "",
                    "contact": hits,
                }
            )
            for policy, hits in contacts.items()
        ]
    )


def test_contacts_of_both_are_not_preventable():
    table = preventable(rows(gri=[True, True, False, False], fsm=[False, True, True, False]))
    assert table[["policy", "benchmark", "preventable", "n"]].to_numpy().tolist() == [
        ["gri", "fsm", 1, 4],
    ]
    assert table["share"].tolist() == [0.25]
    assert "| 3 | gri | not fsm | 1/4 |" in preventable_text(table, ["neighbour_cut_in"])
    assert preventable_text(table, ["nominal"]) == ""


def test_without_a_reference_driver_there_is_no_table():
    assert preventable(rows(gri=[True] * 4, idm=[False] * 4)).empty
    assert preventable_text(pd.DataFrame(), ["nominal"]) == ""
