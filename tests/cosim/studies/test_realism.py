"""Distances between distributions, by hand and by their properties."""

import numpy as np
import pandas as pd
import pytest

from cosim.studies.realism import QUANTITIES, distances, distances_frame


def speeds(*per_vehicle: list[float]) -> pd.DataFrame:
    rows = [("a", k, v) for k, values in enumerate(per_vehicle) for v in values]
    return pd.DataFrame(rows, columns=["source", "vehicle", "v"])


def test_a_shift_is_its_own_wasserstein_distance():
    """10.125 and 12.125 m/s are centres of bins 0.25 m/s wide: all probability moves by 2 m/s."""
    (found,) = distances("all", speeds([10.125] * 3, [10.125]), speeds([12.125], [12.125]))
    assert found.wasserstein.value == pytest.approx(2.0)
    assert (found.wasserstein.low, found.wasserstein.high) == pytest.approx((2.0, 2.0))
    assert found.jensen_shannon.value == pytest.approx(1.0)  # nothing in common
    assert found.vehicles == (2, 2)
    assert found.means == (10.125, 12.125)


def test_half_in_common_by_hand():
    """P = (1, 0), Q = (½, ½), M = (¾, ¼): JS² = ½·log₂(4/3) + ½·(½·log₂(2/3) + ½·log₂ 2) = 0.3113 bit."""
    (found,) = distances("all", speeds([10.125, 10.125]), speeds([10.125, 20.125]))
    assert found.jensen_shannon.value**2 == pytest.approx(0.5 * np.log2(4 / 3) + 0.25 * np.log2(2 / 3) + 0.25)
    assert found.wasserstein.value == pytest.approx(5.0)  # half of it moves by 10 m/s


def test_equal_samples_are_no_distance_apart_and_symmetric_otherwise():
    rng = np.random.default_rng(0)
    a, b = (speeds(*rng.normal(mean, 2, size=(20, 30)).tolist()) for mean in (12, 14))
    (same,) = distances("all", a, a)
    assert same.wasserstein.value == same.jensen_shannon.value == 0
    (there,), (back,) = distances("all", a, b), distances("all", b, a)
    assert there.wasserstein.value == pytest.approx(back.wasserstein.value)
    assert there.wasserstein.value == pytest.approx(2.0, abs=0.5)
    assert there.wasserstein.low < there.wasserstein.value < there.wasserstein.high
    assert there.floor[0] < there.wasserstein.low


def test_vehicles_are_resampled_not_samples():
    """100 samples of one of two vehicles say no more than one of each: the interval stays as wide."""
    few, many = speeds([10.0], [14.0]), speeds([10.0] * 100, [14.0] * 100)
    recorded = speeds(*[[12.0]] * 10)
    (a,), (b,) = distances("all", few, recorded), distances("all", many, recorded)
    assert (a.wasserstein.low, a.wasserstein.high) == pytest.approx((b.wasserstein.low, b.wasserstein.high))


def test_what_is_unknown_or_out_of_range_does_not_count():
    ours = speeds([10.0, np.nan, 70.0]).assign(headway=[np.nan, 20.0, 300.0])
    found = {d.quantity.name: d for d in distances("all", ours, speeds([10.0]).assign(headway=30.0))}
    assert found["v"].means[0] == 10.0
    assert found["headway"].means[0] == 20.0
    assert set(found) == {"v", "headway"}
    assert not distances("all", ours.assign(v=np.nan), speeds([10.0]))


def test_bins_fill_the_range_and_come_in_fours():
    for quantity in QUANTITIES:
        centres = quantity.centres
        assert centres[0] - quantity.width / 2 == pytest.approx(quantity.low)
        assert centres[-1] + quantity.width / 2 == pytest.approx(quantity.high)
        assert len(centres) % 4 == 0


def test_a_row_per_part_and_quantity():
    table = distances_frame(distances("lane 1", speeds([10.0]), speeds([11.0])))
    assert table.loc[0, ["part", "quantity", "unit"]].tolist() == ["lane 1", "v", "m/s"]
    assert table.loc[0, "wasserstein"] == pytest.approx(1.0)
