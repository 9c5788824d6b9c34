"""Rates, intervals and paired differences of a batch, on tables made by hand."""

import numpy as np
import pandas as pd
import pytest

from cosim.batch import group_statistics
from cosim.batch.result_listing import comparison_table
from cosim.batch.spec import LEFT_TO_SUMO
from cosim.measures.statistics import mean, share


def row(policy: str, driver: str, vehicle: str, seed: int = 1, **changes) -> dict:
    return {
        "run": f"{policy}{seed}", "scenario": "s", "policy": policy, "perturbation": "nominal", "intensity": np.nan,
        "variant": "plain", "seed": seed, "driver": driver, "vehicle_0": vehicle, "vehicle_1": "b", "vehicle_2": "c",
        "takeover_time": 10.0 + int(vehicle[1:]), "ending": "horizon", "contact": False, "completed": True,
        "order_kept": True,
        "completed_without_contact": True, "broken_up_by": "", "min_ttc": np.inf,
        "min_gap": 10.0, "mean_speed": 10.0, "jerk_within_3": 1.0, "min_acceleration": -1.0,
    } | changes  # fmt: skip


@pytest.fixture
def counterparts() -> pd.DataFrame:
    """Those of the starts a1, a2 and a3, as the runs of both policies recorded them."""
    rows = [row(LEFT_TO_SUMO, "sumo", f"a{k}", mean_speed=8.0, run=f"{run}1") for run in "xy" for k in (1, 2, 3)]
    return pd.DataFrame(rows)


@pytest.fixture
def groups() -> pd.DataFrame:
    """Policies x and y on the starts a1, a2 and a3 (interrupted for x)."""
    table = pd.DataFrame([row(policy, "gri", f"a{k}") for policy in ("x", "y") for k in (1, 2, 3)])
    failed = ["completed", "order_kept", "completed_without_contact"]
    table.loc[[1, 2], failed] = False
    table.loc[1, ["contact", "ending", "min_gap"]] = [True, "contact", -1.0]
    table.loc[2, ["ending", "broken_up_by"]] = ["cut_in", "unknown"]
    return table


def test_counterparts_stand_beside_the_policies_once_per_start(groups, counterparts):
    table = group_statistics.with_counterparts(groups, counterparts)
    assert table.groupby("policy").size().to_dict() == {"x": 3, "y": 3, LEFT_TO_SUMO: 3}
    assert set(table.loc[table["policy"] != LEFT_TO_SUMO, "driver"]) == {"gri"}


def test_rows_of_a_table_with_counterparts_can_be_told_apart(groups, counterparts):
    assert group_statistics.with_counterparts(groups, counterparts).index.is_unique
    none = pd.DataFrame(columns=groups.columns)
    pd.testing.assert_frame_equal(group_statistics.with_counterparts(groups, none), groups)


def test_a_headline_has_its_rows_in_the_order_of_the_table_and_keeps_cells_without_intensity(groups):
    other_way = pd.concat([groups[groups["policy"] == policy] for policy in ("y", "x")], ignore_index=True)
    table = group_statistics.headline(other_way, ["policy", "perturbation", "intensity"])
    assert table["policy"].tolist() == ["y", "x"]
    assert table["intensity"].isna().all()
    assert table["runs"].tolist() == [1, 1]


def test_the_most_of_a_share_counts_unknown_outcomes_as_happened(groups):
    """Of three starts x completed one and lost one to an outsider: 1/3 to 2/3, with the upper end of 2/3."""
    x = groups[groups["policy"] == "x"]
    found = group_statistics.BY_NAME["completed_without_contact"].estimate(x)
    most = share(np.array([True, True, False]), np.arange(3))
    assert (found.value, found.most, found.high) == (pytest.approx(1 / 3), most.value, most.high)
    assert found.low == share(np.array([True, False, False]), np.arange(3)).low
    assert np.isnan(group_statistics.BY_NAME["contact"].estimate(x).most)


