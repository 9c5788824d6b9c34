"""Estimates, differences, the report and the figures, from rows made by hand."""

import re

import numpy as np
import pandas as pd
import pytest

from cosim.stress.estimates import MEASURES, counted, counts, differences, estimates
from cosim.stress.figures import draw
from cosim.stress.report import stress_report


def row(start: int, policy="a", kind="nominal", intensity=None, **changes):
    base = {
        "seed": 1, "start": f"x{start}", "takeover_time": 10.0 + start, "policy": policy,
        "perturbation": kind, "intensity": intensity,
        "infeasible": "", "counted": True, "contact": False, "completed": True, "order_kept": True,
        "completed_without_contact": True, "broken_up_by": "", "contact_with": "", "ending": "horizon",
        "min_ttc": 5.0 + start, "max_drac": 0.1, "min_pet": 1.0, "min_gap": 8.0 + start, "min_headway": 1.0,
        "jerk_50": 0.1, "jerk_95": 1.0, "jerk_99": 2.0, "hard_brakings": 0.0, "lateral_change": 0.0,
        "follower_min_acceleration": -1.0, "follower_speed_loss": 1.0,
    }  # fmt: skip
    return base | changes


@pytest.fixture
def rows() -> pd.DataFrame:
    """Ten nominal starts of two policies; at 0.5 two are infeasible, b is interrupted in one and collides in four."""
    made = []
    for policy in "ab":
        made += [row(k, policy) for k in range(10)]
        for k in range(10):
            changes = {}
            failed = {"completed": False, "order_kept": False, "completed_without_contact": False}
            if k < 2:
                changes = {"infeasible": "overlap"} | dict.fromkeys(["counted", "contact", "contact_with", *failed])
            elif policy == "b" and k == 2:
                changes = failed | {"counted": False, "ending": "cut_in", "broken_up_by": "policy"}
            elif policy == "b" and k > 5:
                changes = failed | {"contact": True, "contact_with": "0→1", "min_ttc": 0.0, "max_drac": np.inf}
            made.append(row(k, policy, "headway_ratio", 0.5, **changes))
    return pd.DataFrame(made)


def test_counts_list_everything_that_is_left_out(rows):
    found = counts(rows).set_index(["perturbation", "policy"]).loc[("headway_ratio", "b")]
    assert found["starts"] == 10
    assert (found["infeasible"], found["why"]) == (2, "2 overlap")
    assert (found["broken_up"], found["n"]) == ("1 policy", 7)
    assert found["hits"] == "4 0→1"


def test_outcomes_are_over_feasible_starts_and_measures_over_counted_ones(rows):
    found = estimates(rows).set_index(["perturbation", "policy", "measure"])["value"]
    assert found["nominal", "a", "completed_without_contact"] == 1.0
    assert found["headway_ratio", "b", "completed_without_contact"] == pytest.approx(3 / 8)
    assert found["headway_ratio", "b", "contact"] == pytest.approx(4 / 8)
    assert found["headway_ratio", "a", "min_ttc"] == 5.0 + np.median(range(2, 10))
    assert found["headway_ratio", "b", "short_ttc"] == pytest.approx(4 / 7)
    assert np.isfinite(found["headway_ratio", "b", "max_drac"])  # a contact counts as the cap
    assert set(found.index.get_level_values("measure")) == {measure.name for measure in MEASURES}


def test_differences_are_on_the_same_starts(rows):
    """Of the eight feasible starts, in as many rounds, b alone fails in five: −5/8, p = 2/2⁵ = 0.0625."""
    found = differences(rows).set_index(["perturbation", "measure"]).loc["headway_ratio"]
    assert found.loc["min_gap", "n"] == 7, "only starts that both drove to the end"
    found = found.loc["completed_without_contact"]
    assert found["n"] == 8
    assert found["difference"] == pytest.approx(-5 / 8)
    assert found["p"] == pytest.approx(0.0625)
    assert (found["policy"], found["against"]) == ("b", "a")


