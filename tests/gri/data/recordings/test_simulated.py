"""SUMO's FCD output in its three formats, and the tables of run folders."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gri.data.recordings.parts import ReadingOptions
from gri.data.recordings.reading import open_recordings, recordings_of
from gri.data.recordings.sumo_fcd import vehicle_types
from gri.errors import InputError

TYPES = (
    '<additional><vType id="car" length="4.5"/><vType id="lorry" vClass="truck" length="9" width="2.5"/></additional>'
)


def fcd(step: float = 0.1, seconds: float = 8.0) -> pd.DataFrame:
    """Two lanes along the net's y axis, three cars in each at 10 m/s, with the columns of SUMO's Parquet output."""
    parts = []
    for k in range(6):
        time = np.arange(0, seconds, step)
        parts.append(
            pd.DataFrame(
                {
                    "timestep_time": time.round(2),
                    "vehicle_id": f"f.{k}",
                    "vehicle_x": 1.6 if k % 2 else -1.6,
                    "vehicle_y": 20.0 * k + 10 * time,
                    "vehicle_angle": 0.0,
                    "vehicle_type": "lorry" if k == 5 else "car",
                    "vehicle_speed": 10.0,
                    "vehicle_lane": f"e_{1 - k % 2}",
                }
            )
        )
    return pd.concat(parts).sort_values(["timestep_time", "vehicle_id"], kind="stable", ignore_index=True)


def as_xml(table: pd.DataFrame) -> str:
    steps = []
    for time, rows in table.groupby("timestep_time"):
        vehicles = "".join(
            "<vehicle "
            + " ".join(f'{n.removeprefix("vehicle_")}="{v}"' for n, v in row.items() if n != "timestep_time")
            + "/>"
            for row in rows.to_dict("records")
        )
        steps.append(f'<timestep time="{time:.2f}">{vehicles}<person id="p" x="0" y="0"/></timestep>')
    return '<?xml version="1.0"?><!-- generated --><fcd-export>' + "".join(steps) + "</fcd-export>"


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    table = fcd()
    (tmp_path / "fcd.xml").write_text(as_xml(table))
    table.to_csv(tmp_path / "fcd.csv", sep=";", index=False)
    table.to_parquet(tmp_path / "fcd.parquet", index=False)
    (tmp_path / "types.add.xml").write_text(TYPES)
    return [tmp_path / f"fcd.{ending}" for ending in ("xml", "csv", "parquet")]


def test_the_three_formats_hold_the_same_vehicles_on_their_lanes(files: list[Path]):
    options = ReadingOptions(types=files[0].with_name("types.add.xml"))
    tables = [next(iter(recordings_of(path, options))).rows for path in files]
    for rows in tables:
        np.testing.assert_array_equal(rows, tables[0])
    first = tables[0][tables[0]["vehicle"] == 1]
    np.testing.assert_allclose(np.diff(first["y"]) * 0.3048, 1.0, atol=1e-4)
    assert set(first["lane"]) == {1}, "the lane with the greater index is on the left"
    assert set(tables[0]["lane"][tables[0]["vehicle"] == 2]) == {2}
    lorry = tables[0][tables[0]["vehicle"] == 6]
    assert float(lorry["length"][0]) * 0.3048 == pytest.approx(9.0)
    assert set(lorry["kind"]) == {3}


def test_without_types_lengths_are_unknown_and_a_note_says_so(files: list[Path], tmp_path: Path):
    found = open_recordings(files[0], tmp_path)
    (recording,) = found
    assert not recording.rows["length"].any()
    assert any("give the file with the vehicle types" in note for note in found.notes)


@pytest.mark.parametrize("step", [0.05, 0.2, 0.5, 1.0])
def test_other_steps_are_interpolated(step: float, tmp_path: Path):
    path = tmp_path / "fcd.parquet"
    fcd(step).to_parquet(path)
    found = open_recordings(path, tmp_path)
    assert any(f"interpolated from steps of {step:g} s" in note for note in found.notes)
    (recording,) = found
    rows = recording.rows[recording.rows["vehicle"] == 3]
    assert (np.diff(rows["frame"]) == 1).all()
    np.testing.assert_allclose(np.diff(rows["y"]) * 0.3048, 1.0, atol=1e-3)


def test_positions_between_coarse_steps_are_smooth(tmp_path: Path):
    """At 1 m/s² and steps of 1 s, straight lines would be up to 0.125 m off."""
    table = fcd(1.0, 20.0)
    first = table.groupby("vehicle_id")["vehicle_y"].transform("first")
    table["vehicle_y"] = first + 5 * table["timestep_time"] + 0.5 * table["timestep_time"] ** 2
    table["vehicle_speed"] = 5 + table["timestep_time"]
    table.to_parquet(tmp_path / "fcd.parquet")
    (recording,) = recordings_of(tmp_path / "fcd.parquet")
    rows = recording.rows[recording.rows["vehicle"] == 1]
    time = rows["frame"] * 0.1
    np.testing.assert_allclose(rows["y"] * 0.3048, 5 * time + 0.5 * time**2, atol=0.02)


def test_geographic_output_and_files_without_types_are_one_line(tmp_path: Path):
    (tmp_path / "a.csv").write_text("timestep_time;vehicle_id;vehicle_lane\n0;1;e_0\n")
    with pytest.raises(InputError, match="vehicle_x is missing; write the output again with x and y"):
        list(recordings_of(tmp_path / "a.csv"))
    (tmp_path / "cut.xml").write_text(as_xml(fcd())[:3000])
    with pytest.raises(InputError, match="not a readable FCD output"):
        list(recordings_of(tmp_path / "cut.xml"))
    (tmp_path / "empty.xml").write_text("<additional/>")
    with pytest.raises(InputError, match="got no <vType>"):
        vehicle_types(tmp_path / "empty.xml")


def test_a_run_folder_has_one_recording_per_episode_and_counterpart(tmp_path: Path):
    time = np.arange(100.0, 108.0, 0.2)
    own = {"driver": "idm", "x": 0.0, "y": 0.0, "heading": 0.0, "v": 12.0, "a": 0.0, "length": 4.5, "width": 1.8}
    parts = [
        pd.DataFrame({"episode": episode, "counterpart": counterpart, "time": time, "vehicle": f"v{k}", **own}).assign(
            s=30.0 * k + 12 * (time - 100), d=-3.2 * (k % 2)
        )
        for episode in (0, 1)
        for counterpart in (False, True)
        for k in range(4)
    ]
    pd.concat(parts).to_parquet(tmp_path / "surroundings.parquet")
    (tmp_path / "manifest.json").write_text("{}")
    found = open_recordings(tmp_path, tmp_path, ReadingOptions(site="run"))
    assert [r.name for r in found] == ["run@0", "run@1", "run@0-counterpart", "run@1-counterpart"]
    rows = next(iter(found)).rows
    assert set(zip(rows["vehicle"].tolist(), rows["lane"].tolist(), strict=True)) == {(1, 1), (2, 2), (3, 1), (4, 2)}
    np.testing.assert_allclose(np.diff(rows["y"][rows["vehicle"] == 1]) * 0.3048, 1.2, atol=1e-3)
