"""What a person has: any separator, encoding, archive, clock, axis. What is wrong is one line that says where."""

import gzip
import re
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gri.data.recordings import lanes
from gri.data.recordings.names import read_edges, read_map
from gri.data.recordings.parts import ReadingOptions
from gri.data.recordings.reading import open_recordings, recordings_of
from gri.data.recordings.road_axis import estimated_axis, on_roads
from gri.errors import InputError
from tests.gri.data.recordings import layout_files
from tests.gri.data.recordings.layout_files import tidy, traffic


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """The made-up traffic, three seconds of it, as a tidy table."""
    return pd.read_csv(tidy(traffic(30), tmp_path_factory.mktemp("tidy")))


def rows_of(path: Path, **options) -> np.ndarray:
    (recording,) = recordings_of(path, ReadingOptions(**options))
    return recording.rows


def test_separators_decimal_marks_and_encodings_are_recognised(table: pd.DataFrame, tmp_path: Path):
    named = table.assign(**{"class": "Pkw größer"})
    plain = tmp_path / "a.csv"
    named.to_csv(plain, index=False)
    wanted = rows_of(plain)
    ways = [
        (";", ",", "cp1252"), ("\t", ".", "utf-8"), ("\t", ",", "utf-16"), ("|", ".", "utf-8-sig"),
    ]  # fmt: skip
    for k, (separator, decimal, encoding) in enumerate(ways):
        path = tmp_path / f"{k}.csv"
        named.to_csv(path, index=False, sep=separator, decimal=decimal, encoding=encoding)
        np.testing.assert_array_equal(rows_of(path), wanted)
    spaced = tmp_path / "spaced.txt"
    spaced.write_text(table.drop(columns="class").to_string(index=False))
    assert len(rows_of(spaced)) == len(wanted)


def test_gzip_zip_and_folders_hold_the_same(table: pd.DataFrame, tmp_path: Path):
    plain = tmp_path / "folder" / "a.csv"
    plain.parent.mkdir()
    table.to_csv(plain, index=False)
    wanted = rows_of(plain)
    packed = tmp_path / "a.csv.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    zipped = tmp_path / "mac.zip"
    with zipfile.ZipFile(zipped, "w") as archive:
        archive.write(plain, "data/a.csv")
        archive.writestr("__MACOSX/data/._a.csv", b"\0\5\x16\7")
        archive.writestr("data/.DS_Store", b"\0\0\0\1Bud1")
    (plain.parent / "._a.csv").write_bytes(b"\0\5\x16\7")
    for path in (packed, zipped, plain.parent):
        np.testing.assert_array_equal(rows_of(path), wanted)
    table.to_parquet(tmp_path / "a.parquet")
    np.testing.assert_array_equal(rows_of(tmp_path / "a.parquet"), wanted)


def test_ngsim_files_in_a_zip_of_macos_are_read(tmp_path: Path):
    csv = layout_files.ngsim(traffic(30), tmp_path / "us-101.csv", "")
    zipped = tmp_path / "us-101.zip"
    with zipfile.ZipFile(zipped, "w") as archive:
        archive.write(csv, "us-101.csv")
        archive.writestr("__MACOSX/._us-101.csv", b"\0\5\x16\7")
    np.testing.assert_array_equal(rows_of(zipped), rows_of(csv))


