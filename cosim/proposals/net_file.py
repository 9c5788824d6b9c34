"""The lanes of a net file and how they are joined, read without starting SUMO."""

import gzip
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.sax import SAXException

import sumolib

from gri.errors import InputError


@dataclass(frozen=True)
class NetLane:
    """A lane: its edge, its index from the right, its length [m], and the lanes it leads to."""

    id: str
    edge: str
    index: int
    length: float
    limit: float
    """Speed limit [m/s]."""
    shape: tuple[tuple[float, float], ...]
    """World points of its centre [m]."""
    leads_to: tuple[str, ...]
    has_light: bool
    """Whether a traffic light controls where it leads to."""
    for_cars: bool


@dataclass(frozen=True)
class NetLanes:
    """All lanes of a net by id, and the lanes of each edge from the right to the left."""

    lanes: Mapping[str, NetLane]
    of_edge: Mapping[str, tuple[str, ...]]
    left_hand: bool

    def leads_from(self, edge: str, onto: str) -> bool:
        """Whether a lane of the one edge leads to a lane of the other."""
        return any(self.lanes[to].edge == onto for lane in self.of_edge[edge] for to in self.lanes[lane].leads_to)


def read_net_lanes(path: Path) -> NetLanes:
    """The lanes of a net file (.net.xml or .net.xml.gz). Raises `InputError` if it is none."""
    try:
        net = sumolib.net.readNet(str(path))
    except (SAXException, OSError, EOFError, LookupError, ValueError, AttributeError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as a SUMO net ({error}); build it with netconvert") from None
    lanes = {}
    for edge in net.getEdges(withInternal=False):
        for lane in edge.getLanes():
            outgoing = lane.getOutgoing()
            lanes[lane.getID()] = NetLane(
                id=lane.getID(),
                edge=edge.getID(),
                index=lane.getIndex(),
                length=float(lane.getLength()),
                limit=float(lane.getSpeed()),
                shape=tuple((float(x), float(y)) for x, y in lane.getShape()),
                leads_to=tuple(link.getToLane().getID() for link in outgoing),
                has_light=any(link.getTLSID() for link in outgoing),
                for_cars=lane.allows("passenger"),
            )
    of_edge: dict[str, list[str]] = {}
    for lane in sorted(lanes.values(), key=lambda lane: (lane.edge, lane.index)):
        of_edge.setdefault(lane.edge, []).append(lane.id)
    return NetLanes(lanes, {edge: tuple(of) for edge, of in of_edge.items()}, _is_left_hand(path))


def _is_left_hand(path: Path) -> bool:
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        _, root = next(ElementTree.iterparse(file, events=("start",)))
        return root.get("lefthand", "false") in ("true", "1")
