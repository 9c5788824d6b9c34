"""Ramps without a lane of their own on the road: they join one of its lanes at a node.

A vehicle on such a ramp follows the ramp into the lane of the road; it can only choose when to be there. So its merge
takes place along the ramp's own path, which is aligned with the road: both have the same s where the lanes are one.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from cosim.world.groups import LanePair, MergeLanes
from cosim.world.merging_lanes import followed, lanes_of_edge, onward_lane, strip_of
from cosim.world.polyline import length_of, without_repeated_points, without_straight_vertices
from cosim.world.road_frame import RoadFrame
from cosim.world.road_lanes import Lanes, RoadLane
from cosim.world.snapshot import LaneStrip
from gri.errors import InputError

LONGEST_RAMP = 400.0  # [m] of a ramp that are looked at
SIDE_BY_SIDE = 15.0  # [m] before the node, from which on the vehicle is visible on the road
MOST_LANES = 50


def joining_lanes(
    lanes: Lanes, entering: Mapping[str, Sequence[str]], edges: Sequence[str], ramp: str, road: RoadFrame
) -> MergeLanes:
    """The lanes of a merge from a lane of a ramp that joins the road at a node.

    Raises InputError where the ramp has a lane of its own on the road, which must be named, or joins no lane.
    """
    chain, joined = _to_the_road(lanes, edges, ramp)
    if joined.edge != edges[-1] and onward_lane(lanes, edges, joined) is None:
        raise InputError(f"group.lane: {ramp!r} leads to {joined.id!r}, a lane of the road that ends; name that one")
    before = {after: edge for edge, after in pairwise(edges)}.get(joined.edge, "")
    rivals = [lane for lane in lanes_of_edge(lanes, before) if lane.link_to(joined.id)]
    if not rivals:
        raise InputError(
            f"group.lane: {ramp!r} leads to {joined.id!r}, to which no other lane of the road leads; nobody merges"
        )
    while len(before := [name for name in entering.get(chain[0], ()) if lanes[name].edge not in edges]) == 1:
        if sum(lanes[name].length for name in chain) > LONGEST_RAMP or before[0] in chain:
            break
        chain.insert(0, before[0])
    target, end = rivals[-1], strip_of(joined, road).begin
    path = _path(lanes, chain, joined, end, road)
    ends = [end - _length(lanes, chain[k + 1 :]) for k in range(len(chain))]
    via = next(link.via for link in target.links if link.to == joined.id)
    beside = [(via[0] if via else joined.id) if name[0] == ":" else target.id for name in chain]
    place = strip_of(target, road)
    far = path.to_world(np.array([ends[-1] - SIDE_BY_SIDE]), np.zeros(1))[0]
    d = road.to_road(far, (np.array([end - 60]), np.array([end + 20])))[1][0]
    side = 1 if d < place.centre else -1
    begin, visible = end - _length(lanes, chain), _length(lanes, [n for n in chain if n[0] == ":"]) + SIDE_BY_SIDE
    return MergeLanes(
        source=LaneStrip(ramp, begin, end, place.centre - side * place.width, lanes[ramp].width),
        target=LaneStrip(target.id, end - visible, end, place.centre, place.width),
        side=side,
        pairs=tuple(LanePair(*pair) for pair in zip(chain, beside, ends, strict=True)),
        targets=frozenset({target.id}) | followed(lanes, edges, [target]),
        path=path,
    )


def _to_the_road(lanes: Lanes, edges: Sequence[str], ramp: str) -> tuple[list[str], RoadLane]:
    """The lanes from a ramp up to the road, those of junctions among them, and the lane of the road they lead to."""
    chain, lane = [ramp], lanes[ramp]
    for _ in range(MOST_LANES):
        links = sorted(lane.links, key=lambda link: lanes[link.to].edge not in edges)
        if not links:
            break
        chain += links[0].via
        lane = lanes[links[0].to]
        if lane.edge in edges:
            return chain, lane
        chain.append(lane.id)
    raise InputError(f"group.lane: got {ramp!r}, which does not lead to road.edges; name the lane that ends")


def _length(lanes: Lanes, chain: Sequence[str]) -> float:
    return sum((length_of(lanes[name].shape) for name in chain), 0.0)


def _path(lanes: Lanes, chain: Sequence[str], joined: RoadLane, end: float, road: RoadFrame) -> RoadFrame:
    """The line along the ramp and on along the lane of the road, with the s of the road where that lane begins."""
    line = without_repeated_points(np.concatenate([lanes[name].shape for name in chain]), 0.05)
    following = joined.shape if np.hypot(*(joined.shape[0] - line[-1])) > 0.05 else joined.shape[1:]
    whole = without_straight_vertices(np.concatenate([line, following]))
    return RoadFrame(whole, length_of(np.concatenate([line, joined.shape[:1]])) - end, mirrored=road.mirrored)
