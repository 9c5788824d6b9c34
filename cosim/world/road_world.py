"""Which lanes are in the world of a road: those of the road itself, and what leads to them or away from them.

A bridge or a road beside it is in another world, even where its lanes pass within a metre in the plane. Links decide,
and the height where a net has heights: a ramp that crosses the road far from where it joins is on another level there.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from cosim.world.polyline import length_of
from cosim.world.road_frame import LanePlace, RoadFrame
from cosim.world.road_lanes import LaneCount, Lanes

REACH = 500.0  # [m] of driving from the road, beyond which lanes are in another world
MARGIN = 20.0  # [m] of s around the place of a lane
SAMPLING = 1.0  # [m] between two points of a ramp that are looked at
LEVEL = 2.0  # [m] of height between two levels
NEAR_JOINT = 60.0  # [m] of driving from the road, within which a ramp may lie on its lanes
BESIDE = 60.0  # [m] across the road, beyond which no lane of it is looked for

Heights = Callable[[str, float], float]
"""The height [m] of a lane at a position [m] along it."""


def lane_places(
    lanes: Lanes,
    entering: Mapping[str, Sequence[str]],
    count: LaneCount,
    edges: Sequence[str],
    road: RoadFrame,
    heights: Heights | None,
) -> dict[str, LanePlace]:
    """The place of every lane in the world of the road; `entering` are the lanes that lead to a lane.

    `heights` is None where the net is flat.
    """
    of_road = [f"{edge}_{index}" for edge in edges for index in range(count(edge))]
    own = _road_places(lanes, count, edges, road)
    places = dict(own)
    joints = {via for lane in of_road for link in lanes[lane].links if link.to in places for via in link.via}
    junctions = {via.rpartition("_")[0].rpartition("_")[0] for via in joints}
    reached = dict.fromkeys(of_road, 0.0)
    for ahead in (False, True):
        waiting = [(lane, 0.0) for lane in of_road]
        while waiting:
            lane, driven = waiting.pop(0)
            for beside in _next(lanes, entering, lane, ahead=ahead):
                if beside in reached and reached[beside] <= driven:
                    continue
                reached[beside] = driven
                crossing = _crossing(lanes, beside, driven, road, own, heights, ahead=ahead)
                place = _place(lanes[beside].length, places[lane], crossing, ahead=ahead)
                places.setdefault(beside, place)
                if crossing is None and driven + lanes[beside].length < REACH:
                    waiting.append((beside, driven + lanes[beside].length))
    for via in [name for name in lanes if name[0] == ":" and name.rpartition("_")[0].rpartition("_")[0] in junctions]:
        near = [places[name] for name in joints if name.startswith(via.rpartition("_")[0].rpartition("_")[0] + "_")]
        places.setdefault(via, LanePlace(min(p.low for p in near), max(p.high for p in near)))
    return places


def _road_places(lanes: Lanes, count: LaneCount, edges: Sequence[str], road: RoadFrame) -> dict[str, LanePlace]:
    """The places of the road's own lanes and of the lanes of junctions between them, one edge after the other."""
    places: dict[str, LanePlace] = {}
    begin = -road.origin
    for k, edge in enumerate(edges):
        of_edge = [lanes[f"{edge}_{index}"] for index in range(count(edge))]
        longest = max(max(lane.length, length_of(lane.shape)) for lane in of_edge)
        ends = np.array([lane.shape[-1] for lane in of_edge])
        within = np.full(len(ends), begin - MARGIN), np.full(len(ends), begin + 1.2 * longest + MARGIN)
        end = float(np.median(road.to_road(ends, within)[0]))
        places |= {lane.id: LanePlace(begin - MARGIN, end + MARGIN) for lane in of_edge}
        if k + 1 == len(edges):
            break
        links = [link for lane in of_edge for link in lane.links if link.to.rpartition("_")[0] == edges[k + 1]]
        across = max((sum(lanes[via].length for via in link.via) for link in links), default=0.0)
        starts = np.array([lanes[link.to].shape[0] for link in links] or [lanes[f"{edges[k + 1]}_0"].shape[0]])
        within = np.full(len(starts), end - MARGIN), np.full(len(starts), end + 1.2 * across + MARGIN)
        begin = float(np.median(road.to_road(starts, within)[0]))
        places |= {via: LanePlace(end - MARGIN, begin + MARGIN) for link in links for via in link.via}
    return places


def _next(lanes: Lanes, entering: Mapping[str, Sequence[str]], lane: str, *, ahead: bool) -> Iterator[str]:
    """The lanes that a lane leads to (`ahead`) or that lead to it, those of junctions among them."""
    if ahead:
        for link in lanes[lane].links:
            yield link.via[0] if link.via else link.to
    else:
        yield from entering.get(lane, ())


def _place(length: float, joined: LanePlace, crossing: float | None, *, ahead: bool) -> LanePlace:
    """The place of a lane [m] that joins another one, up to where it crosses the road."""
    first = joined.high - MARGIN if ahead else joined.low + MARGIN
    low, high = (first - MARGIN, first + length + MARGIN) if ahead else (first - length - MARGIN, first + MARGIN)
    if crossing is None:
        return LanePlace(low, high)
    return LanePlace(low, high, *((-math.inf, crossing) if ahead else (length - crossing, math.inf)))


def _crossing(
    lanes: Lanes,
    name: str,
    driven: float,
    road: RoadFrame,
    places: Mapping[str, LanePlace],
    heights: Heights | None,
    *,
    ahead: bool,
) -> float | None:
    """How far [m] along a lane, from where it joins, it crosses the road on another level; None where it does not.

    Without `ahead` the way is counted backwards from the end of the lane.
    """
    lane = lanes[name]
    shape = lane.shape if ahead else lane.shape[::-1]
    step = np.hypot(*np.diff(shape, axis=0).T)
    arc = np.concatenate([[0.0], np.cumsum(step)])
    way = np.arange(max(NEAR_JOINT - driven, 0.0), arc[-1], SAMPLING)
    if not len(way):
        return None
    points = np.stack([np.interp(way, arc, shape[:, axis]) for axis in (0, 1)], axis=1)
    s, d = road.to_road(points)
    for k in np.flatnonzero(np.abs(d) < BESIDE).tolist():
        distance, at, across = float(way[k]), float(s[k]), float(d[k])
        below = _lanes_at(lanes, places, road, at, across)
        if below is None:
            continue
        if heights is None:
            return distance
        position = distance if ahead else lane.length - distance
        if abs(heights(name, min(max(position, 0.0), lane.length)) - heights(*below)) > LEVEL:
            return distance
    return None


def _lanes_at(
    lanes: Lanes, places: Mapping[str, LanePlace], road: RoadFrame, s: float, d: float
) -> tuple[str, float] | None:
    """A lane of the road that is at (s, d) [m], and the position [m] along it; None beside the road."""
    for name, place in places.items():
        if name[0] == ":" or not place.low + MARGIN <= s <= place.high - MARGIN:
            continue
        lane = lanes[name]
        share = (s - place.low - MARGIN) / max(place.high - place.low - 2 * MARGIN, 1.0)
        middle = road.to_road(_point(lane.shape, share)[None], (np.array([s - 50]), np.array([s + 50])))[1][0]
        if abs(middle - d) <= 0.5 * lane.width:
            return name, share * lane.length
    return None


def _point(shape: np.ndarray, share: float) -> np.ndarray:
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(shape, axis=0).T))])
    return np.array([np.interp(share * arc[-1], arc, shape[:, axis]) for axis in (0, 1)])
