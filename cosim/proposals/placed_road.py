"""Where the lanes of a proposed road are along it, as the simulation will see them."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

from cosim.proposals.main_road import EndingLane, MainRoad
from cosim.runs.lanes import is_left_hand, lanes_of, parse_net
from cosim.world.groups import MergeLanes
from cosim.world.joining_ramps import joining_lanes
from cosim.world.merging_lanes import merging_lanes
from cosim.world.road_lanes import entering_lanes, frame_along
from cosim.world.road_world import lane_places
from gri.errors import InputError


def placed(road: MainRoad, net: Path) -> MainRoad:
    """The road with its length and the places of its ending lanes [m of s]; lanes that cannot be used are left out."""
    root = parse_net(net)
    lanes = lanes_of(root)
    count = Counter(lane.edge for lane in lanes.values()).__getitem__
    entering, edges = entering_lanes(lanes), [*road.edges]
    frame = frame_along(lanes, count, edges, edges[0], mirrored=is_left_hand(root))
    frame = replace(frame, places=lane_places(lanes, entering, count, edges, frame, None))
    ending = []
    for lane in road.ending:
        try:
            if lane.joins:
                found = joining_lanes(lanes, entering, edges, lane.lane, frame)
            else:
                found = merging_lanes(lanes, count, edges, lane.lane, frame, across_edges=True)
        except InputError:
            continue
        ending.append(_placed(lane, found, mirrored=frame.mirrored))
    return replace(road, length=frame.end, ending=tuple(ending))


def _placed(lane: EndingLane, found: MergeLanes, *, mirrored: bool) -> EndingLane:
    side = "right" if (found.side > 0) != mirrored else "left"
    return replace(lane, begin=round(found.source.begin, 1), end=round(found.source.end, 1), side=side)
