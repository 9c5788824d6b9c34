"""Where groups could be driven: the road that most vehicles drive along, and the lanes that end beside it.

Pure functions of a net and of the routes that vehicles took.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cosim.proposals.net_file import NetLanes
from gri.errors import InputError

FREEWAY_SPEED = 13.0  # [m/s]; slower roads count less
SLOW_ROAD_WEIGHT = 0.2
MARGIN = 5.0  # [m] that the study area ends before the road does
MERGE_MARGIN = 40.0  # [m] of the ending lane that are left free at its end
SHORTEST_ENDING_LANE = 60.0  # [m]


@dataclass(frozen=True)
class EndingLane:
    """A lane of the main road from which vehicles must change to go on along the road.

    `begin` and `end` are positions s along the road [m]. `side` is the side of the road on which it ends. `leads_off`
    says whether it goes on to another road instead of ending. `entries` are the edges that feed it from outside. A lane
    of a ramp that joins the road at a node without a lane of its own `joins`.
    """

    lane: str
    begin: float
    end: float
    side: str
    leads_off: bool
    entries: tuple[str, ...]
    joins: bool = False

    @property
    def zone(self) -> tuple[int, int]:
        """The range of s [m] in which a group can be taken over and still has room to merge."""
        length = self.end - self.begin
        return round(self.begin + 0.1 * length), round(max(self.begin + 0.3 * length, self.begin + 0.6 * length - 20))


@dataclass(frozen=True)
class MainRoad:
    """A chain of edges, with the number of vehicles that drove on it, its length [m] and its ending lanes."""

    edges: tuple[str, ...]
    vehicles: int
    length: float
    ending: tuple[EndingLane, ...]


def main_road(net: NetLanes, routes: Mapping[tuple[str, ...], int]) -> MainRoad:
    """The chain of edges on which the most vehicle-metres are driven, without traffic lights and turns to other roads.

    Raises `InputError` if no vehicle drove.
    """
    if not routes:
        raise InputError("no vehicle entered the net; check the times and routes of the demand, or give --seconds")
    use: Counter[str] = Counter()
    for route, count in routes.items():
        for edge in set(route):
            use[edge] += count
    chains = {chain for route in routes for chain in _uninterrupted(net, route)}
    if not chains:
        raise InputError("no vehicle drove on an edge of the net that allows passenger cars")
    best = max(sorted(chains), key=lambda chain: sum(use[edge] * _weight(net, edge) for edge in chain))
    return MainRoad(best, max(use[edge] for edge in best), _length(net, best), ending_lanes(net, best))


def _uninterrupted(net: NetLanes, route: Sequence[str]) -> list[tuple[str, ...]]:
    """The parts of a route between traffic lights, repeated edges, and edges that no car may use."""
    parts, part = [], []
    for edge in route:
        if edge not in net.of_edge or not any(net.lanes[lane].for_cars for lane in net.of_edge[edge]):
            parts, part = [*parts, part], []
            continue
        if part and (edge in part or not net.leads_from(part[-1], edge) or _has_light(net, part[-1])):
            parts, part = [*parts, part], []
        part.append(edge)
    return [tuple(part) for part in (*parts, part) if part]


def _has_light(net: NetLanes, edge: str) -> bool:
    return any(net.lanes[lane].has_light for lane in net.of_edge[edge])


def _weight(net: NetLanes, edge: str) -> float:
    """What a vehicle on this edge counts: its length [m], less where the road is slow, has one lane, or is a ramp."""
    lanes = [net.lanes[lane] for lane in net.of_edge[edge]]
    fast = max(lane.limit for lane in lanes) >= FREEWAY_SPEED
    return lanes[0].length * (1 if fast else SLOW_ROAD_WEIGHT) * (1 if len(lanes) > 1 else SLOW_ROAD_WEIGHT)


def _length(net: NetLanes, edges: Sequence[str]) -> float:
    return sum(net.lanes[net.of_edge[edge][0]].length for edge in edges)


def ending_lanes(net: NetLanes, edges: Sequence[str]) -> tuple[EndingLane, ...]:
    """The lanes of the road that lead to no lane of its next edge, or to the lane of a neighbour, and joining ramps."""
    found, begin = [], 0.0
    for k, (edge, following) in enumerate(zip(edges, [*edges[1:], None], strict=True)):
        lanes = [net.lanes[lane] for lane in net.of_edge[edge]]
        onward = [next((to for to in lane.leads_to if net.lanes[to].edge == following), None) for lane in lanes]
        if following is not None and any(onward):
            goes_on = _without_zippers(onward)
            first, last = goes_on.index(True), len(goes_on) - 1 - goes_on[::-1].index(True)
            for lane in lanes:
                beside = lane.index in (first - 1, last + 1)
                length, fed_by = _way_back(net, edges[: k + 1], lane.id)
                if beside and lane.for_cars and length >= SHORTEST_ENDING_LANE:
                    found.append(
                        EndingLane(
                            lane=lane.id,
                            begin=round(begin + lane.length - length, 1),
                            end=round(begin + lane.length, 1),
                            side="right" if lane.index < first else "left",
                            leads_off=bool(lane.leads_to) and onward[lane.index] is None,
                            entries=fed_by,
                        )
                    )
        found += _joining(net, edges, k, begin)
        begin += lanes[0].length
    return tuple(found)


def _without_zippers(onward: Sequence[str | None]) -> list[bool]:
    """Which lanes go on, counting of two lanes that lead to one only the inner one."""
    goes_on = [to is not None for to in onward]
    if len(onward) > 1 and onward[0] is not None and onward[0] == onward[1]:
        goes_on[0] = False
    elif len(onward) > 1 and onward[-1] is not None and onward[-1] == onward[-2]:
        goes_on[-1] = False
    return goes_on


def _way_back(net: NetLanes, edges: Sequence[str], lane: str) -> tuple[float, tuple[str, ...]]:
    """How long [m] a lane has been going on, across nodes of the road, and which edges outside feed it there."""
    length, entries = net.lanes[lane].length, {*_entries(net, lane, edges)}
    for edge in edges[-2::-1]:
        before = [name for name in net.of_edge[edge] if lane in net.lanes[name].leads_to]
        if len(before) != 1:
            break
        lane = before[0]
        length += net.lanes[lane].length
        entries |= {*_entries(net, lane, edges)}
    return length, tuple(sorted(entries))


def _joining(net: NetLanes, edges: Sequence[str], k: int, begin: float) -> list[EndingLane]:
    """The lanes of ramps that lead to a lane at the beginning of edge `k` to which a lane of the road leads as well."""
    found = []
    for lane in net.of_edge[edges[k]] if k else ():
        leading = [other for other in net.lanes.values() if lane in other.leads_to and other.for_cars]
        if any(other.edge == edges[k - 1] for other in leading):
            ramps = [other for other in leading if other.edge not in edges and other.length >= SHORTEST_ENDING_LANE]
            side = "right" if net.lanes[lane].index == 0 else "left"
            found += [
                EndingLane(ramp.id, round(begin - ramp.length, 1), begin, side, False, (ramp.edge,), joins=True)
                for ramp in ramps
                if not ramp.has_light
            ]
    return found


def _entries(net: NetLanes, lane: str, edges: Sequence[str]) -> tuple[str, ...]:
    """The edges outside the road that lead to this lane."""
    feeding = {before.edge for before in net.lanes.values() if lane in before.leads_to}
    return tuple(sorted(feeding - set(edges)))
