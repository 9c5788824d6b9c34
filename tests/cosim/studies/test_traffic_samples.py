"""Samples of recordings, scene files and runs, and the headways in them."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from cosim.runs.finished_run import write_manifest
from cosim.runs.run_reading import NEEDED, TABLES
from cosim.runs.run_tables import manifest
from cosim.studies.traffic_samples import COLUMNS, recorded_samples, run_samples, with_headways
from gri.errors import InputError
from tests.gri.data.recordings import layout_files

FEET = 1 / 0.3048


def sample(time, vehicle, lane, x, v, length=5.0):
    return ("r", time, vehicle, lane, x, v, 0.0, length)


def table(*rows) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=list(COLUMNS))


def test_headways_by_hand():
    """At 10 m/s 30 m behind a vehicle of 5 m: 30 m, 3 s, (30 − 5)/10 = 2.5 s; other lanes and times are apart."""
    found = with_headways(
        table(
            sample(0.0, 7, 1, 130.0, 12.0),
            sample(0.0, 8, 1, 100.0, 10.0),
            sample(0.0, 9, 2, 110.0, 10.0),
            sample(1.0, 8, 1, 110.0, 10.0),
        )
    )
    assert found.loc[1, ["headway", "time_headway", "time_gap"]].tolist() == [30.0, 3.0, 2.5]
    assert found.loc[[0, 2, 3], "headway"].isna().all()


def test_the_slow_have_no_headway_in_seconds_and_unknown_lengths_no_time_gap():
    found = with_headways(table(sample(0.0, 1, 1, 0.0, 0.5), sample(0.0, 2, 1, 20.0, 5.0, np.nan)))
    assert found.loc[0, "headway"] == 20.0
    assert found.loc[0, ["time_headway", "time_gap"]].isna().all()
    found = with_headways(table(sample(0.0, 1, 1, 0.0, 5.0), sample(0.0, 2, 1, 20.0, 5.0, np.nan)))
    assert found.loc[0, "time_headway"] == 4.0
    assert np.isnan(found.loc[0, "time_gap"])


def ngsim_file(path: Path, seconds: float = 6.0) -> Path:
    """Two vehicles in lane 2, the rear one at 10 m/s, the front one 25 m ahead at 12 m/s, in NGSIM's columns."""
    rows = []
    for k in range(round(10 * seconds)):
        for vehicle, start, v in ((1, 0.0, 10.0), (2, 25.0, 12.0)):
            y = (start + v * 0.1 * k) * FEET
            clock, length = 1118846980200 + 100 * (k + 1), 4.5 * FEET
            rows.append((vehicle, k + 1, 60, clock, 18.0, y, 0, 0, length, 6, 2, v * FEET, 0.0, 2, 0, 0, 0, 0))
    names = "Vehicle_ID Frame_ID Total_Frames Global_Time Local_X Local_Y Global_X Global_Y v_Length v_Width v_Class"
    names = [*names.split(), "v_Vel", "v_Acc", "Lane_ID", "Preceding", "Following", "Space_Headway", "Time_Headway"]
    pd.DataFrame(rows, columns=names).to_csv(path, index=False)
    return path


def test_a_recording_once_a_second_in_metres(tmp_path):
    found = recorded_samples(ngsim_file(tmp_path / "us-101.csv"))
    assert found.groupby("vehicle").size().tolist() == [6, 6]
    np.testing.assert_allclose(np.diff(found.loc[found["vehicle"] == 1, "time"]), 1.0)
    rear = found[found["vehicle"] == 1]
    np.testing.assert_allclose(rear["v"], 10.0, atol=1e-3)
    np.testing.assert_allclose(rear["a"], 0.0, atol=1e-3)
    np.testing.assert_allclose(rear["headway"], 25.0 + 2.0 * (rear["time"] - 0.1), atol=1e-2)
    np.testing.assert_allclose(rear["time_gap"], (rear["headway"] - 4.5) / 10, atol=1e-3)
    assert set(found["lane"]) == {2.0}


def test_too_short_a_recording_is_refused(tmp_path):
    with pytest.raises(InputError, match="no vehicle is recorded for"):
        recorded_samples(ngsim_file(tmp_path / "us-101.csv", seconds=1.0))


def test_a_table_is_read_and_a_wrong_one_refused(tmp_path):
    good = table(sample(0.0, 1, 1, 0.0, 5.0), sample(0.0, 2, 1, 20.0, 5.0))
    good.to_parquet(tmp_path / "good.parquet")
    assert recorded_samples(tmp_path / "good.parquet").loc[0, "time_headway"] == 4.0
    good.drop(columns="lane").to_parquet(tmp_path / "bad.parquet")
    with pytest.raises(InputError, match="column lane is missing"):
        recorded_samples(tmp_path / "bad.parquet")
    (tmp_path / "text.parquet").write_text("no")
    with pytest.raises(InputError, match="not a readable Parquet file"):
        recorded_samples(tmp_path / "text.parquet")


def write_run(tmp_path, closing: float) -> None:
    """A run of one group whose vehicles are each faster than the next one by `closing` [m/s], 20 m behind it."""
    times = np.round(600 + 0.2 * np.arange(11), 1)
    rows = [
        (driver, t, role, f"v{role}", True, t > 600.5, 10.0 + closing * (2 - role), 0.5, 20.0 if role < 2 else np.nan)
        for driver in ("gri", "sumo")
        for t in times
        for role in range(3)
    ]
    names = ["driver", "time", "role", "vehicle", "present", "during_drive", "v", "a", "gap"]
    steps = pd.DataFrame(rows, columns=names).assign(episode=0, driven=True, counterpart=False, s=0.0, d=0.0)
    steps.to_parquet(tmp_path / "steps.parquet")
    for other in set(TABLES) - {"steps"}:
        pd.DataFrame(columns=list(NEEDED.get(other, ("x",)))).to_parquet(tmp_path / f"{other}.parquet")
    (tmp_path / "scenario.json").write_text("{}")
    write_manifest(tmp_path, manifest({}, {}, tmp_path))


def test_a_run_gives_the_driven_vehicles_once_a_second(tmp_path):
    write_run(tmp_path, closing=0.0)
    found = run_samples(tmp_path)
    assert found.groupby("driver")["time"].unique().map(list).tolist() == [[601.0, 602.0]] * 2
    assert set(found["vehicle"]) == {"v0", "v1"}
    assert (found["time_gap"] == 2.0).all()
    assert (found["gap"] == 20.0).all()
    assert (found["relative_speed"] == 0.0).all()
    assert found["ttc"].isna().all()


def test_a_run_in_which_gaps_close_has_times_to_collision(tmp_path):
    write_run(tmp_path, closing=2.0)
    found = run_samples(tmp_path)
    assert (found["relative_speed"] == 2.0).all()
    assert (found["ttc"] == 10.0).all()


def test_recordings_of_other_layouts_give_the_same_samples(tmp_path):
    table = layout_files.traffic()
    ngsim = recorded_samples(layout_files.ngsim(table, tmp_path / "here.csv", "07-2"))
    highd = recorded_samples(layout_files.highd(table, tmp_path / "highd"))
    assert len(ngsim) > 100
    pd.testing.assert_frame_equal(ngsim.drop(columns="source"), highd.drop(columns="source"), check_exact=True)
