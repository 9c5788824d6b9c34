"""A short road with an acceleration lane, and environments on it that share their warm-up."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

pytest.importorskip("gymnasium", reason="needs the extra `rl`")
pytest.importorskip("pettingzoo", reason="needs the extra `rl`")

from cosim.environments import DrivingEnv, GroupEnv
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Scenario

NODES = """<nodes>
<node id="n0" x="0" y="0"/><node id="n1" x="300" y="0"/><node id="n2" x="600" y="0" type="priority"/>
<node id="n3" x="1000" y="0"/><node id="m0" x="60" y="-80"/>
</nodes>"""
EDGES = """<edges>
<edge id="before" from="n0" to="n1" numLanes="2" speed="22"/>
<edge id="beside" from="n1" to="n2" numLanes="3" speed="22"/>
<edge id="after" from="n2" to="n3" numLanes="2" speed="22"/>
<edge id="ramp" from="m0" to="n1" numLanes="1" speed="18"/>
</edges>"""
CONNECTIONS = """<connections>
<connection from="before" to="beside" fromLane="0" toLane="1"/>
<connection from="before" to="beside" fromLane="1" toLane="2"/>
<connection from="ramp" to="beside" fromLane="0" toLane="0"/>
<connection from="beside" to="after" fromLane="1" toLane="0"/>
<connection from="beside" to="after" fromLane="2" toLane="1"/>
</connections>"""
CARS = {"classes": {"car": 1}}
MERGE = {
    "road": {"edges": ["before", "beside", "after"], "origin": "before", "length": 950},
    "traffic": {
        "warm_up": 40,
        "vehicles": [{"name": "car", "variants": 5, "speed_factor_sd": 0.1}],
        "flows": [
            {"name": "through", "edges": ["before", "beside", "after"], "per_hour": [2600], "lanes": [0, 1]} | CARS,
            {"name": "entering", "edges": ["ramp", "beside", "after"], "per_hour": [700], "lanes": [0]} | CARS,
        ],
    },
    "group": {"rule": "merge", "lane": "beside_0", "zone": [310, 450]},
    "policy": {"kind": "constant_velocity"},
    "history": 1.0,
    "horizon": 6.0,
    "watch": 1.0,
    "episodes": 4,
    "groups_at_once": 1,
    "time_limit": 300,
}
FOLLOWING = MERGE | {"group": {"rule": "car_following"}, "horizon": 2.0}
SCENARIOS = {"merge": MERGE, "following": FOLLOWING}


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    """A folder with the scenario files `merge.yaml` and `following.yaml` and their net."""
    place = tmp_path_factory.mktemp("road")
    for name, text in {"road.nod.xml": NODES, "road.edg.xml": EDGES, "road.con.xml": CONNECTIONS}.items():
        (place / name).write_text(text)
    command = "netconvert -n road.nod.xml -e road.edg.xml -x road.con.xml -o road.net.xml"
    subprocess.run(command.split(), cwd=place, check=True, capture_output=True)
    for name, content in SCENARIOS.items():
        (place / f"{name}.yaml").write_text(yaml.safe_dump({"net": "road.net.xml", **content}))
    return place


@pytest.fixture(scope="session")
def merge_scenario(folder: Path) -> Scenario:
    return load_scenario(str(folder / "merge.yaml"))


@pytest.fixture(scope="session")
def merging(merge_scenario: Scenario) -> Iterator[DrivingEnv]:
    """The vehicle that merges; all tests share its traffic."""
    env = DrivingEnv(merge_scenario)
    yield env
    env.close()


@pytest.fixture(scope="session")
def group(folder: Path) -> Iterator[GroupEnv]:
    """Two followers; all tests share their traffic."""
    env = GroupEnv(str(folder / "following.yaml"), overrides={"episodes": 2})
    yield env
    env.close()
