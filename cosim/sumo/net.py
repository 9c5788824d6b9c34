"""The road network as SUMO reads it: edges, lanes and their positions."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import libsumo
import numpy as np
from jaxtyping import Float

from cosim.world.road_frame import RoadFrame
from cosim.world.road_lanes import LaneLink, RoadLane, entering_lanes, frame_along
from cosim.world.road_world import LEVEL, Heights, lane_places
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

    def gap_after(self, edge: str, other: str) -> float:
        """The longest way [m] from a lane of the edge to one of the other, where the net has no lane between them."""
        lanes = [f"{edge}_{index}" for index in range(self.lane_count(edge))]
        found = [
            float(np.linalg.norm(self.shape(link[0])[0] - self.shape(lane)[-1]))
            for lane in lanes
            for link in libsumo.lane.getLinks(lane)
            if link[0].rpartition("_")[0] == other and not link[4]
        ]
        return max(found, default=0.0)

    def road(self, edges: Sequence[str], origin: str) -> RoadFrame:
        """The road frame of a chain of edges, s = 0 where `origin` begins, with the lanes of the road's world."""
        lanes, edges = self.lanes, [*edges]
        frame = frame_along(lanes, self.lane_count, edges, origin, mirrored=self.left_hand)
        places = lane_places(lanes, self.entering, self.lane_count, edges, frame, self._heights)
        everywhere = (
            frame.is_straight and len(places) == len(lanes) and all(place.is_whole for place in places.values())
        )
        return frame if everywhere else replace(frame, places=places)

    @cached_property
    def entering(self) -> dict[str, list[str]]:
        """The lanes that lead to each lane, those of junctions among them."""
        return entering_lanes(self.lanes)

    @cached_property
    def lanes(self) -> dict[str, RoadLane]:
        """All lanes, those of junctions among them."""
        return {lane: self._lane(lane) for lane in libsumo.lane.getIDList()}

    def _lane(self, lane: str) -> RoadLane:
        edge, _, index = lane.rpartition("_")
        links = tuple(LaneLink(link[0], _across(link[0], link[4])) for link in libsumo.lane.getLinks(lane))
        width = libsumo.lane.getWidth(lane)
        return RoadLane(lane, edge, int(index), self.shape(lane), self.length(lane), width, links)

    @property
    def side(self) -> int:
        """−1 where traffic drives on the left, else 1."""
        return -1 if self.left_hand else 1

    @cached_property
    def left_hand(self) -> bool:
        """Whether traffic drives on the left: then lane 1 of an edge is to the right of lane 0."""
        return any(map(self._is_mirrored, (edge for edge in libsumo.edge.getIDList() if edge[0] != ":")))

    def _is_mirrored(self, edge: str) -> bool:
        if self.lane_count(edge) < 2:
            return False
        (outer, inner), ahead = (self.shape(f"{edge}_{k}") for k in (0, 1)), self.shape(f"{edge}_0")
        along, aside = ahead[1] - ahead[0], inner[0] - outer[0]
        return bool(along[0] * aside[1] - along[1] * aside[0] < 0)

    @property
    def _heights(self) -> Heights | None:
        """The height of a lane at a position; None in a flat net."""
        convert = libsumo.simulation.convert3D

        def height(lane: str, position: float) -> float:
            edge, _, index = lane.rpartition("_")
            return float(convert(edge, position, int(index))[2])

        found = (height(lane, 0.0) for lane in libsumo.lane.getIDList() if lane[0] != ":")
        first = next(found, 0.0)
        return height if any(abs(other - first) > LEVEL for other in found) else None

    def strip(self, lane: str, road: RoadFrame) -> LaneStrip:
        """The position of a lane in the road frame; the lane must run along the road."""
        shape, place = self.shape(lane), (road.places or {}).get(lane)
        s, d = road.to_road(shape, place and (np.full(len(shape), place.low), np.full(len(shape), place.high)))
        return LaneStrip(lane, float(s[0]), float(s[-1]), float(d[-1]), libsumo.lane.getWidth(lane))


def _across(to: str, via: str) -> tuple[str, ...]:
    """The lanes of a junction from a lane to the lane `to`, the first of which is `via`."""
    lanes: list[str] = []
    while via and via not in lanes:
        lanes.append(via)
        via = next((link[4] for link in libsumo.lane.getLinks(via) if link[0] == to), "")
    return tuple(lanes)
