"""An episode in the formats of other tools, read again by readers of those formats."""

from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import pandas as pd
import pytest

from cosim.runs.finished_run import write_manifest
from cosim.runs.run_reading import NEEDED, TABLES
from cosim.runs.run_tables import manifest
from cosim.show.export.commonroad import write_commonroad
from cosim.show.export.fcd import fcd, vehicle_types
from cosim.show.export.moving_vehicles import MovingVehicles, vehicles_of
from cosim.show.export.net_lanes import net_lanes, places
from cosim.show.export.openscenario import write_openscenario
from cosim.spec.loading import load_scenario
from gri.data.recordings.parts import ReadingOptions
from gri.data.recordings.reading import recordings_of
from gri.errors import InputError

STEP = 0.2


@pytest.fixture
def moving() -> MovingVehicles:
    """Three vehicles on lanes of US-101: one leaves for a second and comes back, one is a truck with an odd name."""
    time = 100 + STEP * np.arange(20)
    parts = []
    for k, (name, length) in enumerate([("a", 4.5), ("b", 5.0), ('"<c>', 12.0)]):
        rows = pd.DataFrame({"time": time.round(6), "vehicle": name, "x": 250 + 40.0 * k + 12 * (time - 100)})
        rows = rows.assign(y=-9.0 - 3.7 * k, heading=0.0, v=12.0, a=0.1, length=length, width=1.8)
        parts.append(rows.drop(index=range(8, 13)) if name == "b" else rows)
    rows = pd.concat(parts).sort_values(["time", "vehicle"], kind="stable", ignore_index=True)
    return MovingVehicles("episode-0", STEP, rows, "us101")


def test_fcd_is_read_again_with_the_same_places_sizes_and_lanes(moving: MovingVehicles, tmp_path: Path):
    (tmp_path / "a.fcd.xml").write_text(fcd(moving))
    (tmp_path / "a.types.add.xml").write_text(vehicle_types(moving))
    options = ReadingOptions(types=tmp_path / "a.types.add.xml", axis=(0.0, 0.0, 1.0, 0.0))
    (recording,) = recordings_of(tmp_path / "a.fcd.xml", options)
    rows = recording.rows
    numbers = {1: '"<c>', 2: "a", 3: "b"}
    for number, name in numbers.items():
        found, wanted = rows[rows["vehicle"] == number], moving.rows[moving.rows["vehicle"] == name]
        every_second = found[np.isin(found["frame"], (wanted["time"] * 10).round().astype(int))]
        np.testing.assert_allclose(every_second["y"] * 0.3048, wanted["x"], atol=2e-3)
        assert float(found["length"][0]) * 0.3048 == pytest.approx(wanted["length"].iloc[0], abs=1e-3)
    assert {int(k) for k in rows["kind"][rows["vehicle"] == 1]} == {3}
    lanes = ElementTree.fromstring(fcd(moving)).findall(".//vehicle[@id='a']")
    assert {row.get("lane") for row in lanes} <= {lane.name for lane in net_lanes("us101")}
    assert all(row.get("lane") for row in lanes)


def test_places_on_lanes_are_those_of_their_centre_lines():
    lanes = net_lanes("us101")
    chosen = next(k for k, lane in enumerate(lanes) if lane.name == "weave_2")
    a, b = lanes[chosen].centre[:2]
    index, pos = places(lanes, np.array([a + 0.25 * (b - a), [1e5, 0.0]]))
    assert index.tolist() == [chosen, -1]
    assert pos[0] == pytest.approx(0.25 * np.hypot(*(b - a)))


def test_openscenario_has_a_trajectory_for_every_track(moving: MovingVehicles, tmp_path: Path):
    pytest.importorskip("scenariogeneration")
    write_openscenario(moving, tmp_path / "a.xosc", "road.xodr")
    root = ElementTree.parse(tmp_path / "a.xosc").getroot()
    assert [o.get("name") for o in root.iter("ScenarioObject")] == ['"<c>', "a", "b", "b.1"]
    vertices = [polyline.findall("Vertex") for polyline in root.iter("Polyline")]
    assert [len(v) for v in vertices] == [20, 20, 8, 7]
    first, last = (vertices[1][k] for k in (0, -1))
    assert float(last.get("time")) == pytest.approx(3.8)
    assert float(first.find(".//WorldPosition").get("x")) == pytest.approx(250 - 4.5 / 2), "the middle, not the front"
    assert root.find(".//LogicFile").get("filepath") == "road.xodr"


def test_commonroad_has_lanelets_and_an_obstacle_for_every_track(moving: MovingVehicles, tmp_path: Path):
    write_commonroad(moving, tmp_path / "a.xml")
    root = ElementTree.parse(tmp_path / "a.xml").getroot()
    obstacles = root.findall("dynamicObstacle")
    assert [len(o.findall("trajectory/state")) + 1 for o in obstacles] == [20, 20, 8, 7]
    assert obstacles[0].findtext("type") == "truck"
    assert obstacles[3].findtext("initialState/time/exact") == "13"
    assert float(obstacles[1].findtext("initialState/position/point/x")) == pytest.approx(250 - 4.5 / 2)
    assert len(root.findall("lanelet")) == len(net_lanes("us101"))
    ids = [element.get("id") for element in [*root.findall("lanelet"), *obstacles]]
    assert len(set(ids)) == len(ids)
    left, right = (root.find(f"lanelet/{side}/point/y") for side in ("leftBound", "rightBound"))
    assert float(left.text) > float(right.text)


def test_commonroad_io_reads_the_file(moving: MovingVehicles, tmp_path: Path):
    reader = pytest.importorskip("commonroad.common.file_reader", reason="commonroad-io is not installed")
    write_commonroad(moving, tmp_path / "a.xml")
    scenario, _ = reader.CommonRoadFileReader(str(tmp_path / "a.xml")).open()
    assert (scenario.dt, len(scenario.dynamic_obstacles)) == (STEP, 4)
    assert len(scenario.lanelet_network.lanelets) == len(net_lanes("us101"))


def test_vehicles_of_a_run_folder(tables, tmp_path: Path):
    for name in TABLES:
        table = tables[name].assign(vehicle="") if name == "steps" else tables[name]
        missing = [column for column in NEEDED.get(name, ()) if column not in table]
        table.assign(**dict.fromkeys(missing, 0.0)).to_parquet(tmp_path / f"{name}.parquet")
    (tmp_path / "scenario.json").write_bytes(msgspec.json.encode(load_scenario("us101_car_following")))
    write_manifest(tmp_path, manifest({}, {}, tmp_path))
    moving = vehicles_of(tmp_path, 0)
    assert moving.rows["vehicle"].nunique() == 3
    left = vehicles_of(tmp_path, 0, counterpart=True)
    assert float((moving.rows["x"] - left.rows["x"]).mean()) == pytest.approx(2.0)
    with pytest.raises(InputError, match=r"got 7, .* has the episodes 0 to 0"):
        vehicles_of(tmp_path, 7)