def test_gaps_are_told_by_their_median_and_speeds_by_their_mean():
    values = (1.0, 2.0, 30.0)
    starts = pd.DataFrame([row("x", "x", f"a{k}", min_gap=x, mean_speed=x) for k, x in enumerate(values)])
    assert group_statistics.BY_NAME["min_gap"].estimate(starts).value == 2.0
    speed = group_statistics.BY_NAME["mean_speed"].estimate(starts)
    assert speed == mean(np.array(values), np.arange(3))
    assert speed.high > 1, "a speed is no share"


def test_a_difference_leaves_out_starts_at_which_one_value_is_not_finite():
    """Without a leader the gap is infinite: 12 − 10 and 13 − 10 are left."""
    a = pd.DataFrame([row("x", "x", f"a{k}", min_gap=x) for k, x in enumerate((12.0, 13.0, 14.0, np.inf))])
    b = pd.DataFrame([row("y", "y", f"a{k}", min_gap=x) for k, x in enumerate((10.0, 10.0, np.inf, 10.0))])
    found = group_statistics.BY_NAME["min_gap"].difference(a, b).difference
    assert (found.n, found.value) == (2, 2.5)


def test_the_groups_are_named_beside_the_starts_only_where_they_are_more():
    assert group_statistics.starts_text(8, 8) == "8"
    assert group_statistics.starts_text(8, 16) == "8 (16 groups)"


def test_interrupted_groups_count_in_the_outcome_and_in_nothing_else(groups, counterparts):
    table = group_statistics.headline(group_statistics.with_counterparts(groups, counterparts), ["policy"])
    table = table.set_index("policy")
    assert (table.loc["x", "groups"], table.loc["x", "broken_up"]) == (3, "1 unknown")
    completed = table.loc["x", "completed_without_contact"]
    assert (completed.n, completed.value) == (3, pytest.approx(1 / 3))
    assert table.loc["x", "min_gap"].n == 2
    short = table.loc["x", "short_ttc"]
    assert (short.value, short.low, short.clusters) == (0.0, 0.0, 2)
    assert short.high > 0.99, "two rounds say little"
    assert table.loc["y", "completed_without_contact"].value == 1.0
    assert table.loc[LEFT_TO_SUMO, "mean_speed"].value == 8.0


def test_pairs_are_the_same_start_on_both_sides(groups, counterparts):
    table = group_statistics.with_counterparts(groups, counterparts)
    first, second = group_statistics.paired_starts(table, "x", "y")
    assert first["vehicle_0"].tolist() == second["vehicle_0"].tolist() == ["a1", "a2"]
    assert set(first["policy"]) == {"x"}
    tests = group_statistics.differences(table, "x", "y")
    assert tests["completed_without_contact"].difference.value == pytest.approx(-2 / 3)
    assert tests["completed_without_contact"].p == 0.5, "two starts that differ, in as many rounds: 2 · 1/4"
    assert tests["min_gap"].difference.value == pytest.approx((0 - 11.0) / 2)
    assert tests["short_ttc"].difference.value == 0.0


def test_a_start_that_is_driven_at_two_intensities_counts_once(groups, counterparts):
    """Eight starts at two intensities are sixteen groups, but not sixteen independent results."""
    starts = [row(policy, policy, f"a{k}", mean_speed=10.0 + (policy == "y")) for policy in "xy" for k in range(8)]
    graded = pd.concat(
        [pd.DataFrame(starts).assign(perturbation="braking", intensity=x) for x in (2.0, 4.0)], ignore_index=True
    )
    first, _ = group_statistics.paired_starts(graded, "x", "y")
    assert (group_statistics.count_starts(first), len(first)) == (8, 16)
    overview = group_statistics.headline(graded, ["policy"])
    assert overview[["starts", "groups"]].to_numpy().tolist() == [[8, 16], [8, 16]]
    test = group_statistics.differences(graded, "x", "y")["mean_speed"]
    assert test.p == pytest.approx(2 / 2**8), "eight rounds flip, not sixteen groups"
    title = str(comparison_table(graded, "x,y").title)
    assert title == "x − y on the same starts: 8 (16 groups)"


def test_clusters_are_seeds_if_there_are_enough():
    starts = pd.DataFrame([row("x", "x", f"a{k}", seed=seed) for seed in range(6) for k in range(3)])
    assert len(set(group_statistics.clusters(starts))) == 6
    assert "take the 6 seeds" in group_statistics.cluster_note(starts)
    few = starts[starts["seed"] < 5]
    assert len(set(group_statistics.clusters(few))) == 5 * 3, "each seed has three rounds"
    assert "only 5 seeds" in group_statistics.cluster_note(few)


