"""The committed nets against the figures of their sources, and a short run on each."""

import importlib.util
import json
import math
import subprocess
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest
import sumolib
from sumolib.net import Net
from sumolib.net.edge import Edge

NETS = Path(__file__).parents[2] / "sumo_nets"
FOOT = 0.3048


@dataclass(frozen=True)
class Site:
    """What the sources say about a site, in metres unless the name says otherwise."""

    name: str
    study_length: float
    added_edge: str
    added_begin: float
    added_end: float
    lanes: int
    centre_spacing_ft: tuple[float, ...]
    spacing_tolerance_ft: float

    @property
    def mainline(self) -> tuple[str, ...]:
        """The edges of the mainline, in the order of travel."""
        return ("upstream", "entry", self.added_edge, "exit", "downstream_free", "downstream")


US101 = Site("us101", 2100 * FOOT, "weave", 614 * FOOT, 1310 * FOOT, 5, (12.1, 11.0, 10.9, 11.5, 12.6), 0.05)
I80 = Site("i80", 505.0, "merge", 117.8, 202.3, 6, (12.0,) * 6, 0.1)


@pytest.fixture(params=(US101, I80), ids=lambda site: site.name)
def site(request: pytest.FixtureRequest) -> Site:
    """Each site in turn."""
    return request.param


@pytest.fixture
def net(site: Site) -> Net:
    """The committed net."""
    return sumolib.net.readNet(str(net_file(site)))


def net_file(site: Site) -> Path:
    """Where the committed net is."""
    return NETS / site.name / f"{site.name}.net.xml"


def span(edge: Edge) -> tuple[float, float]:
    """The x range that all lanes of an edge share."""
    spans = {(lane.getShape()[0][0], lane.getShape()[-1][0]) for lane in edge.getLanes()}
    assert len(spans) == 1, f"the lanes of {edge.getID()} begin or end at different x: {spans}"
    return spans.pop()


