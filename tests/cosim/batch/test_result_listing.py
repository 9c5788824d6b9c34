"""Texts of `cosim results`, and batches that it cannot read."""

import json

import numpy as np
import pytest

from cosim.batch.group_statistics import BY_NAME
from cosim.batch.result_listing import correction_note, groups_of, interval, p_value
from cosim.batch.store import BatchStore
from cosim.measures.statistics import Estimate, PairedTest
from gri.errors import InputError

HEADLINE = BY_NAME["completed_without_contact"]


@pytest.mark.parametrize(
    ("estimate", "text"),
    [
        (Estimate(0.75, 0.5, 0.9, 8, 8), "75.0\n(50.0,\N{NO-BREAK SPACE}90.0)"),
        (
            Estimate(0.75, 0.5, 0.95, 8, 8, most=0.875),
            "75.0\N{NO-BREAK SPACE}up\N{NO-BREAK SPACE}to\N{NO-BREAK SPACE}87.5\n(50.0,\N{NO-BREAK SPACE}95.0)",
        ),
        (Estimate(0.75, np.nan, np.nan, 8, 1), "75.0"),
        (Estimate(np.nan, np.nan, np.nan, 0, 0), "-"),
    ],
)
def test_an_estimate_as_text(estimate, text):
    """With its upper bound and its interval; one cluster gives no interval, nothing gives nothing."""
    assert interval(HEADLINE, estimate) == text


def test_a_star_stands_behind_what_is_significant_after_the_correction():
    nothing = Estimate(0.0, -1.0, 1.0, 8, 8)
    tests = [PairedTest(nothing, 0.0004, 0.002), PairedTest(nothing, 0.03, 0.06), PairedTest(nothing, np.nan)]
    assert [p_value(test) for test in tests] == ["< 0.001*", "0.030", "-"]
    assert "for the 2 tests of this table" in correction_note(tests)


def test_a_batch_of_an_older_version_is_refused(tmp_path):
    """Its table of groups holds the counterparts under the policies' names."""
    (tmp_path / "manifest.json").write_text(json.dumps({"runs": [{"run": "r1"}]}))
    for folder in ("runs", "groups/run=r1"):
        (tmp_path / folder).mkdir(parents=True)
    with pytest.raises(InputError, match=r"an older version wrote.*run `cosim batch` again"):
        groups_of(BatchStore(tmp_path))
