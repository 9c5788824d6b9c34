"""The score of simulated traffic, by hand and by its properties."""

import json

import numpy as np
import pandas as pd
import pytest

from cosim.studies.observation_windows import Window, seen_through, windows_of
from cosim.studies.score_report import write_score
from cosim.studies.traffic_samples import with_headways
from cosim.studies.traffic_score import (
    FEATURES,
    STATISTICS,
    constant_traffic,
    seed_interval,
    sums_of,
    traffic_score,
    with_interactions,
)
from cosim.studies.wave_speed import wave_speed
from gri.errors import InputError
from gri.table import terminal_text

SPEED = {feature.name: feature for feature in FEATURES}["v"]


def track(vehicle: str, v: float, lane: int = 1, x: float = 0.0, start: int = 0, seconds: int = 10) -> pd.DataFrame:
    time = np.arange(start, start + seconds, dtype=float)
    columns = {"time": time, "vehicle": vehicle, "lane": float(lane), "x": x + v * (time - start), "v": v, "a": 0.0}
    return pd.DataFrame(columns).assign(length=4.0, source="r")


def traffic(mean: float, seed: int = 0, vehicles: int = 40) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    tracks = [
        track(f"{k}", v, 1 + k % 3, 15.0 * k, seconds=20) for k, v in enumerate(rng.normal(mean, 2, vehicles).clip(0))
    ]
    return pd.concat(tracks, ignore_index=True)


def prepared(samples: pd.DataFrame) -> pd.DataFrame:
    windows, cut = windows_of(samples)
    assert windows
    return with_interactions(with_headways(cut.assign(source=cut["window"]))).assign(seed=0)


def test_windows_are_cut_where_a_recording_is_long_and_left_out_where_it_is_short() -> None:
    long = pd.concat([track("a", 1, seconds=251), track("b", 1, lane=3, x=50, seconds=251)])
    windows, cut = windows_of(pd.concat([long, track("c", 1, seconds=3).assign(source="short")]))
    assert windows == [Window(0.0, 174.0, (1.0, 3.0), 125.0), Window(125.0, 300.0, (1.0, 3.0), 125.0)]
    assert cut.groupby("window").size().tolist() == [250, 252]
    assert cut["source"].unique().tolist() == ["r"]


def test_the_simulation_is_seen_through_the_same_stretch_lanes_and_time() -> None:
    simulated = pd.concat([track("a", 10, 1, seconds=100), track("b", 10, 2, seconds=100)])
    seen = seen_through([simulated, simulated], [Window(0.0, 250.0, (1.0,), 9.0)], views=4, offset=50.0)
    assert seen["vehicle"].unique().tolist() == ["a"]
    assert seen.groupby("seed")["window"].nunique().tolist() == [1, 1]  # the second view begins when `a` has passed
    first = seen[seen["window"] == 0]
    assert first["time"].tolist() == [5.0, 6.0, 7.0, 8.0, 9.0]  # at x = 50 m, which is 0 m in the recording, and later
    assert first["x"].tolist() == [0.0, 10.0, 20.0, 30.0, 40.0]


def test_interactions_by_hand() -> None:
    one = pd.concat([track("behind", 12.0, x=0.0), track("ahead", 10.0, x=30.0)], ignore_index=True)
    one.loc[one["vehicle"] == "ahead", "v"] = 10.0 + 0.1 * np.arange(10) ** 2
    found = with_interactions(with_headways(one))
    behind, ahead = (found[found["vehicle"] == name] for name in ("behind", "ahead"))
    assert behind["gap"].iloc[0] == 26.0  # 30 m from front to front, less 4 m
    assert behind["relative_speed"].iloc[0] == 2.0
    assert behind["ttc"].iloc[0] == 13.0
    assert ahead["a"].iloc[1:-1].tolist() == pytest.approx([0.2 * k for k in range(1, 9)])  # the derivative of v
    assert ahead["jerk"].iloc[2:-1].tolist() == pytest.approx([0.2] * 7)
    assert ahead["a"].isna().sum() == 2  # no speed before the first sample, none after the last
    assert ahead[["gap", "ttc", "relative_speed"]].isna().all(axis=None)