def test_starts_of_one_round_are_one_cluster(rows):
    """All taken over at one instant: that both policies were luckless by chance in this traffic cannot be excluded."""
    same = rows.assign(takeover_time=10.0)
    found = differences(same).set_index(["perturbation", "measure"]).loc[("headway_ratio", "completed_without_contact")]
    assert (found["difference"], found["n"], found["clusters"], found["p"]) == (pytest.approx(-5 / 8), 8, 1, 1.0)
    assert np.isnan(found["low"])
    text = stress_report("Title", counts(same), estimates(same), differences(same), ["headway_ratio"])
    assert "| 0.5 | b | 8 | 38 | 50 | 38 | 1 policy | 4 0→1 |" in text, "values without intervals"


def test_groups_that_others_broke_up_give_an_upper_bound(rows):
    """The broken-up one of the eight: 3/8 completed without contact, 4/8 if it would have."""
    rows = rows.replace({"broken_up_by": {"policy": "unknown"}})
    found = estimates(rows).set_index(["perturbation", "policy", "measure"])
    headline = found.loc[("headway_ratio", "b", "completed_without_contact")]
    assert (headline["value"], headline["most"]) == (3 / 8, 4 / 8)
    contact = found.loc[("headway_ratio", "b", "contact")]
    assert np.isnan(contact["most"])
    assert headline["high"] == contact["high"], "the interval ends where that of the upper bound does: also 4/8"
    text = stress_report("Title", counts(rows), estimates(rows), differences(rows), ["headway_ratio"])
    assert " 38 up to 50 [" in text


def test_stars_are_given_after_the_correction_over_the_whole_table(rows):
    """Ten starts in ten rounds, b fails in all of them: p = 2/2¹⁰, and still a star among the other tests."""
    rows = rows[rows["perturbation"] == "nominal"]
    fails = rows["policy"] == "b"
    both = pd.concat([rows, rows.assign(perturbation="headway_ratio", intensity=0.5, completed_without_contact=~fails)])
    table = differences(both)
    found = table.set_index(["perturbation", "measure"])
    tests = table["p"].notna().sum()
    assert tests == 14
    failing = found.loc[("headway_ratio", "completed_without_contact")]
    assert (failing["p"], failing["p_corrected"]) == (pytest.approx(2 / 2**10), pytest.approx(tests * 2 / 2**10))
    text = stress_report("Title", counts(both), estimates(both), table, ["headway_ratio"])
    assert text.count("p = 0.002*") == 1
    assert "correction for the 14 tests of this report" in " ".join(text.split())


def test_the_report_shows_every_cell(rows):
    text = stress_report("Title", counts(rows), estimates(rows), differences(rows), ["headway_ratio"])
    assert "| 0.5 | b | 8 | 38 [4, 85] | 50 [9, 91] | 38 [4, 85] | 1 policy | 4 0→1 |" in text
    assert "Infeasible starts: 2 overlap at 0.5." in text
    assert "4 0→1 |" in text
    assert "p = 0.062" in text
    assert text.count("| nominal |") == 5  # two policies in two tables, one difference
    assert "figures/" not in text


def test_the_tables_of_the_report_render(rows):
    """Rows of a table have as many cells as its head: pipes inside cells are escaped."""
    shown = counts(rows), estimates(rows), differences(rows)
    text = stress_report("Title", *shown, ["headway_ratio"], figures=["headway_ratio"])
    cells = [line.replace("\\|", "").count("|") for line in text.splitlines() if line.startswith("|")]
    assert cells == [9] * 16, "eight columns in each of three tables"
    assert "\\|jerk\\|, 95th percentile [m/s³]" in text
    assert re.search(r"!\[Six measures over the intensity of headway ratio[^]]*\]\(figures/headway_ratio\.png\)", text)


@pytest.mark.parametrize("lane_changes", [False, True])
def test_figures_are_drawn(rows, tmp_path, lane_changes):
    files = draw(estimates(rows), ["headway_ratio"], tmp_path, lane_changes=lane_changes)
    assert [path.name for path in files] == ["headway_ratio.png", "headway_ratio.svg"]
    assert all(path.stat().st_size > 5000 for path in files)
    text = (tmp_path / "headway_ratio.svg").read_text()
    assert ("|jerk|" in text) is not lane_changes


def test_an_interrupted_start_does_not_count(rows):
    assert len(counted(rows)) == 10 + 10 + 8 + 7


def test_a_perturbation_without_a_feasible_start_has_no_figure(rows, tmp_path):
    assert draw(estimates(rows), ["latency"], tmp_path, lane_changes=False) == []
