"""The lanes of a merge, followed through the links of the net: the lane that ends, and the lane beside it.

The lane that ends may go on across nodes before it ends, or lead into the next edge together with the lane beside it (a
zipper). It may be on either side of the road.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from cosim.world.groups import LanePair, MergeLanes
from cosim.world.road_frame import RoadFrame
from cosim.world.road_lanes import LaneCount, Lanes, RoadLane
from cosim.world.snapshot import LaneStrip
from gri.errors import InputError


def merging_lanes(
    lanes: Lanes, count: LaneCount, edges: Sequence[str], ending: str, road: RoadFrame, *, across_edges: bool
) -> MergeLanes:
    """The lanes of a merge from the lane `ending` of the road.

    With `across_edges` lag vehicle and leader may be on the edges before and after, too. Raises InputError if there is
    no such lane, or no lane beside it.
    """
    if ending not in lanes or ending[0] == ":":
        raise InputError(f"group.lane: got {ending!r}, but the net has no such lane; name the lane that ends")
    if (edge := lanes[ending].edge) not in edges:
        raise InputError(
            f"group.lane: got {ending!r}, but edge {edge!r} is not part of road.edges; name a lane of the road"
        )
    chain, ends = _ending_chain(lanes, edges, ending)
    side = _side(lanes, count, edges, chain)
    sources = [lanes[name] for name in chain]
    targets = [lanes[f"{lane.edge}_{lane.index + side}"] for lane in sources]
    own, beside = lanes[ending], lanes[f"{edge}_{lanes[ending].index + side}"]
    pairs = _pairs(lanes, sources, targets, road)
    strips = [strip_of(lane, road) for lane in (sources[0], sources[-1], own, targets[0], targets[-1], beside)]
    first, last, of_own, first_target, last_target, of_beside = strips
    end = max(last.end, _end_of_zipper(lanes, edges, sources[-1], targets[-1], road))
    along = {lane.id for lane in targets} | {pair.target for pair in pairs}
    return MergeLanes(
        source=LaneStrip(ending, first.begin, end, of_own.centre, own.width),
        target=LaneStrip(beside.id, first_target.begin, last_target.end, of_beside.centre, beside.width),
        side=side,
        pairs=tuple(pairs) if len(pairs) > 1 else (),
        targets=frozenset(along | followed(lanes, edges, targets) if across_edges else along),
        ends=ends,
    )


def onward_lane(lanes: Lanes, edges: Sequence[str], lane: RoadLane) -> str | None:
    """The lane of the next edge of the road that a lane leads to."""
    following = dict(pairwise(edges)).get(lane.edge)
    return next((link.to for link in lane.links if lanes[link.to].edge == following), None)


def _ending_chain(lanes: Lanes, edges: Sequence[str], ending: str) -> tuple[list[str], bool]:
    """The lane that ends, and those before and after it that it goes on on, across nodes; and whether it ends."""
    chain = [ending]
    while (onward := onward_lane(lanes, edges, lanes[chain[-1]])) is not None:
        if _is_shared(lanes, chain[-1], onward):
            break  # a zipper: the lane beside it leads there, too
        chain.append(onward)
    if lanes[chain[-1]].edge == edges[-1] and lanes[chain[-1]].links:
        return [ending], False  # it goes on to the end of the road
    before = {after: edge for edge, after in pairwise(edges)}
    while (edge := before.get(lanes[chain[0]].edge)) is not None:
        leading = [lane.id for lane in lanes_of_edge(lanes, edge) if onward_lane(lanes, edges, lane) == chain[0]]
        if len(leading) != 1:
            break
        chain.insert(0, leading[0])
    return chain, True


def lanes_of_edge(lanes: Lanes, edge: str) -> list[RoadLane]:
    """The lanes of an edge from the right to the left."""
    return [lane for k in range(100) if (lane := lanes.get(f"{edge}_{k}")) is not None]


def _is_shared(lanes: Lanes, lane: str, onward: str) -> bool:
    others = (other for other in lanes_of_edge(lanes, lanes[lane].edge) if other.id != lane)
    return any(link.to == onward for other in others for link in other.links)


def _side(lanes: Lanes, count: LaneCount, edges: Sequence[str], chain: Sequence[str]) -> int:
    """1 if vehicles merge to the lane of the next index, −1 if to the other side: the side on which a lane goes on."""
    last = lanes[chain[-1]]
    beside = [side for side in (1, -1) if 0 <= last.index + side < count(last.edge)]
    if not beside:
        raise InputError(
            f"group.lane: got {chain[-1]!r}, the only lane of edge {last.edge!r}, so that no lane is beside it;"
            " name a lane that ends beside another one"
        )
    goes_on = [
        side for side in beside if onward_lane(lanes, edges, lanes[f"{last.edge}_{last.index + side}"]) is not None
    ]
    side = (goes_on or beside)[0]
    if missing := [name for name in chain if f"{lanes[name].edge}_{lanes[name].index + side}" not in lanes]:
        raise InputError(f"group.lane: no lane is beside {missing[0]!r}, which belongs to {chain[-1]!r}; name another")
    return side


def _pairs(lanes: Lanes, sources: Sequence[RoadLane], targets: Sequence[RoadLane], road: RoadFrame) -> list[LanePair]:
    """The lane that ends and the one beside it, one after the other, those of junctions among them."""
    pairs = []
    for k, (source, target) in enumerate(zip(sources, targets, strict=True)):
        pairs.append(LanePair(source.id, target.id, strip_of(source, road).end))
        if k + 1 < len(sources):
            ways = [
                next((link.via for link in lane.links if link.to == to.id), ())
                for lane, to in ((source, sources[k + 1]), (target, targets[k + 1]))
            ]
            begin = strip_of(sources[k + 1], road).begin
            if ways[0] and ways[1] and begin > pairs[-1].end:
                pairs.append(LanePair(ways[0][0], ways[1][0], begin))
    return pairs


def _end_of_zipper(lanes: Lanes, edges: Sequence[str], source: RoadLane, target: RoadLane, road: RoadFrame) -> float:
    """s [m] where the lanes have become one, if the one that ends leads to the same lane; −inf if it does not."""
    onward = onward_lane(lanes, edges, source)
    if onward is None or onward != onward_lane(lanes, edges, target):
        return -np.inf
    return strip_of(lanes[onward], road).begin


def followed(lanes: Lanes, edges: Sequence[str], targets: Sequence[RoadLane]) -> frozenset[str]:
    """The lanes of the road before and after the target lanes, those of junctions among them."""
    found: set[str] = set()
    lane: RoadLane | None = targets[-1]
    while lane is not None and (onward := onward_lane(lanes, edges, lane)) is not None:
        found |= {onward, *(via for link in lane.links if link.to == onward for via in link.via)}
        lane = lanes[onward]
    before: Mapping[str, str] = {after: edge for edge, after in pairwise(edges)}
    lane = targets[0]
    while lane is not None:
        leading = [other for other in lanes_of_edge(lanes, before.get(lane.edge, "")) if other.link_to(lane.id)]
        found |= {other.id for other in leading}
        found |= {via for other in leading for link in other.links if link.to == lane.id for via in link.via}
        lane = max(leading, key=lambda other: other.index, default=None)
    return frozenset(found)


def strip_of(lane: RoadLane, road: RoadFrame) -> LaneStrip:
    """The position of a lane in the road frame; the lane must run along the road."""
    place, points = (road.places or {}).get(lane.id), lane.shape
    within = place and (np.full(len(points), place.low), np.full(len(points), place.high))
    s, d = road.to_road(points, within)
    return LaneStrip(lane.id, float(s[0]), float(s[-1]), float(d[-1]), lane.width)