def test_the_recording_itself_has_all_of_its_likelihood() -> None:
    recorded = prepared(traffic(12))
    score = traffic_score(recorded, recorded, recorded)
    assert [s.share for s in score.features] == pytest.approx([1.0] * len(score.features))
    assert all(s.inside for s in score.statistics if not np.isnan(s.recorded))
    assert score.total == pytest.approx(1.0)
    assert score.ceiling == pytest.approx(1.0)


def test_a_share_by_hand() -> None:
    """Recorded: half at 10.5, half at 11.5 m/s. Simulated: a quarter and three quarters. 0.1 is added to 40 bins."""
    recorded = prepared(pd.concat([track("a", 10.5), track("b", 11.5)]))
    simulated = prepared(pd.concat([track("a", 10.5), *(track(name, 11.5) for name in "bcd")]))
    (share,) = (s.share for s in traffic_score(simulated, recorded, None).features if s.feature is SPEED)
    p, q1, q2 = 10.1 / 24.0, 10.1 / 44.0, 30.1 / 44.0
    assert share == pytest.approx(np.exp(0.5 * np.log(q1 / p) + 0.5 * np.log(q2 / p)))


def test_the_score_falls_with_the_distance_and_for_a_constant() -> None:
    recorded, alike, faster = (prepared(traffic(*args)) for args in ((12, 1), (12, 2), (16, 3)))
    constant = prepared(traffic(12, 4).assign(v=12.0))
    scores = [traffic_score(one, recorded, None) for one in (alike, faster, constant)]
    totals = [score.total for score in scores]
    speeds = [score.features[0].share for score in scores]
    assert totals[0] > max(totals[1:]) + 0.1
    assert speeds[0] > 0.8 > 0.3 > max(speeds[1:])


def test_statistics_by_hand() -> None:
    steady, slow = track("a", 20.0), track("b", 2.0)
    changing = track("c", 10.0, seconds=11).assign(lane=[1.0] * 5 + [2.0] * 6)
    table = prepared(pd.concat([steady, slow, changing]))

    def value(name: str) -> float:
        numerator, denominator = sums_of(name, table).sum(0)
        return numerator / denominator

    assert value("vehicle_sd") == 0.0  # squared
    assert value("standing") == 0.0
    assert value("slow_leftmost") == pytest.approx(100 * 10 / 25)
    assert value("lane_changes") == pytest.approx(1 / ((9 * 20 + 9 * 2 + 10 * 10) / 1000))
    assert set(STATISTICS) > {"vehicle_sd", "standing", "slow_leftmost", "lane_changes"}


def test_how_long_speeds_last() -> None:
    """A wave of 40 s: half a period later it is reversed, a whole one later it is as before."""
    time = np.arange(120.0)
    wave = pd.DataFrame({"time": time, "vehicle": "a", "lane": 1.0, "x": time, "v": 10 + np.sin(2 * np.pi * time / 40)})
    table = prepared(wave.assign(a=0.0, length=4.0, source="r"))
    at = {lag: np.divide(*sums_of(f"autocorrelation_{lag}", table).sum(0)) for lag in (10, 20)}
    assert at[20] == pytest.approx(-1.0, abs=0.02)
    assert at[10] == pytest.approx(0.0, abs=0.1)


def test_a_constant_speed_has_no_correlation() -> None:
    """Not 1, which the rounding errors of the mean would give."""
    table = prepared(pd.concat([track("a", 10.1, seconds=60), track("b", 10.1, x=30, seconds=60)]))
    assert sums_of("autocorrelation_10", table).tolist() == [[0.0, 0.0]]


def wave(speed: float, period: float, seconds: int = 120, length: float = 300.0) -> pd.DataFrame:
    """A field of speeds that moves upstream at `speed` [m/s]: standing probes every 10 m, once a second."""
    x, time = (values.ravel() for values in np.meshgrid(np.arange(0.0, length, 10), np.arange(float(seconds))))
    v = 10 + 3 * np.sin(2 * np.pi * (time + x / speed) / period)
    names = [f"{place:.0f}" for place in x]
    columns = {"time": time, "vehicle": names, "lane": 1.0, "x": x, "v": v, "a": 0.0, "length": 4.0, "source": "r"}
    return pd.DataFrame(columns)


