"""The lanes of a net in the road frame, read from the net file, for pictures; no simulation is needed."""

import gzip
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from cosim.spec.input_files import GZIP, find_net
from cosim.spec.scenario import Scenario
from cosim.world.road_frame import RoadFrame
from cosim.world.road_lanes import LaneLink, RoadLane, frame_along
from gri.errors import InputError

SUMO_LANE_WIDTH = 3.2  # [m], of a lane without the attribute


@dataclass(frozen=True)
class Lane:
    """A lane in the road frame: its centre line (s, d) [m], its width [m], and whether it is outermost on a side."""

    centre: Float[np.ndarray, "P 2"]
    width: float
    rightmost: bool
    leftmost: bool


@dataclass(frozen=True)
class DrawnRoad:
    """The road frame of a scenario and all lanes of its net, ramps included; both without content if not known."""

    frame: RoadFrame | None
    lanes: tuple[Lane, ...]


def drawn_road(scenario: Scenario) -> DrawnRoad:
    """The road of a scenario; an empty one where its net is not on this machine or has not the road's edges."""
    try:
        root = parse_net(find_net(scenario.net))
    except InputError:
        return DrawnRoad(None, ())
    lanes, road = lanes_of(root), scenario.road
    count = Counter(lane.edge for lane in lanes.values())
    if not set(road.edges) <= set(count):
        return DrawnRoad(None, ())
    frame = frame_along(lanes, count.__getitem__, road.edges, road.origin, mirrored=is_left_hand(root))
    drawn = tuple(
        Lane(
            centre=np.stack(frame.to_road(lane.shape), axis=1),
            width=lane.width,
            rightmost=lane.index == 0,
            leftmost=lane.index == count[lane.edge] - 1,
        )
        for lane in lanes.values()
        if lane.id[0] != ":"
    )
    return DrawnRoad(frame, drawn)


def parse_net(path: Path) -> ElementTree.Element:
    """The root element of a net file, which may be compressed."""
    with path.open("rb") as raw, gzip.open(raw) if raw.peek(2)[:2] == GZIP else raw as file:
        return ElementTree.parse(file).getroot()


def is_left_hand(root: ElementTree.Element) -> bool:
    """Whether traffic drives on the left in a net."""
    return root.get("lefthand", "false") in ("true", "1")


def lanes_of(root: ElementTree.Element) -> dict[str, RoadLane]:
    """All lanes of a net, those of junctions among them."""
    links: dict[str, list[tuple[str, str]]] = {}
    for link in root.iter("connection"):
        names = [f"{link.get(end)}_{link.get(f'{end}Lane')}" for end in ("from", "to")]
        links.setdefault(names[0], []).append((names[1], link.get("via", "")))
    lanes = {}
    for edge in root.iter("edge"):
        for lane in edge.findall("lane"):
            name = str(lane.get("id"))
            lanes[name] = RoadLane(
                id=name,
                edge=str(edge.get("id")),
                index=int(str(lane.get("index"))),
                shape=_shape(lane),
                length=float(str(lane.get("length"))),
                width=float(lane.get("width", SUMO_LANE_WIDTH)),
                links=tuple(LaneLink(to, _across(links, to, via)) for to, via in links.get(name, ())),
            )
    return lanes


def _across(links: Mapping[str, Sequence[tuple[str, str]]], to: str, via: str) -> tuple[str, ...]:
    """The lanes of a junction up to the lane `to`, the first of which is `via`."""
    found: list[str] = []
    while via and via not in found:
        found.append(via)
        via = next((second for target, second in links.get(via, ()) if target == to), "")
    return tuple(found)


def _shape(lane: ElementTree.Element) -> Float[np.ndarray, "P 2"]:
    return np.array([[float(x) for x in point.split(",")[:2]] for point in str(lane.get("shape")).split()])