def load_build() -> ModuleType:
    """The build script as a module."""
    spec = importlib.util.spec_from_file_location("build_nets", NETS / "build.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_rebuilding_gives_the_committed_net(site: Site) -> None:
    build = load_build()
    if build.find_netconvert() is None:
        pytest.skip("netconvert is not installed (pip install eclipse-sumo)")
    assert build.build(site.name) == net_file(site).read_text(encoding="utf-8")


def test_the_bend_is_built_of_its_sources_and_has_its_radius() -> None:
    build = load_build()
    if build.find_netconvert() is None:
        pytest.skip("netconvert is not installed (pip install eclipse-sumo)")
    path = NETS / "curved" / "curved.net.xml"
    assert build.build("curved") == path.read_text(encoding="utf-8")
    lanes = sumolib.net.readNet(str(path)).getEdge("merge").getLanes()
    for k, lane in enumerate(reversed(lanes)):
        radius = [math.hypot(x - 150, y - 600) for x, y in lane.getShape()]
        assert radius == pytest.approx([600 + 3.5 * (k + 0.5)] * len(radius), abs=0.03)


def test_the_plain_freeway_is_built_of_its_sources_and_straight() -> None:
    build = load_build()
    if build.find_netconvert() is None:
        pytest.skip("netconvert is not installed (pip install eclipse-sumo)")
    path = NETS / "highway" / "highway.net.xml"
    assert build.build("highway") == path.read_text(encoding="utf-8")
    net = sumolib.net.readNet(str(path))
    road = [net.getEdge(name) for name in ("upstream", "entry", "merge", "exit", "downstream")]
    assert [span(edge) for edge in road] == [(-500, 0), (0, 300), (300, 600), (600, 1200), (1200, 1700)]
    assert [edge.getLaneNumber() for edge in road] == [3, 3, 4, 3, 3]
    for edge in road:
        assert [lane.getShape()[0][1] for lane in reversed(edge.getLanes())][:3] == [-1.8, -5.4, -9.0]
        assert all(lane.getShape()[0][1] == lane.getShape()[-1][1] for lane in edge.getLanes())
    assert {lane.getID() for lane in net.getLane("merge_0").getIncoming()} == {"on_ramp_0"}
    assert not net.getLane("merge_0").getOutgoing(), "vehicles must leave the acceleration lane"


def test_a_missing_netconvert_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    build = load_build()
    monkeypatch.setattr(build, "find_netconvert", lambda: None)
    monkeypatch.setattr(sys, "argv", ["build.py", "us101"])
    assert build.main() == "error: netconvert not found in a wheel or on PATH; pip install eclipse-sumo"


def test_study_area_begins_at_zero_and_has_its_published_length(site: Site, net: Net) -> None:
    assert span(net.getEdge("entry"))[0] == 0
    assert span(net.getEdge("exit"))[1] == pytest.approx(site.study_length, abs=0.5)


def test_added_lane_is_where_the_sources_say(site: Site, net: Net) -> None:
    assert span(net.getEdge(site.added_edge)) == pytest.approx((site.added_begin, site.added_end), abs=0.5)
    added = net.getLane(f"{site.added_edge}_0")
    assert added.getLength() == pytest.approx(site.added_end - site.added_begin, abs=0.5)


def test_extensions_are_long_enough(site: Site, net: Net) -> None:
    names = ("upstream", "downstream_free", "downstream", "on_ramp")
    lengths = [net.getEdge(name).getLength() for name in names]
    assert lengths == [500.0 if site is US101 else 400.0, 60.0, 450.0, pytest.approx(271.5, abs=0.5)]


def test_mainline_has_no_gaps_and_lane_positions_are_metres_of_x(site: Site, net: Net) -> None:
    spans = [span(net.getEdge(name)) for name in site.mainline]
    assert all(before[1] == after[0] for before, after in pairwise(spans))
    for name, (begin, end) in zip(site.mainline, spans, strict=True):
        lengths = [lane.getLength() for lane in net.getEdge(name).getLanes()]
        assert lengths == pytest.approx([end - begin] * len(lengths), abs=0.005)


def test_ramps_are_as_long_as_they_look(net: Net) -> None:
    for edge in net.getEdges():
        if edge.getID().endswith("_ramp"):
            (lane,) = edge.getLanes()
            assert lane.getLength() == pytest.approx(sumolib.geomhelper.polyLength(lane.getShape()), abs=0.01)


def test_ramps_run_beside_the_road_at_the_gore(site: Site, net: Net) -> None:
    added_y = net.getLane(f"{site.added_edge}_0").getShape()[0][1]
    for edge in net.getEdges():
        shape = edge.getLanes()[0].getShape()
        if edge.getID().endswith("_ramp"):
            flat = shape[-2:] if edge.getID() == "on_ramp" else shape[:2]
            assert [y for _, y in flat] == [added_y, added_y]
            assert abs(flat[1][0] - flat[0][0]) >= 60


def test_number_of_lanes(site: Site, net: Net) -> None:
    added = {name: int(name == site.added_edge) for name in site.mainline}
    assert {name: net.getEdge(name).getLaneNumber() for name in site.mainline} == {
        name: site.lanes + extra for name, extra in added.items()
    }


def test_lane_centres_keep_their_measured_distances(site: Site, net: Net) -> None:
    centres = [lane.getShape()[0][1] for lane in reversed(net.getEdge(site.added_edge).getLanes())]
    spacing = [(left - right) / FOOT for left, right in pairwise(centres)]
    assert spacing == pytest.approx(site.centre_spacing_ft, abs=site.spacing_tolerance_ft)


def test_lane_widths_fill_the_road(site: Site, net: Net) -> None:
    for name in site.mainline:
        lanes = net.getEdge(name).getLanes()
        for right, left in pairwise(lanes):
            distance = left.getShape()[0][1] - right.getShape()[0][1]
            assert distance == pytest.approx((left.getWidth() + right.getWidth()) / 2, abs=0.011)


def test_lanes_keep_their_y_along_the_road(site: Site, net: Net) -> None:
    shared = [net.getEdge(name).getLanes()[-site.lanes :] for name in site.mainline]
    centres = {tuple(lane.getShape()[0][1] for lane in lanes) for lanes in shared}
    assert len(centres) == 1


def test_first_lane_of_us101_is_at_its_local_x() -> None:
    net = sumolib.net.readNet(str(net_file(US101)))
    assert -net.getLane("entry_4").getShape()[0][1] == pytest.approx(5.9 * FOOT, abs=0.01)


def test_hov_lane_is_for_hov_alone(site: Site, net: Net) -> None:
    for name in site.mainline:
        *others, leftmost = net.getEdge(name).getLanes()
        assert all(lane.allows(kind) for lane in others for kind in ("passenger", "truck", "hov"))
        assert leftmost.allows("hov")
        assert leftmost.allows("passenger") == (site is US101)


def test_speed_limits(net: Net) -> None:
    limits = {edge.getID(): edge.getSpeed() for edge in net.getEdges()}
    assert {limit for name, limit in limits.items() if not name.endswith("_ramp")} == {29.0}
    assert {limit for name, limit in limits.items() if name.endswith("_ramp")} == {20.0}


def next_lanes(net: Net, lane: str) -> set[str]:
    """The lanes that a lane leads to."""
    return {connection.getToLane().getID() for connection in net.getLane(lane).getOutgoing()}


def test_every_upstream_lane_leads_straight_to_the_same_lane_downstream(site: Site, net: Net) -> None:
    for index in range(site.lanes):
        lane = f"upstream_{index}"
        for name in site.mainline[1:]:
            lanes = next_lanes(net, lane)
            assert lanes == {f"{name}_{index + (name == site.added_edge)}"}
            lane = lanes.pop()
        assert lane == f"downstream_{index}"


def test_the_added_lane_belongs_to_the_ramps(site: Site, net: Net) -> None:
    added = f"{site.added_edge}_0"
    assert next_lanes(net, "on_ramp_0") == {added}
    assert next_lanes(net, added) == ({"off_ramp_0"} if site is US101 else set())
    assert {lane.getID() for lane in net.getLane(added).getIncoming()} == {"on_ramp_0"}


DRIVE = """
import json, sys
import libsumo

libsumo.start(sys.argv[1:])
report = {"departed": [], "arrived": [], "teleports": 0, "collisions": 0, "lanes": [], "jump": 0.0}
x = {}
while libsumo.simulation.getMinExpectedNumber() and libsumo.simulation.getTime() < 240:
    libsumo.simulationStep()
    report["departed"] += libsumo.simulation.getDepartedIDList()
    report["arrived"] += libsumo.simulation.getArrivedIDList()
    report["teleports"] += libsumo.simulation.getStartingTeleportNumber()
    report["collisions"] += len(libsumo.simulation.getCollisions())
    for vehicle in libsumo.vehicle.getIDList():
        lane, now = libsumo.vehicle.getLaneID(vehicle), libsumo.vehicle.getPosition(vehicle)[0]
        report["lanes"] += [(vehicle.partition(".")[0], lane)]
        if vehicle in x and "ramp" not in lane:
            expected = x[vehicle] + 0.2 * libsumo.vehicle.getSpeed(vehicle)
            report["jump"] = max(report["jump"], abs(now - expected))
        x[vehicle] = now
    report["lanes"] = sorted(set(map(tuple, report["lanes"])))
libsumo.close()
print(json.dumps(report))
"""


def routes(site: Site) -> str:
    """Two minutes of light traffic with ramp vehicles, as SUMO's XML."""
    flows = {"through": (" ".join(site.mainline), "passenger", 3000)}
    flows["merging"] = (" ".join(("on_ramp", *site.mainline[2:])), "passenger", 600)
    if site is US101:
        flows["leaving"] = (" ".join((*site.mainline[:3], "off_ramp")), "passenger", 300)
    else:
        flows["carpool"] = (" ".join(site.mainline), "hov", 600)
    return "\n".join(
        f'<vType id="{name}" vClass="{v_class}"/><route id="{name}" edges="{edges}"/>'
        f'<flow id="{name}" type="{name}" route="{name}" begin="0" end="120" vehsPerHour="{per_hour}"'
        f' departLane="best" departSpeed="max"/>'
        for name, (edges, v_class, per_hour) in flows.items()
    )


def test_traffic_runs_and_every_ramp_vehicle_merges(site: Site, tmp_path: Path) -> None:
    pytest.importorskip("libsumo")
    route_file = tmp_path / "light.rou.xml"
    route_file.write_text(f"<routes>{routes(site)}</routes>", encoding="utf-8")
    files = f"--net-file={net_file(site)} --route-files={route_file} --xml-validation=never --no-step-log"
    checks = "--collision.action=warn --collision.mingap-factor=0 --time-to-teleport=-1"
    command = ["sumo", *files.split(), *checks.split(), "--step-length=0.2", "--seed=1"]
    run = subprocess.run([sys.executable, "-c", DRIVE, *command], capture_output=True, text=True, check=True)
    report = json.loads(run.stdout)
    assert (report["teleports"], report["collisions"]) == (0, 0)
    assert sorted(report["departed"]) == sorted(report["arrived"])
    assert sum(vehicle.startswith("merging") for vehicle in report["arrived"]) == 20
    assert report["jump"] < 1e-3
    on_hov_lane = {kind for kind, lane in report["lanes"] if lane == "entry_5"}
    assert on_hov_lane == (set() if site is US101 else {"carpool"})
