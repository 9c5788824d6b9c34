"""Nets and demands from small maps written by hand."""

import gzip
import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from cosim.proposals.main_road import main_road
from cosim.proposals.map_file import PER_LANE, PER_RAMP, convert, map_suffix
from cosim.proposals.net_file import read_net_lanes
from gri.errors import InputError

NODES = {1: (0, 0), 2: (500, 0), 3: (1000, 0), 4: (1500, 0), 5: (250, -90), 6: (420, -18)}  # [m]
FREEWAY = {"highway": "motorway", "oneway": "yes", "lanes": "2", "maxspeed": "100"}
WAYS = {
    10: ([1, 2], FREEWAY),
    11: ([2, 3, 4], FREEWAY),
    12: ([5, 6, 2], {"highway": "motorway_link", "oneway": "yes", "lanes": "1", "maxspeed": "80"}),
    13: ([5, 1], {"highway": "residential"}),
}


def osm(kept: tuple[int, ...] = tuple(WAYS)) -> str:
    """A freeway that a ramp joins, and a street, on OpenStreetMap."""
    north = 1 / 111_320  # degrees per metre
    east = north / math.cos(math.radians(48))
    nodes = [
        f'<node id="{k}" lat="{48 + y * north:.7f}" lon="{11 + x * east:.7f}" version="1"/>'
        for k, (x, y) in NODES.items()
    ]
    ways = [
        f'<way id="{k}" version="1">'
        + "".join(f'<nd ref="{node}"/>' for node in WAYS[k][0])
        + "".join(f'<tag k="{key}" v="{value}"/>' for key, value in WAYS[k][1].items())
        + "</way>"
        for k in kept
    ]
    return f'<osm version="0.6">{"".join((*nodes, *ways))}</osm>'


XODR = """<OpenDRIVE><header revMajor="1" revMinor="4"/>
<road name="a" length="900" id="1" junction="-1"><link/><planView>
<geometry s="0" x="0" y="0" hdg="0" length="500"><line/></geometry>
<geometry s="500" x="500" y="0" hdg="0" length="400"><arc curvature="0.001"/></geometry></planView>
<lanes><laneSection s="0"><center><lane id="0" type="none" level="false"/></center><right>
<lane id="-1" type="driving" level="false"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
<lane id="-2" type="driving" level="false"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
</right></laneSection></lanes></road></OpenDRIVE>"""


def flows(routes: Path) -> dict[tuple[str, str], float]:
    """Vehicles per hour by the first and the last edge."""
    root = ElementTree.parse(routes).getroot()
    return {
        (flow.get("from", ""), flow.get("to", "")): float(flow.get("vehsPerHour", "nan")) for flow in root.iter("flow")
    }


def test_a_freeway_of_openstreetmap_gets_an_acceleration_lane_and_a_demand(tmp_path: Path) -> None:
    (tmp_path / "town.osm.xml").write_text(osm())
    configuration = convert(tmp_path / "town.osm.xml")
    assert configuration == tmp_path / "town.sumocfg"
    net = read_net_lanes(tmp_path / "town.net.xml")
    assert not any(edge.lstrip("-").startswith("13") for edge in net.of_edge), "streets are left out"
    demand = flows(tmp_path / "town.rou.xml")
    assert demand == {("10", "11"): 2 * PER_LANE, ("12", "11"): PER_RAMP}
    road = main_road(net, {("10", "11-AddedOnRampEdge", "11"): 100})
    (lane,) = road.ending
    assert (lane.lane, lane.side, lane.entries) == ("11-AddedOnRampEdge_0", "right", ("12",))
    assert lane.end - lane.begin == pytest.approx(250, abs=10), "without the node"


def test_files_that_are_there_are_kept(tmp_path: Path) -> None:
    (tmp_path / "town.osm").write_text(osm())
    convert(tmp_path / "town.osm")
    (tmp_path / "town.rou.xml").write_text("measured")
    net = (tmp_path / "town.net.xml").read_bytes()
    convert(tmp_path / "town.osm")
    assert (tmp_path / "town.rou.xml").read_text() == "measured"
    assert (tmp_path / "town.net.xml").read_bytes() == net


def test_opendrive_and_compressed_maps(tmp_path: Path) -> None:
    (tmp_path / "a.xodr").write_text(XODR)
    convert(tmp_path / "a.xodr")
    (edge,) = read_net_lanes(tmp_path / "a.net.xml").of_edge
    assert flows(tmp_path / "a.rou.xml") == {(edge, edge): 2 * PER_LANE}
    (tmp_path / "b.osm.xml.gz").write_bytes(gzip.compress(osm().encode()))
    assert convert(tmp_path / "b.osm.xml.gz") == tmp_path / "b.sumocfg"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("street.osm", osm((13,)), "without a motorway or trunk road"),
        ("broken.osm.xml", osm()[:300], "not well-formed"),
        ("broken.xodr", "<OpenDRIVE>", "not well-formed"),
        ("none.osm", None, "no such file"),
    ],
)
def test_what_is_no_map_is_one_clear_error(tmp_path: Path, name: str, content: str | None, message: str) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message):
        convert(tmp_path / name)
    assert not [path for path in tmp_path.iterdir() if path.name != name], "nothing unfinished stays"


def test_without_netconvert_the_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "town.osm").write_text(osm())
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match=r"pip install 'gri-cosim\[sumo\]'"):
        convert(tmp_path / "town.osm")


def test_a_configuration_is_no_map() -> None:
    assert map_suffix(Path("mine.sumocfg")) is None
    assert map_suffix(Path("MINE.OSM.XML")) == ".osm.xml"


def test_a_map_that_nests_without_end_is_refused_before_netconvert_reads_it(tmp_path):
    """netconvert takes minutes for it."""
    path = tmp_path / "deep.osm.xml"
    path.write_text("<a>" * 100_000 + "</a>" * 100_000)
    with pytest.raises(InputError, match="nests deeper than 100 elements; export the map again"):
        convert(path)


@pytest.mark.parametrize(("name", "text", "wanted"), [("m.xodr", osm(), "<OpenDRIVE>"), ("m.osm", XODR, "<osm>")])
def test_a_map_of_the_other_kind_is_refused_by_name(tmp_path, name, text, wanted):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=wanted):
        convert(path)