@pytest.mark.parametrize("speed", [3.5, 4.5, 6.0])
def test_how_fast_waves_travel_upstream(speed: float) -> None:
    found = wave_speed(sums_of("wave_speed", prepared(wave(speed, 60))).sum(0))
    assert found == pytest.approx(3.6 * speed, rel=0.05)


def test_where_nothing_travels_upstream_there_is_no_speed() -> None:
    """White noise, and a wave that travels downstream and is too long for both places to agree at any lag."""
    noise = wave(5, 60).assign(v=np.random.default_rng(0).normal(10, 2, 30 * 120))
    assert np.isnan(wave_speed(sums_of("wave_speed", prepared(noise)).sum(0)))
    assert np.isnan(wave_speed(sums_of("wave_speed", prepared(wave(-5, 300))).sum(0)))


def test_the_constant_baseline_has_the_means_and_no_spread() -> None:
    recorded, other = prepared(traffic(12, 1)), prepared(traffic(14, 2))
    constant = constant_traffic(recorded, other)
    assert constant["v"].unique().tolist() == [other["v"].mean()]
    assert constant.groupby("vehicle")["lane"].nunique().max() == 1
    score = traffic_score(constant, recorded, other)
    shares = {s.feature.name: s for s in score.features}
    assert shares["lane"].share > 0.95  # evenly over the three lanes, as recorded
    assert all(shares[name].share < 0.2 for name in ("v", "headway", "time_headway", "relative_speed"))
    assert shares["ttc"].share == pytest.approx(shares["ttc"].uniform)  # nobody closes a gap, so nothing is known
    assert {s.name: s.simulated for s in score.statistics}["vehicle_sd"] == pytest.approx(0.0)
    assert score.total < 0.5 * traffic_score(prepared(traffic(12, 3)), recorded, other).total


def test_a_uniform_histogram_by_hand() -> None:
    """All of 20 samples in one of 40 bins of 1 m/s; 0.1 is added to each bin."""
    recorded = prepared(track("a", 10.5, seconds=20))
    (speed,) = (s for s in traffic_score(recorded, recorded, recorded).features if s.feature is SPEED)
    assert speed.uniform == pytest.approx((1 / 40) / (20.1 / 24.0))
    assert speed.of_ceiling == pytest.approx(1.0)


def test_the_interval_over_seeds_is_students() -> None:
    low, high = seed_interval((1.0, 2.0, 3.0))
    assert (high - low) / 2 == pytest.approx(4.3027 / np.sqrt(3), rel=1e-4)
    assert (high + low) / 2 == 2.0
    assert np.isnan(seed_interval((1.0,))).all()
    assert np.isnan(seed_interval((1.0, np.nan))).all()


def test_a_report_is_written_and_a_wrong_offset_is_told(tmp_path) -> None:
    recorded, simulated = traffic(12, 1), [traffic(12, 2), traffic(12, 3)]
    likelihoods, statistics = write_score(tmp_path, simulated, recorded, None, views=4, offset=0.0)
    assert {path.name for path in tmp_path.iterdir()} == {"score.csv", "score.json", "space_time.png"}
    assert likelihoods.lines[-1][0] == "weighted score"
    assert max(map(len, terminal_text(likelihoods, 80).splitlines())) <= 80
    rows = json.loads((tmp_path / "score.json").read_text())["quantities"]
    assert {"constant", "uniform", "of_ceiling", "seeds_low", "seeds_high"} <= set(rows[0])
    assert len(statistics.lines) == len(STATISTICS)
    with pytest.raises(InputError, match=r"--offset: got 9000 m, at which no simulated vehicle"):
        write_score(tmp_path, simulated, recorded, None, views=4, offset=9000.0)
    with pytest.raises(InputError, match=r"--test: no part of the recording"):
        write_score(tmp_path, simulated, recorded[recorded["time"] < 2], None, views=4, offset=0.0)
