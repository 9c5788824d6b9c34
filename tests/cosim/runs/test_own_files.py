"""A run in traffic that SUMO files of the user describe."""

import json
from pathlib import Path

import pytest

import cosim
from gri.resources import shipped

pytestmark = pytest.mark.usefixtures("forked_workers")
ROUTES = """<routes>
  <vType id="quick" sigma="0.4" speedFactor="normc(1,0.1,0.8,1.2)"/>
  <vType id="slow" carFollowModel="IDM" length="12" vClass="truck" speedFactor="0.8"/>
  <vTypeDistribution id="mix" vTypes="quick slow" probabilities="0.9 0.1"/>
  <flow id="main" type="mix" from="entry" to="downstream" begin="0" end="200" vehsPerHour="7000" departLane="random"
    departSpeed="max"/>
</routes>
"""
ADDITIONAL = """<additional>
  <inductionLoop id="counter" lane="weave_1" pos="50" period="10" file="counts.xml"/>
</additional>
"""
CONFIGURATION = """<configuration>
  <net-file value="{net}"/><route-files value="mine.rou.xml"/><additional-files value="mine.add.xml"/>
  <time-to-teleport value="120"/><fcd-output value="positions.xml"/>
</configuration>
"""
SCENARIO = """road: {edges: [entry, weave, exit, downstream_free, downstream], origin: entry, length: 640}
traffic: {sumocfg: mine.sumocfg, warm_up: 40}
group: {rule: car_following, max_gap: 60}
policy: {kind: idm}
history: 2.0
horizon: 3.0
watch: 1.0
episodes: 2
time_limit: 60
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a configuration, its files, and a scenario."""
    net = shipped("sumo_nets", "us101", "us101.net.xml")
    (tmp_path / "mine.sumocfg").write_text(CONFIGURATION.format(net=net))
    (tmp_path / "mine.rou.xml").write_text(ROUTES)
    (tmp_path / "mine.add.xml").write_text(ADDITIONAL)
    (tmp_path / "mine.yaml").write_text(SCENARIO)
    return tmp_path


def test_groups_of_the_users_own_vehicles_are_driven_and_nothing_is_written_beside_them(folder: Path) -> None:
    run = cosim.run(folder / "mine.yaml", folder=folder / "run")
    assert all(vehicle.startswith("main.") for vehicle in run.groups["vehicle_0"])
    assert set(run.groups["driver"]) >= {"idm"}
    assert not (folder / "counts.xml").exists()
    assert not (folder / "positions.xml").exists()
    manifest = json.loads((folder / "run" / "manifest.json").read_text())
    assert set(manifest["inputs"]) == {"net", "routes.0", "additional.0", "sumocfg"}
    told = manifest["arguments"]["sumo_arguments"]
    assert told[told.index("--time-to-teleport") + 1] == "120"
    assert told[told.index("--collision.action") + 1] == "warn"
    assert "--fcd-output" not in told
