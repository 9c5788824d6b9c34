"""Rates, intervals and paired differences of a batch, on tables made by hand."""

import numpy as np
import pandas as pd
import pytest

from cosim.batch import group_statistics


def row(policy: str, driver: str, vehicle: str, seed: int = 1, **changes) -> dict:
    return {
        "run": f"{policy}{seed}", "scenario": "s", "policy": policy, "perturbation": "nominal", "intensity": np.nan,
        "variant": "plain", "seed": seed, "driver": driver, "vehicle_0": vehicle, "vehicle_1": "b", "vehicle_2": "c",
        "takeover_time": 10.0, "ending": "horizon", "success": True, "contact": False, "min_ttc": np.inf,
        "min_gap": 10.0, "mean_speed": 10.0, "jerk_within_3": 1.0, "min_acceleration": -1.0,
    } | changes  # fmt: skip


@pytest.fixture
def groups() -> pd.DataFrame:
    """Policies x and y on the starts a1, a2 and a3 (interrupted for x); both runs recorded the same counterparts."""
    rows = []
    for policy in ("x", "y"):
        rows += [row(policy, "gri", "a1"), row(policy, "gri", "a2"), row(policy, "gri", "a3")]
        rows += [row(policy, "sumo", f"a{k}", mean_speed=8.0) for k in (1, 2, 3)]
    table = pd.DataFrame(rows)
    table.loc[1, ["success", "contact", "ending", "min_gap"]] = [False, True, "contact", -1.0]
    table.loc[2, ["success", "ending"]] = [False, "cut_in"]
    return table


def test_counterparts_become_a_policy_once_per_start(groups):
    table = group_statistics.with_counterparts(groups)
    assert table.groupby("policy").size().to_dict() == {"x": 3, "y": 3, group_statistics.LEFT_TO_SUMO: 3}


def test_a_run_left_to_sumo_as_a_whole_is_a_policy_like_any_other(groups):
    null = pd.DataFrame([row("left", "sumo", "a1")])
    table = group_statistics.with_counterparts(pd.concat([groups, null], ignore_index=True))
    assert (table["policy"] == "left").sum() == 1


def test_interrupted_groups_count_in_nothing_else(groups):
    table = group_statistics.headline(group_statistics.with_counterparts(groups), ["policy"]).set_index("policy")
    assert (table.loc["x", "groups"], table.loc["x", "interrupted"]) == (3, 1)
    success = table.loc["x", "success"]
    assert (success.n, success.value) == (2, 0.5)
    # Wilson for 1 of 2: (0.5 + z²/4 ± z·sqrt(0.25/2 + z²/16)) / (1 + z²/2) with z = 1.96 is 0.0945 to 0.9055.
    assert (success.low, success.high) == pytest.approx((0.0945, 0.9055), abs=1e-3)
    assert table.loc["y", "success"].value == 1.0
    assert table.loc[group_statistics.LEFT_TO_SUMO, "mean_speed"].value == 8.0


def test_pairs_are_the_same_start_on_both_sides(groups):
    table = group_statistics.with_counterparts(groups)
    first, second = group_statistics.paired_starts(table, "x", "y")
    assert first["vehicle_0"].tolist() == second["vehicle_0"].tolist() == ["a1", "a2"]
    assert set(first["policy"]) == {"x"}
    tests = group_statistics.differences(table, "x", "y")
    assert tests["success"].difference.value == -0.5
    assert tests["success"].p == 1.0, "one start that differs: McNemar's exact p is 2 · 1/2"
    assert tests["min_gap"].difference.value == pytest.approx((0 - 11.0) / 2)
    assert tests["short_ttc"].difference.value == 0.0


def test_no_common_start_is_no_difference(groups):
    table = group_statistics.with_counterparts(groups)
    tests = group_statistics.differences(table.assign(seed=np.where(table["policy"] == "x", 1, 2)), "x", "y")
    assert tests["success"].difference.n == 0
    assert np.isnan(tests["success"].p)


def test_intensities_keep_their_own_pairs(groups):
    table = group_statistics.with_counterparts(groups)
    perturbed = table[table["policy"].isin(["x", "y"])].assign(perturbation="braking", intensity=2.0)
    both = pd.concat([table, perturbed.assign(mean_speed=5.0)], ignore_index=True)
    first, second = group_statistics.paired_starts(both, "x", "y")
    assert len(first) == 4
    assert (first["intensity"].isna().to_numpy() == second["intensity"].isna().to_numpy()).all()
    _, left = group_statistics.paired_starts(both, "x", group_statistics.LEFT_TO_SUMO)
    assert set(left["policy"]) == {group_statistics.LEFT_TO_SUMO}
