"""The same traffic in every layout gives the same scenes, to the last bit, as in NGSIM's layout."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gri.data.ngsim.rules import Rules
from gri.data.recordings.parts import ReadingOptions
from gri.data.recordings.scenes import inspect_file, make_scenes, write_tidy
from tests.gri.data.recordings import layout_files
from tests.gri.data.recordings.layout_files import EDGES, LABELS, WRITERS, traffic

AXIS = (0.0, 0.0, 100.0, 0.0)
OPTIONS = {
    "exid": ReadingOptions(site="here", axis=AXIS),
    "interaction": ReadingOptions(site="here", axis=AXIS, lane_edges=EDGES),
    "tgsim": ReadingOptions(site="here", axis=AXIS),
}
HERE = ReadingOptions(site="here")


def scenes_of(path: Path, options: ReadingOptions = HERE, rules: Rules | None = None) -> pd.DataFrame:
    out = path.parent / f"{path.stem}.scenes.parquet"
    make_scenes([path], out, rules or Rules(), options)
    return pd.read_parquet(out)


def as_ngsim(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """The traffic as the layout can hold it: I-24 MOTION has no numbers of vehicles, and lanes begin at 12 ft."""
    if name != "i24":
        return table
    ranks = {number: k + 1 for k, number in enumerate(sorted(table["Vehicle_ID"].unique()))}
    return table.assign(Vehicle_ID=table["Vehicle_ID"].map(ranks), Local_X=table["Local_X"] + 12.0)


@pytest.mark.parametrize("name", WRITERS)
def test_scenes_are_those_of_ngsims_layout_to_the_last_bit(name: str, tmp_path: Path):
    table = traffic()
    scenes = scenes_of(WRITERS[name](table, tmp_path / name), OPTIONS.get(name, HERE))
    wanted = scenes_of(layout_files.ngsim(as_ngsim(table, name), tmp_path / "ngsim" / "a.csv", LABELS[name]))
    assert len(scenes) >= 1300
    assert {"car_following", "lane_changing_h1", "lane_changing_h2"} == set(scenes["kind"])
    for column in wanted.columns.drop("recording"):
        pd.testing.assert_series_equal(scenes[column], wanted[column], check_exact=True)


def test_another_place_of_one_vehicle_gives_other_scenes(tmp_path: Path):
    """The comparison above can fail: one position that differs by 2 cm is seen."""
    table = traffic()
    first = scenes_of(layout_files.tidy(table, tmp_path / "one"), HERE)
    table.loc[(table["Vehicle_ID"] == 2) & (table["Frame_ID"] == 40), "Local_Y"] += 0.066
    second = scenes_of(layout_files.tidy(table, tmp_path / "two"), HERE)
    assert not first["x"].equals(second["x"])


@pytest.mark.parametrize("name", WRITERS)
def test_layouts_are_recognised_and_classes_counted(name: str, tmp_path: Path):
    report = inspect_file(WRITERS[name](traffic(60), tmp_path), OPTIONS.get(name, HERE))
    assert report.layout == name
    (classes,) = report.classes
    assert classes == {"car": 11, "truck": 1, "motorcycle": 1}
    assert report.lateral == (True,)


def test_both_carriageways_of_highd_are_seen_in_driving_direction(tmp_path: Path):
    """The upper carriageway is the lower one turned by half a turn: the same scenes."""
    table = traffic()
    path = layout_files.highd(table, tmp_path / "lower")
    lower = pd.read_csv(path)
    lower["width"] += 2.0 * (lower["id"] % 2)  # lengths differ, so that the front bumper is not any corner
    lower.to_csv(path, index=False)
    upper = lower.assign(
        x=-(lower["x"] + lower["width"]), y=-(lower["y"] + lower["height"]), xVelocity=-lower["xVelocity"],
        laneId=11 - lower["laneId"],
    )  # fmt: skip
    turned = layout_files.highd(table, tmp_path / "upper")
    upper.to_csv(turned, index=False)
    meta = pd.read_csv(turned.with_name("07_tracksMeta.csv"))
    meta.assign(drivingDirection=1).to_csv(turned.with_name("07_tracksMeta.csv"), index=False)
    recording = pd.read_csv(turned.with_name("07_recordingMeta.csv"))
    recording.assign(upperLaneMarkings="0;4;8;12;16").to_csv(turned.with_name("07_recordingMeta.csv"), index=False)
    ours, theirs = (scenes_of(p).query("~source.str.endswith('drawn')") for p in (path, turned))
    assert len(ours) == len(theirs) > 1000
    for name in ("v", "a", "y", "vy"):
        np.testing.assert_allclose(theirs[name], ours[name], atol=1e-3)
    along = [frame["x"] - frame["x"].groupby(frame["scene"]).transform("first") for frame in (theirs, ours)]
    np.testing.assert_allclose(along[0], along[1], atol=1e-3)


def test_i24_eastbound_is_the_mirror_of_westbound(tmp_path: Path):
    table = traffic()
    west, east = (scenes_of(layout_files.i24(table, tmp_path / str(way), way)) for way in (-1, 1))
    recorded = ~west["source"].str.endswith("drawn")
    assert recorded.sum() > 1000
    for name in ("x", "v", "y"):
        np.testing.assert_allclose(west.loc[recorded, name], east.loc[recorded, name], atol=1e-4)


def test_a_faster_camera_gives_nearly_the_same_scenes(tmp_path: Path):
    """25 frames per second, as highD has: positions between frames are interpolated to 10 per second."""
    table = traffic(120)
    slow = scenes_of(layout_files.highd(table, tmp_path / "slow"))
    path = layout_files.highd(table, tmp_path / "fast", rate=25.0)
    tracks = pd.read_csv(path)
    finer = [_resampled(rows, 0.1, 0.04) for _, rows in tracks.groupby("id")]
    pd.concat(finer).to_csv(path, index=False)
    fast = scenes_of(path)
    chosen = [frame[~frame["source"].str.endswith("drawn")].reset_index(drop=True) for frame in (slow, fast)]
    assert len(chosen[0]) == len(chosen[1]) > 1000
    np.testing.assert_allclose(chosen[1]["v"], chosen[0]["v"], atol=0.02)
    np.testing.assert_allclose(chosen[1]["x"], chosen[0]["x"], atol=0.02)


def _resampled(rows: pd.DataFrame, old: float, new: float) -> pd.DataFrame:
    """One track of highD at another frame rate; straight lines between its frames."""
    time = rows["frame"] * old
    frame = np.arange(np.ceil(time.iloc[0] / new), np.floor(time.iloc[-1] / new) + 1)
    made = {name: np.interp(frame * new, time, rows[name]) for name in rows}
    before = np.searchsorted(time, frame * new + 1e-9, "right") - 1
    return pd.DataFrame(made | {"frame": frame.astype(int), "laneId": rows["laneId"].to_numpy()[before]})


def test_all_test_puts_every_scene_there_and_draws_none(tmp_path: Path):
    scenes = scenes_of(layout_files.tidy(traffic(), tmp_path), HERE, Rules(block=0))
    assert set(scenes["split"]) == {"test"}
    assert not scenes["source"].str.endswith("drawn").any()
    assert len(scenes["scene"].unique()) > 10


def test_a_tidy_table_made_of_a_recording_gives_the_same_scenes(tmp_path: Path):
    path = layout_files.ngsim(traffic(), tmp_path / "us-101.csv", "1118846980200")
    write_tidy([path], tmp_path / "tidy.parquet", HERE)
    ours, theirs = scenes_of(path), scenes_of(tmp_path / "tidy.parquet")
    pd.testing.assert_frame_equal(ours, theirs, check_exact=True)