def test_the_mean_of_a_share_has_an_interval_inside_0_and_1():
    """Shares of time of three starts: the t-interval alone would reach above 100 %."""
    starts = pd.DataFrame([row("x", "x", f"a{k}", jerk_within_3=share) for k, share in enumerate((1.0, 1.0, 0.8))])
    found = group_statistics.BY_NAME["jerk_within_3"].estimate(starts)
    assert (found.value, found.high) == (pytest.approx(14 / 15), 1.0)
    assert found.low == pytest.approx(14 / 15 - 4.3027 / 15, abs=1e-4)


def test_differences_are_corrected_for_the_number_of_measures():
    starts = [row(p, p, f"a{k}", mean_speed=10.0 + (p == "y") * (1 + k)) for p in "xy" for k in range(8)]
    tests = group_statistics.differences(pd.DataFrame(starts), "x", "y")
    assert len(tests) == len(group_statistics.MEASURES)
    speed = tests["mean_speed"]
    assert speed.p == pytest.approx(2 / 2**8)
    assert speed.p_corrected == pytest.approx(len(tests) * 2 / 2**8)
    assert not speed.significant, "only before the correction"


def test_no_common_start_is_no_difference(groups, counterparts):
    table = group_statistics.with_counterparts(groups, counterparts)
    tests = group_statistics.differences(table.assign(seed=np.where(table["policy"] == "x", 1, 2)), "x", "y")
    assert tests["completed"].difference.n == 0
    assert np.isnan(tests["completed"].p)


def test_intensities_keep_their_own_pairs(groups, counterparts):
    table = group_statistics.with_counterparts(groups, counterparts)
    perturbed = table[table["policy"].isin(["x", "y"])].assign(perturbation="braking", intensity=2.0)
    both = pd.concat([table, perturbed.assign(mean_speed=5.0)], ignore_index=True)
    first, second = group_statistics.paired_starts(both, "x", "y")
    assert len(first) == 4
    assert (first["intensity"].isna().to_numpy() == second["intensity"].isna().to_numpy()).all()
    perturbed, left = group_statistics.paired_starts(both, "x", LEFT_TO_SUMO)
    assert set(left["policy"]) == {LEFT_TO_SUMO}
    assert set(left["perturbation"]) == {"nominal"}
    assert set(perturbed["perturbation"]) == {"nominal", "braking"}


def test_the_counterparts_of_perturbed_traffic_are_those_of_the_same_traffic(groups, counterparts):
    """Other traffic may have a group of the same names at the same time: that is another start."""
    wet = {"perturbation": "wet", "intensity": 0.3}
    all_groups = pd.concat([groups, groups.assign(**wet)], ignore_index=True)
    all_counterparts = pd.concat([counterparts, counterparts.assign(mean_speed=4.0, **wet)], ignore_index=True)
    table = group_statistics.with_counterparts(all_groups, all_counterparts)
    assert (table["policy"] == LEFT_TO_SUMO).sum() == 6
    first, left = group_statistics.paired_starts(table, "y", LEFT_TO_SUMO)
    assert first["perturbation"].tolist() == left["perturbation"].tolist() == ["nominal"] * 3 + ["wet"] * 3
    assert left["mean_speed"].tolist() == [8.0] * 3 + [4.0] * 3


def test_a_start_that_several_runs_recorded_is_paired_once(groups, counterparts):
    """The runs of both policies recorded the same counterparts; a start counts once, whoever recorded it."""
    table = pd.concat([groups, counterparts], ignore_index=True)
    for a, b in (("y", LEFT_TO_SUMO), (LEFT_TO_SUMO, "y")):
        first, second = group_statistics.paired_starts(table, a, b)
        assert first["vehicle_0"].tolist() == second["vehicle_0"].tolist() == ["a1", "a2", "a3"]
    twice = pd.concat([groups, groups[groups["policy"] == "x"]], ignore_index=True)
    assert len(group_statistics.paired_starts(twice, "x", "y", every_start=True)[0]) == 3
