"""The lanes of a net in the road frame, read from the net file, for pictures; no simulation is needed."""

import math
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from cosim.spec.input_files import find_net
from cosim.spec.scenario import Road, Scenario
from cosim.world.road_frame import RoadFrame, without_straight_vertices
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
        root = ElementTree.parse(find_net(scenario.net)).getroot()
    except InputError:
        return DrawnRoad(None, ())
    edges = {str(edge.get("id")): edge.findall("lane") for edge in root.iter("edge") if edge.get("function") is None}
    if not set(scenario.road.edges) <= set(edges):
        return DrawnRoad(None, ())
    frame = _frame(scenario.road, {name: _shape(lanes[-1]) for name, lanes in edges.items()})
    lanes = tuple(
        Lane(
            centre=np.stack(frame.to_road(_shape(lane)), axis=1),
            width=float(lane.get("width", SUMO_LANE_WIDTH)),
            rightmost=index == 0,
            leftmost=index == len(of_edge) - 1,
        )
        for of_edge in edges.values()
        for index, lane in enumerate(of_edge)
    )
    return DrawnRoad(frame, lanes)


def _shape(lane: ElementTree.Element) -> Float[np.ndarray, "P 2"]:
    return np.array([[float(x) for x in point.split(",")[:2]] for point in str(lane.get("shape")).split()])


def _frame(road: Road, leftmost: dict[str, Float[np.ndarray, "P 2"]]) -> RoadFrame:
    """The frame along the centres of the leftmost lanes, as `cosim.sumo.net` makes it in the simulation."""
    points: list[tuple[float, float]] = []
    start = 0
    for edge in road.edges:
        shape = [(float(x), float(y)) for x, y in leftmost[edge]]
        meets = bool(points) and math.dist(points[-1], shape[0]) < 0.1
        if edge == road.origin:
            start = len(points) - 1 if meets else len(points)
        points += shape[1:] if meets else shape
    line = np.array(points)
    before = np.diff(line[: start + 1], axis=0)
    return RoadFrame(without_straight_vertices(line), float(np.hypot(before[:, 0], before[:, 1]).sum()))
