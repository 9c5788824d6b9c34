"""From a map to files of SUMO: a net by netconvert, a demand from every entry to every exit, and a configuration.

OpenStreetMap (.osm, .osm.xml, also .gz) and OpenDRIVE (.xodr) are read. Of OpenStreetMap only motorways, trunk roads
and their ramps are kept. Nobody knows the demand of a map, so usual flows are written, to be replaced by measured ones.
"""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

from cosim.proposals.net_file import NetLanes, read_net_lanes
from cosim.spec.input_files import xml_root
from gri.errors import InputError

PER_LANE, PER_RAMP = 1200.0, 500.0  # [veh/h] that enter on each lane of a road, and on a ramp of one lane
LIMIT = 1800.0  # [s] for netconvert; a large city takes minutes
DEMAND = 7200  # [s] for which vehicles enter
ROADS = ",".join(f"highway.{kind}{link}" for kind in ("motorway", "trunk") for link in ("", "_link"))
OPTIONS = ("--geometry.remove", "--no-turnarounds", "--junctions.join", "--xml-validation", "never")
OF_OSM = ("--ramps.guess", "--ramps.ramp-length", "250", "--keep-edges.by-type", ROADS, "--tls.discard-loaded")
MAPS = {".osm": "--osm-files", ".osm.xml": "--osm-files", ".osm.gz": "--osm-files", ".osm.xml.gz": "--osm-files"} | {
    ".xodr": "--opendrive-files"
}


def map_suffix(path: Path) -> str | None:
    """The ending by which a file is a map, None if it is none."""
    return next((end for end in sorted(MAPS, key=len, reverse=True) if path.name.lower().endswith(end)), None)


def convert(path: Path) -> Path:
    """Write net, routes and configuration of a map beside it; returns the configuration (.sumocfg).

    Files that are there already are kept, so that they can be edited. Raises `InputError` if there is no netconvert,
    or the map cannot be read or has no road.
    """
    suffix = map_suffix(path)
    assert suffix is not None, "callers ask for the suffix before"
    if not path.is_file():
        raise InputError(f"{path}: no such file (looked in {Path.cwd()}); give a map")
    stem = path.name[: -len(suffix)]
    net, routes, configuration = (path.with_name(stem + end) for end in (".net.xml", ".rou.xml", ".sumocfg"))
    if not net.exists():
        _net(path, suffix, net)
    if not routes.exists():
        flows = [*_flows(read_net_lanes(net))]
        if not flows:
            raise InputError(f"{net}: no way leads from an edge without predecessors to one without successors")
        routes.write_text(_routes(flows), encoding="utf-8")
    if not configuration.exists():
        files = f"<net-file value={quoteattr(net.name)}/>\n  <route-files value={quoteattr(routes.name)}/>"
        configuration.write_text(
            f'<configuration>\n  {files}\n  <begin value="0"/>\n  <end value="{DEMAND}"/>\n</configuration>\n',
            encoding="utf-8",
        )
    return configuration


def _net(path: Path, suffix: str, net: Path) -> None:
    program = shutil.which("netconvert")
    if program is None:
        raise InputError(f"{path}: a map needs netconvert, which is not installed; pip install 'gri-cosim[sumo]'")
    special, wanted = (OF_OSM, "motorway or trunk road") if suffix != ".xodr" else ((), "road")
    root = "OpenDRIVE" if suffix == ".xodr" else "osm"
    if (found := xml_root(path, "export the map again")) != root:
        raise InputError(f"{path}: got a <{found}> file, expected <{root}>; give a map, or rename the file")
    part = net.with_name(f".{net.name}.part.net.xml")
    command = [program, MAPS[suffix], str(path), *OPTIONS, *special, "-o", str(part)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=LIMIT)
        errors = [line.removeprefix("Error: ") for line in done.stderr.splitlines() if line.startswith("Error")]
        if "No edges loaded." in errors:
            raise InputError(f"{path}: got a map without a {wanted}; give one that has some")
        if done.returncode or not part.exists():
            said = (errors or done.stderr.split("\n") or ["no reason given"])[0][:200]
            raise InputError(f"{path}: netconvert cannot read it: {said}; correct the map")
        part.replace(net)
    except subprocess.TimeoutExpired:
        raise InputError(
            f"{path}: netconvert did not end within {LIMIT:g} s; cut the map to the road that you need"
        ) from None
    finally:
        part.unlink(missing_ok=True)


Flow = tuple[str, str, float]  # from edge, to edge, vehicles per hour


def _flows(net: NetLanes) -> Iterator[Flow]:
    """From every edge that none leads to: its vehicles, shared among the ends it leads to by their numbers of lanes."""
    onward = {
        edge: {net.lanes[to].edge for lane in lanes for to in net.lanes[lane].leads_to}
        for edge, lanes in net.of_edge.items()
    }
    led_to = set().union(*onward.values()) if onward else set()
    drivable = {edge for edge, lanes in net.of_edge.items() if any(net.lanes[lane].for_cars for lane in lanes)}
    for entry in sorted(drivable - led_to):
        reached, left = {entry}, [entry]
        while left:
            new = onward[left.pop()] & drivable - reached
            reached |= new
            left += new
        exits = sorted(edge for edge in reached if not onward[edge] and edge != entry) or [entry]
        lanes = {edge: len(net.of_edge[edge]) for edge in (entry, *exits)}
        rate = PER_LANE * lanes[entry] if lanes[entry] > 1 else PER_RAMP
        for exit_ in exits:
            yield entry, exit_, rate * lanes[exit_] / sum(lanes[edge] for edge in exits)


def _routes(flows: list[Flow]) -> str:
    lines = [
        f'  <flow id="flow{k}" type="car" from={quoteattr(begin)} to={quoteattr(end)} begin="0" end="{DEMAND}"'
        f' vehsPerHour="{rate:.0f}" departLane="free" departSpeed="max"/>'
        for k, (begin, end, rate) in enumerate(flows)
    ]
    note = f"Usual flows, {PER_LANE:g} veh/h per lane and {PER_RAMP:g} on ramps; replace them by measured ones."
    return "\n".join([f"<!-- {note} -->", "<routes>", '  <vType id="car"/>', *lines, "</routes>", ""])
