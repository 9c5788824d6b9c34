"""The page of a stress test: tables of at most 8 columns that GitHub renders, and figures that survive grey print."""

import re
from pathlib import Path

import pandas as pd
import pytest

from cosim.stress import estimates
from cosim.stress.figures import CURVES, _parts, curves
from cosim.stress.report import _value, stress_report

RELEASED = Path(__file__).parents[3] / "docs/results"


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    """Rows of a released stress test: undisturbed, and a braking leader; rows of other kinds stand for braking less."""
    rows = pd.read_parquet(RELEASED / "stress_us101_merge/episodes.parquet")
    rows = rows[rows["policy"].isin(["gri", "gri+rss", "sumo"])]
    less = {"headway_ratio": 3.0, "perception_latency": 4.0}
    return rows.assign(
        perturbation=rows["perturbation"].replace(dict.fromkeys(less, "leader_braking")),
        intensity=rows["perturbation"].map(less).fillna(rows["intensity"]),
    )


@pytest.fixture(scope="module")
def tables(rows) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    return estimates.counts(rows), estimates.estimates(rows), estimates.differences(rows)


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def test_every_table_has_at_most_eight_columns_and_as_many_cells_in_every_row(tables):
    page = stress_report("Merges", *tables, ["leader_braking"], {"leader_braking", "leader_braking-2"})
    blocks = [
        [line for line in block.splitlines() if line.startswith("|")]
        for block in re.split(r"\n\n", page)
        if block.startswith("|")
    ]
    assert len(blocks) == 4
    for block in blocks:
        assert {len(cells(line)) for line in block} == {len(cells(block[0]))}
        assert len(cells(block[0])) <= 8
    assert cells(blocks[0][0])[3:6] == ["completed without contact [%]", "contact [%]", "order kept [%]"]
    assert {cells(line)[1] for line in blocks[1][2:]} == {"gri+rss"}
    assert "\\|jerk\\|" in blocks[2][0]
    assert page.count("](figures/leader_braking") == 2


def test_times_above_the_cap_are_not_told_to_a_digit():
    ttc = next(measure for measure in estimates.MEASURES if measure.name == "min_ttc")
    assert _value((30.0, 21.5, 30.0, float("nan")), ttc) == "> 30 [21.50, > 30]"


def test_the_three_facts_are_those_of_the_rows(rows, tables):
    page = stress_report("Merges", *tables, ["leader_braking"])
    for (intensity, policy), part in rows.groupby(["intensity", "policy"]):
        part = part[part["infeasible"] == ""]
        line = next(line for line in page.splitlines() if line.startswith(f"| {intensity:g} | {policy} |"))
        shown = [int(cell.split()[0]) for cell in cells(line)[3:6]]
        facts = ("completed_without_contact", "contact", "order_kept")
        assert shown == [round(100 * part[fact].astype(bool).mean()) for fact in facts]


def test_policies_of_a_figure_differ_in_marker_and_line_style(tables):
    parts = _parts([f"policy {k}" for k in range(8)])
    assert [len(part) for part in parts] == [5, 4]
    assert parts[0][0] == parts[1][0], "the first policy is in every figure"
    assert len({style["marker"] for style in CURVES}) == len({str(style["ls"]) for style in CURVES}) == 5
    figure = curves(tables[1], "leader_braking", lane_changes=True)
    lines = [line for line in figure.axes[0].lines if not str(line.get_label()).startswith("_")]
    assert [(line.get_marker(), line.get_linestyle()) for line in lines] == [("o", "-"), ("s", "--"), ("^", ":")]
    assert "completed without contact" in figure.axes[0].get_ylabel()


def test_a_single_intensity_is_shown_with_bars_beside_the_undisturbed_one(tables):
    few = tables[1][tables[1]["intensity"].isna() | (tables[1]["intensity"] == 8.0)]
    figure = curves(few, "leader_braking", lane_changes=True)
    bars = figure.axes[0].containers
    assert len(bars) == 2 * 3, "undisturbed and 8 m/s² of three policies"
    assert "bars" in figure.get_suptitle()
    value = few[(few["measure"] == "completed_without_contact") & few["policy"].eq("gri")].set_index("perturbation")
    for container, cell in zip(bars[:2], ("nominal", "leader_braking"), strict=True):
        [[_, low], [_, high]] = container.lines[2][0].get_segments()[0]
        assert [low, high] == pytest.approx((100 * value.loc[cell, ["low", "high"]].astype(float)).tolist())