def test_ngsim_files_with_other_separators_and_rounded_clocks_are_read(tmp_path: Path):
    path = layout_files.ngsim(traffic(30), tmp_path / "us-101.csv", "1118846980200")
    wanted = rows_of(path)
    content = pd.read_csv(path)
    for separator, decimal, encoding in ((";", ",", "utf-8"), ("\t", ".", "utf-16"), (";", ".", "utf-8")):
        content.to_csv(path, index=False, sep=separator, decimal=decimal, encoding=encoding)
        np.testing.assert_array_equal(rows_of(path), wanted)
    content.assign(Global_Time=content["Global_Time"] // 10**7 * 10**7).to_csv(path, index=False)
    found = open_recordings(path, tmp_path)
    assert len(found) == 1
    assert "Global_Time is rounded to seconds or more" in found.notes[0]
    (rounded,) = recordings_of(path)
    order = ["vehicle", "frame"]
    np.testing.assert_array_equal(np.sort(rounded.rows, order=order), np.sort(wanted, order=order))


def test_a_zip_of_highd_has_one_recording_per_file_and_direction(tmp_path: Path):
    folder = layout_files.highd(traffic(30), tmp_path / "highd").parent
    for path in list(folder.glob("07_*")):
        (folder / path.name.replace("07", "08")).write_bytes(path.read_bytes())
    zipped = tmp_path / "highd.zip"
    with zipfile.ZipFile(zipped, "w") as archive:
        for path in folder.glob("*"):
            archive.write(path, f"highd-dataset/data/{path.name}")
    assert [r.name for r in recordings_of(zipped)] == ["highd@07-2", "highd@08-2"]


def test_foreign_names_and_units_are_mapped(table: pd.DataFrame, tmp_path: Path):
    path = tmp_path / "a.csv"
    table.to_csv(path, index=False)
    wanted = rows_of(path)
    foreign = table.assign(
        Zeit=table["time_s"] * 1000, Ort=table["s_m"] / 0.3048, quer=-table["d_m"], km_h=table["speed_mps"] * 3.6
    ).drop(columns=["time_s", "s_m", "d_m", "speed_mps"])
    foreign.rename(columns={"vehicle_id": "Fz Nr."}).to_csv(path, index=False)
    columns = read_map(
        ["time_s=Zeit*0.001", "s_m=Ort*0.3048", "d_m=quer*-1", "speed_mps=km_h*0.2777777777777778", "vehicle_id=Fz Nr."]
    )
    found = rows_of(path, columns=columns)
    for name in ("x", "y", "speed"):
        np.testing.assert_allclose(found[name], wanted[name], rtol=1e-5)
    np.testing.assert_array_equal(found["vehicle"], wanted["vehicle"])


def test_positions_along_one_axis_are_enough(table: pd.DataFrame, tmp_path: Path):
    path = tmp_path / "a.csv"
    table.drop(columns=["d_m", "width_m", "speed_mps"]).to_csv(path, index=False)
    rows = rows_of(path)
    assert not rows["x"].any()
    assert np.abs(rows["speed"] - 30).max() < 10, "the derivative of the position, in ft/s"


WRONG = {
    "a word for a number": (
        lambda text: text.replace("\n0.1,2,", "\nNull Komma eins,2,", 1),
        "a.csv:3: column time_s: got 'Null Komma eins', wanted a number",
    ),
    "decimal commas between commas": (
        lambda text: "time_s,vehicle_id,s_m\n" + "0,1,1,5,2\n" * 3,
        "a.csv:2: got 5 values for 3 columns, probably decimal commas",
    ),
    "a missing column": (lambda text: text.replace("s_m", "there", 1), "column s_m is missing, got .*--map s_m=COLUMN"),
    "unknown layout": (lambda text: text.replace("time_s", "Zeit", 1), "not a known layout: .*Zeit, vehicle_id.*--map"),
    "a column twice": (lambda text: text.replace("lane", "s_m", 1), "column s_m is there twice"),
    "rows of several lengths": (lambda text: text + '"1,2,3\n', "a.csv.*(rows of different lengths|wanted a number)"),
    "an empty file": (lambda text: "", "a.csv: is empty"),
    "no rows": (lambda text: text.split("\n")[0] + "\n", "a.csv: has no rows"),
    "bytes": (lambda text: "\0\1\2\n\0", "got bytes that are no text"),
    "infinite": (lambda text: text.replace("\n0.1,", "\ninf,", 1), "column time_s has an infinite number"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_with_a_file_is_one_line(case: str, table: pd.DataFrame, tmp_path: Path):
    change, said = WRONG[case]
    path = tmp_path / "a.csv"
    text = table.sort_values(["time_s", "vehicle_id"], kind="stable").to_csv(index=False)
    path.write_text(change(text))
    with pytest.raises(InputError, match=said) as caught:
        list(recordings_of(path))
    assert "\n" not in str(caught.value)


CHANGED = {
    "feet as metres": (lambda t: t.assign(length_m=t["length_m"] / 0.3048), "median length of vehicles is 15.0 m"),
    "km/h": (lambda t: t.assign(speed_mps=t["speed_mps"] * 3.6), "move 0.28 times as far as their speeds say"),
    "backwards": (lambda t: t.assign(s_m=-t["s_m"]), "they decrease in driving direction: map s_m=COLUMN.-1"),
    "a rounded clock": (lambda t: t.assign(time_s=t["time_s"].round(0)), "the times look rounded"),
    "coarse": (lambda t: t.assign(time_s=t["time_s"] * 20), "got steps of 2 s, wanted up to 1 s"),
    "one row each": (lambda t: t.groupby("vehicle_id").head(1), "got one row per vehicle, wanted tracks"),
    "neither lanes nor places": (lambda t: t.drop(columns=["lane", "d_m"]), "got neither lanes nor lateral positions"),
}


@pytest.mark.parametrize("case", CHANGED)
def test_units_and_clocks_that_cannot_be_right_are_one_line(case: str, table: pd.DataFrame, tmp_path: Path):
    change, said = CHANGED[case]
    path = tmp_path / "a.csv"
    change(table).to_csv(path, index=False)
    with pytest.raises(InputError, match=said):
        list(recordings_of(path))


def test_times_with_two_decimals_are_the_same_frames(table: pd.DataFrame, tmp_path: Path):
    path = tmp_path / "a.csv"
    table.to_csv(path, index=False)
    wanted = rows_of(path)
    rng = np.random.default_rng(1)
    table.assign(time_s=table["time_s"] + rng.uniform(-0.004, 0.004, len(table))).to_csv(path, index=False)
    np.testing.assert_array_equal(rows_of(path)["frame"], wanted["frame"])


def test_mapping_and_edges_say_what_they_want():
    with pytest.raises(InputError, match="--map: got 'speed', wanted COLUMN=NAME"):
        read_map(["speed"])
    with pytest.raises(InputError, match="--lane-edges: got '3;4'"):
        read_edges("3;4")


def test_a_cut_document_of_i24_is_named(tmp_path: Path):
    path = layout_files.i24(traffic(20), tmp_path)
    text = path.read_text()
    path.write_text(text[: len(text) // 2])
    with pytest.raises(InputError, match=r"document \d+: not readable as JSON"):
        list(recordings_of(path))
    path.write_text(text.replace('"direction": -1', '"direction": 5', 1))
    with pytest.raises(InputError, match="document 1: got direction 5"):
        list(recordings_of(path))


def _ring(radius: float = 800.0) -> pd.DataFrame:
    """Six vehicles in three lanes of a bend to the left, and two on the other carriageway."""
    parts = []
    for k, (offset, way) in enumerate(
        [(-2.0, 1), (-2.0, 1), (-5.5, 1), (-5.5, 1), (-9.0, 1), (-9.0, 1), (2.0, -1), (5.5, -1)]
    ):
        s = way * np.arange(0, 30, 0.1) * 12 + (40.0 * k if way > 0 else 400.0)
        angle = 0.4 + s / radius
        r = radius - offset
        parts.append(pd.DataFrame({"vehicle_id": k, "time_s": np.arange(0, 30, 0.1), "s": s, "d": offset,
                                   "x_m": r * np.sin(angle) + 500, "y_m": -r * np.cos(angle) - 90}))  # fmt: skip
    return pd.concat(parts, ignore_index=True).assign(path=lambda t: t["vehicle_id"].astype(str))


def test_the_axis_of_a_bend_is_found_and_both_directions_are_roads_of_their_own():
    table = _ring()
    axis = estimated_axis(table, "here")
    assert axis.bend
    notes: list[str] = []
    roads = dict(on_roads(table, axis, notes))
    assert set(roads) == {"", "against"}
    assert sorted(roads["against"]["vehicle_id"].unique()) == [6, 7]
    for road in roads.values():
        for _, rows in road.groupby("vehicle_id"):
            true = np.ptp(rows["s"]) * (800 - rows["d"].iloc[0]) / 800
            assert np.ptp(rows["s_m"]) == pytest.approx(true, rel=0.02), "distance along the axis, lanes apart"
            assert np.ptp(rows["d_m"]) < 0.6
    edges = lanes.estimated_edges(roads[""]["d_m"])
    assert len(edges) == 2
    assert np.diff(edges) == pytest.approx(-3.5, abs=0.4)


def test_lanes_are_numbered_from_the_left_by_where_their_vehicles_drive():
    label, d = pd.Series(["b", "a", "", "c", "a", "a2"]), pd.Series([-1.0, -8.0, 3.0, -4.5, -8.1, -8.3])
    assert lanes.from_labels(label, d).tolist() == [1, 3, 0, 2, 3, 3]
    assert lanes.from_edges(pd.Series([0.0, -3.0, -5.0]), (-2.0, -4.0)).tolist() == [1, 2, 3]


def test_notes_tell_what_was_assumed(tmp_path: Path):
    path = layout_files.interaction(traffic(40), tmp_path)
    found = open_recordings(path, tmp_path)
    text = " ".join(found.notes)
    assert re.search(r"the road's axis is a straight line at -?[0-9.]+°, estimated", text)
    assert "4 lanes, estimated from lateral positions" in text


def test_cases_of_interaction_have_vehicles_of_the_same_number(tmp_path: Path):
    """A vehicle of one case drives one way, the vehicle of the same number in another case the other way."""
    path = layout_files.interaction(traffic(40), tmp_path)
    first = pd.read_csv(path)
    second = first.assign(x=500 - first["x"], y=-30 - first["y"], vx=-first["vx"], psi_rad=np.pi)
    pd.concat([first.assign(case_id=1.0), second.assign(case_id=2.0)]).to_csv(path, index=False)
    found = open_recordings(path, tmp_path, ReadingOptions(axis=(0.0, 0.0, 1.0, 0.0), lane_edges=layout_files.EDGES))
    assert [recording.label for recording in found] == ["1", "2-against"]
    assert len({len(recording.rows) for recording in found}) == 1
