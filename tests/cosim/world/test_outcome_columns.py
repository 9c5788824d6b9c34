"""Columns and counts of outcomes."""

import numpy as np
import pandas as pd
import pytest

from cosim.world.episode import BrokenUpBy, Contact, Ending
from cosim.world.outcome_columns import Headline, broken_up, headline, outcome_columns, with_outcome_columns
from tests.cosim.world.traffic import episode

AFTER = Contact(4.0, ("a", "b"), "0→1", 3.0, after_hand_back=True)
WORSE = Contact(5.0, ("x", "a"), "other→0", 7.0, after_hand_back=True)


def test_columns_of_a_drive_that_was_completed_but_crashed_afterwards():
    found = outcome_columns(episode(Ending.HORIZON, 3.0, last=13.0, contacts=(AFTER, WORSE)))
    assert found == {
        "contact": True,
        "completed": True,
        "order_kept": True,
        "completed_without_contact": False,
        "broken_up_by": "",
        "contact_with": "0→1,other→0",
        "contact_speed_difference": 7.0,
        "contact_after_hand_back": True,
        "judged_after": pytest.approx(10.0),
    }


def test_a_drive_that_only_ended_out_of_order_is_completed_without_contact():
    found = outcome_columns(episode(Ending.MERGED, 3.0, order=(1, 0, 2), s={0: 60.0}))
    assert (found["order_kept"], found["completed_without_contact"]) == (False, True)
    assert np.isnan(found["contact_speed_difference"])


def test_the_upper_bound_leaves_out_what_the_policy_broke_up_and_contacts():
    kinds = (
        (Ending.HORIZON, BrokenUpBy.NOBODY, ()),
        (Ending.CUT_IN, BrokenUpBy.OTHERS, ()),
        (Ending.CUT_IN, BrokenUpBy.UNKNOWN, ()),
        (Ending.CUT_IN, BrokenUpBy.UNKNOWN, (AFTER,)),
        (Ending.LANE_LEFT, BrokenUpBy.POLICY, ()),
        (Ending.CONTACT, BrokenUpBy.NOBODY, (AFTER,)),
        (Ending.LATE, BrokenUpBy.NOBODY, ()),
    )
    rows = [outcome_columns(episode(kind, 3.0, contacts=c, broken_up_by=by)) for kind, by, c in kinds]
    assert headline(pd.DataFrame(rows)) == Headline(count=1, most=3, groups=7)


def test_tables_of_version_0_1_get_the_columns():
    endings = ["merged", "merged", "contact", "cut_in", "late", None]
    old = pd.DataFrame(
        {
            "ending": endings,
            "success": [True, False, False, False, False, None],
            "contact": [False, False, True, False, False, None],
            "hit": ["", "", "0→1", "", "", None],
        }
    )
    new = with_outcome_columns(old)
    assert "success" not in new
    assert new["completed"].tolist() == [True, True, False, False, False, False]
    assert new["order_kept"].tolist()[:5] == [True, False, False, False, False]
    assert new["broken_up_by"].tolist()[:5] == ["", "", "", "unknown", ""]
    assert headline(new[:5]) == Headline(count=2, most=3, groups=5)
    assert with_outcome_columns(new) is new


def test_broken_up_groups_are_counted_by_cause():
    causes = ["unknown", "", "policy", "unknown", ""]
    assert broken_up(pd.DataFrame({"broken_up_by": causes})) == "1 policy, 2 unknown"
    assert broken_up(pd.DataFrame({"broken_up_by": ["", ""]})) == "0"
