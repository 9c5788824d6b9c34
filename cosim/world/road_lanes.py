"""From the lanes of a net to the frame of a road: a chain of lanes, followed through their links.

The reference line of a road runs along one lane from edge to edge, the leftmost one that goes on. So the d of a vehicle
that keeps its lane stays the same where a net shifts all lanes at a node. Everything here is a pure function of lanes;
`cosim.sumo.net` reads them from the running simulation, `cosim.runs.lanes` from a net file.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from cosim.world.polyline import (
    STRAIGHT,
    corner_normals,
    length_of,
    turned_normals,
    with_corner_vertices,
    without_repeated_points,
    without_straight_vertices,
)
from cosim.world.road_frame import RoadFrame

MEETING = 0.1  # [m]; net files round to centimetres, and in a bend the lanes of two edges may overlap
STEEPEST_JOINT = 0.5  # cosine of the angle between a joint and the road, below which the joint is a jump
_BREAK_COST = 1000.0  # of a place where the reference lane does not go on; more than any number of lanes


@dataclass(frozen=True)
class LaneLink:
    """A way from the end of a lane to the lane `to`, over the lanes `via` of a junction, if the net has any."""

    to: str
    via: tuple[str, ...] = ()


@dataclass(frozen=True)
class RoadLane:
    """A lane: its edge, its index from the right (from the left where traffic drives on the left), and its geometry.

    `shape` are the world points of its centre, `length` [m] is that of positions along it.
    """

    id: str
    edge: str
    index: int
    shape: Float[np.ndarray, "P 2"]
    length: float
    width: float
    links: tuple[LaneLink, ...] = ()

    def link_to(self, edge_or_lane: str) -> LaneLink | None:
        """The link to a lane or edge, if there is one."""
        return next((link for link in self.links if edge_or_lane in (link.to, link.to.rpartition("_")[0])), None)


Lanes = Mapping[str, RoadLane]
LaneCount = Callable[[str], int]
"""The number of lanes of an edge."""


def entering_lanes(lanes: Lanes) -> dict[str, list[str]]:
    """The lanes that lead to each lane, those of junctions among them."""
    entering: dict[str, list[str]] = {}
    for lane in lanes.values():
        for link in lane.links:
            entering.setdefault(link.via[0] if link.via else link.to, []).append(lane.id)
    return entering


def reference_lanes(lanes: Lanes, count: LaneCount, edges: Sequence[str]) -> list[str]:
    """One lane per edge: a chain with as few breaks as possible, and of these the leftmost."""
    best: dict[str, tuple[float, list[str]]] = {}
    for k, edge in enumerate(edges):
        step: dict[str, tuple[float, list[str]]] = {}
        for index in range(count(edge)):
            lane, choices = f"{edge}_{index}", []
            for before, (cost, chain) in best.items():
                joins = any(link.to == lane for link in lanes[before].links)
                choices.append((cost + (0.0 if joins else _BREAK_COST + abs(lanes[before].index - index)), chain))
            cost, chain = min(choices, key=lambda choice: choice[0]) if k else (0.0, [])
            step[lane] = (cost - index, [*chain, lane])
        best = step
    return min(best.values(), key=lambda found: found[0])[1]


def frame_along(lanes: Lanes, count: LaneCount, edges: Sequence[str], origin: str, *, mirrored: bool) -> RoadFrame:
    """The road frame of a chain of edges; s = 0 where `origin` begins."""
    runs, joints, begins = _runs(lanes, reference_lanes(lanes, count, edges), mirrored=mirrored)
    part, within = begins[edges.index(origin)]
    if len(runs) == 1 and len(line := without_straight_vertices(runs[0])) == 2 and not mirrored:
        return RoadFrame(line, within)
    points, normals, jumps, starts = [], [], [], []
    for k, run in enumerate(runs):
        line = with_corner_vertices(without_straight_vertices(run))
        if k:
            across, turned = _joint(points[-1], joints[k - 1], line[0], normals[-1], corner_normals(line)[0])
            jumps += [] if turned is not None else [len(points) - 1]
            points += [] if turned is None else [*across]
            normals += [] if turned is None else [*turned]
        starts.append(len(points))
        points += [*line]
        normals += [*corner_normals(line)]
    steps = np.hypot(*np.diff(points, axis=0).T)
    steps[jumps] = 0.0
    start = float(steps[: starts[part]].sum()) + within
    line, left, flip = np.array(points), np.array(normals), [1, -1] if mirrored else [1, 1]
    if not jumps and len(without_straight_vertices(line)) == 2 and np.abs(left - left[0]).max() < STRAIGHT:
        return RoadFrame(line[[0, -1]] * flip, start, mirrored=mirrored)
    return RoadFrame(line * flip, start, left * flip, tuple(jumps), mirrored=mirrored)


def _runs(
    lanes: Lanes, chain: Sequence[str], *, mirrored: bool
) -> tuple[list[np.ndarray], list[np.ndarray], list[tuple[int, float]]]:
    """The parts of the reference line between junctions, the lines across the junctions, and where edges begin.

    An edge begins in a part, at an arc length [m] along it. Where a lane does not go on, the line goes on beside the
    lane that does, so that it has no step.
    """
    runs: list[np.ndarray] = []
    joints: list[np.ndarray] = []
    begins: list[tuple[int, float]] = []
    shift = 0.0  # [m] of the reference line to the left of the lane of the chain
    for before, name in zip([None, *chain[:-1]], chain, strict=True):
        lane = lanes[name]
        link = None if before is None else next((link for link in lanes[before].links if link.to == name), None)
        if before is not None and link is None:
            shift += lanes[before].width * (lanes[before].index - _leading_index(lanes[before], lane, lanes))
        shape = lane.shape * [1, -1] if mirrored else lane.shape
        shape = without_repeated_points(shape)
        shape = shape + shift * corner_normals(shape) if shift else shape
        via = [lanes[part].shape * ([1, -1] if mirrored else [1, 1]) for part in (link.via if link else ())]
        if runs and math.dist(runs[-1][-1], shape[0]) < MEETING:
            begins.append((len(runs) - 1, length_of(runs[-1])))
            runs[-1] = np.concatenate([runs[-1], shape[1:]])
            continue
        if runs:
            joints.append(np.concatenate(via) if via else np.empty((0, 2)))
        begins.append((len(runs), 0.0))
        runs.append(shape)
    return runs, joints, begins


def _leading_index(before: RoadLane, lane: RoadLane, lanes: Lanes) -> int:
    """The index of the lane beside `before` that leads to `lane`; that of `before` if there is none."""
    beside = (other for k in range(100) if (other := lanes.get(f"{before.edge}_{k}")) is not None)
    return next((other.index for other in beside if other.link_to(lane.id)), before.index)


def _joint(
    end: np.ndarray, joint: np.ndarray, begin: np.ndarray, first: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """The vertices across a junction, from an `end` to a `begin`, and their normals; None where it is a jump aside.

    The normals turn evenly from those of the one edge to those of the next, whatever the line does in between: a shift
    to the side moves all lanes alike.
    """
    inner = [end]
    for point in joint:
        if math.dist(point, inner[-1]) > MEETING and math.dist(point, begin) > MEETING:
            inner.append(point)
    step = np.diff([*inner, begin], axis=0)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))])
    turned = turned_normals(first, last, arc / arc[-1])
    middle = 0.5 * (turned[:-1] + turned[1:])
    onward = (step * np.stack([middle[:, 1], -middle[:, 0]], axis=1)).sum(axis=1)
    steep = bool((onward < STEEPEST_JOINT * np.diff(arc)).any())
    return np.array(inner[1:]).reshape(-1, 2), None if steep else turned[1:-1]
