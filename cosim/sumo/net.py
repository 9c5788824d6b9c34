"""The road network as SUMO reads it: edges, lanes and their positions."""

import math
from collections.abc import Sequence

import libsumo
import numpy as np
from jaxtyping import Float

from cosim.world.road_frame import RoadFrame, without_straight_vertices
from cosim.world.snapshot import LaneStrip


class Net:
    """The network of the running simulation."""

    def shape(self, lane: str) -> Float[np.ndarray, "P 2"]:
        """World points of the centre of a lane."""
        return np.array(libsumo.lane.getShape(lane), dtype=float)

    def length(self, lane: str) -> float:
        """Length [m] of a lane for positions along it, which may differ from the length of its shape."""
        return libsumo.lane.getLength(lane)

    def lanes_of(self, edges: Sequence[str]) -> list[str]:
        """Lanes of these edges, lanes that lead into them, and lanes of junctions in between where the net has any."""
        lanes = libsumo.lane.getIDList()
        wanted = {lane for lane in lanes if lane.rpartition("_")[0] in edges}
        leading = {lane: [link for link in libsumo.lane.getLinks(lane) if link[0] in wanted] for lane in lanes}
        between = {link[4] for links in leading.values() for link in links if link[4]}
        return sorted(wanted | between | {lane for lane, links in leading.items() if links and lane[0] != ":"})

    def lane_count(self, edge: str) -> int:
        """Number of lanes of an edge."""
        return int(libsumo.edge.getLaneNumber(edge))

    def limits(self, lanes: Sequence[str]) -> list[float]:
        """Current speed limit [m/s] of each lane."""
        return [libsumo.lane.getMaxSpeed(lane) for lane in lanes]

    def edges(self) -> frozenset[str]:
        """Ids of all edges and lanes of the net."""
        return frozenset(libsumo.edge.getIDList()) | frozenset(libsumo.lane.getIDList())

    def leads_to(self, edge: str, other: str) -> bool:
        """Whether a lane of the first edge leads to the other edge."""
        lanes = (f"{edge}_{index}" for index in range(self.lane_count(edge)))
        return any(link[0].rpartition("_")[0] == other for lane in lanes for link in libsumo.lane.getLinks(lane))

    def road(self, edges: Sequence[str], origin: str) -> RoadFrame:
        """The road frame of a chain of edges: along the centre of its leftmost lane, s = 0 where `origin` begins."""
        points: list[tuple[float, float]] = []
        start = 0
        for edge in edges:
            shape = libsumo.lane.getShape(f"{edge}_{libsumo.edge.getLaneNumber(edge) - 1}")
            if edge == origin:
                start = max(len(points) - 1, 0) if points and _meet(points[-1], shape[0]) else len(points)
            points += [point for k, point in enumerate(shape) if k or not points or not _meet(points[-1], point)]
        line = np.array(points, dtype=float)
        before = np.diff(line[: start + 1], axis=0)
        return RoadFrame(without_straight_vertices(line), float(np.hypot(before[:, 0], before[:, 1]).sum()))

    def strip(self, lane: str, road: RoadFrame) -> LaneStrip:
        """The position of a lane in the road frame; the lane must run along the road."""
        s, d = road.to_road(self.shape(lane))
        return LaneStrip(lane, float(s[0]), float(s[-1]), float(d[-1]), libsumo.lane.getWidth(lane))


def _meet(end: tuple[float, float], begin: tuple[float, float]) -> bool:
    """Whether the lanes of two edges join here; net files round to centimetres, and in a bend the lanes may overlap."""
    return math.dist(end, begin) < 0.1
