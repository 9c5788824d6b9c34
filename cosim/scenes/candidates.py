"""Candidates for scenes in the buffered traffic: which vehicles, and from which step on. Pure functions."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.measures.relation_labels import NO_VEHICLE
from cosim.scenes.lane_change_requests import SAME_LANE, LaneChangeEvent
from cosim.scenes.scene_rules import DT, TRIPLE_SHARES, Kind, Rules
from cosim.scenes.trajectory_buffer import BufferedStep, Lane, RoadSection
from cosim.world.snapshot import LaneChange

NEXT_LANE = 5.5  # [m]; lanes beside each other are closer
Triple = tuple[int, int, int]
Chain = tuple[int, ...]


@dataclass(frozen=True)
class Window:
    """A candidate: vehicle numbers in the order of roles, and the buffer's index of its step 0."""

    kind: Kind
    vehicles: Chain
    begin: int


def rows_at_every_step(steps: Sequence[BufferedStep], vehicles: Sequence[int]) -> np.ndarray | None:
    """[V, T] Rows of the vehicles in all these steps; None if a vehicle is missing in one of them."""
    try:
        return np.array([list(map(step.row_of.__getitem__, vehicles)) for step in steps]).T
    except KeyError:
        return None


def following_chains(
    steps: Sequence[BufferedStep], lanes: Sequence[Lane], counts: Counter[str], size: int
) -> list[Chain]:
    """Chains of `size` vehicles in which 0 follows 1, 1 follows 2, ... in one lane during all these steps, sorted.

    Vehicles whose leader or lane changes are counted in `counts`.
    """
    first = steps[0]
    all_through = set(first.row_of).intersection(*(step.row_of for step in steps))
    present = [number for number in first.row_of if number in all_through]
    rows = rows_at_every_step(steps, present) if present else None
    if rows is None:
        return []
    leader, lane = (
        np.stack([step.column(name)[rows[:, t]] for t, step in enumerate(steps)], 1).astype(int)  # Shape: (V, T)
        for name in ("leader", "lane")
    )
    centre = np.array([lane.centre for lane in lanes])[lane]
    constant = (leader == leader[:, :1]).all(1) & (np.ptp(centre, axis=1) < SAME_LANE)
    counts["leader or lane changes"] += int((~constant).sum())
    leader_of = dict(zip(np.array(present)[constant].tolist(), leader[constant, 0].tolist(), strict=True))
    centre_of = dict(zip(present, centre[:, 0].tolist(), strict=True))
    chains: list[Chain] = [(k,) for k in leader_of]
    for _ in range(size - 1):
        chains = [(*chain, leader_of[chain[-1]]) for chain in chains if chain[-1] in leader_of]
    chains = [chain for chain in chains if chain[-1] in centre_of]  # the last one has no leader, or any
    return sorted(chain for chain in chains if max(at := [centre_of[v] for v in chain]) - min(at) < SAME_LANE)


def triples(steps: Sequence[BufferedStep], section: RoadSection, rules: Rules) -> dict[str, list[Triple]]:
    """Triples of vehicles that keep their lanes during all these steps, by the graph that SUMO's leaders suggest.

    The leaders are those of the first step; the names are those of `scene_rules.TRIPLE_SHARES`. Vehicles 0, 1 and 2
    drive one ahead of the other. Where a vehicle follows nobody of the triple, another vehicle is between it and the
    next one, or the next one is in the lane beside it. Labels decide later who really follows whom.
    """
    first, lane_keepers = steps[0], _lane_keepers(steps, section.lanes)
    number = {row: vehicle for vehicle, row in first.row_of.items()}
    s, d = _road_positions(first, section)
    least, most = rules.triple_spacing
    at = {number[row]: (s[row], d[row]) for row in range(len(s)) if number[row] in lane_keepers}
    leader = {v: int(first.column("leader")[first.row_of[v]]) for v in at}
    leader = {v: ahead for v, ahead in leader.items() if ahead in at}
    order = sorted(at, key=lambda v: at[v][0])
    beside = {v: _beside(k, order, at, least, most) for k, v in enumerate(order)}

    def ahead(v: int, times: int) -> int:
        for _ in range(times):
            v = leader.get(v, NO_VEHICLE)
        return v

    def fits(trio: Triple) -> bool:
        if not at.keys() >= set(trio):
            return False
        headways = np.diff([at[v][0] for v in trio])
        return bool(((headways >= least) & (headways < most)).all())

    found: dict[str, list[Triple]] = {name: [] for name in TRIPLE_SHARES}
    for v in order:
        one, two, three, four = (ahead(v, times) for times in (1, 2, 3, 4))
        found["0 follows 1, 1 follows 2"].append((v, one, two))
        found["0 follows 1"] += [(v, one, three), *((v, one, w) for w in beside.get(one, ()))]
        found["1 follows 2"] += [(v, two, three), *((v, u, ahead(u, 1)) for u in beside[v])]
        found["0 follows 2"] += [(v, u, one) for u in beside[v]]
        found["nobody follows"] += [(v, two, four), *((v, u, two) for u in beside[v])]
    return {name: sorted(filter(fits, trios)) for name, trios in found.items()}


def _lane_keepers(steps: Sequence[BufferedStep], lanes: Sequence[Lane]) -> set[int]:
    """Vehicles that are present at all steps, in one lane."""
    everywhere = set(steps[0].row_of).intersection(*(step.row_of for step in steps))
    present = [vehicle for vehicle in steps[0].row_of if vehicle in everywhere]
    rows = rows_at_every_step(steps, present) if present else None
    if rows is None:
        return set()
    lane = np.stack([step.column("lane")[rows[:, t]] for t, step in enumerate(steps)], 1).astype(int)
    centre = np.array([lane.centre for lane in lanes])[lane]
    return set(np.array(present)[np.ptp(centre, axis=1) < SAME_LANE].tolist())


def _road_positions(step: BufferedStep, section: RoadSection) -> tuple[np.ndarray, np.ndarray]:
    """[V] Position along the road and lateral position of each vehicle's lane [m]."""
    lane, position = step.column("lane").astype(int), step.column("position")
    xy = np.zeros((len(lane), 2))
    for index in np.unique(lane):
        xy[lane == index] = section.lanes[int(index)].points(position[lane == index])
    return section.road.to_road(xy)[0], np.array(section.centres)[lane]


def _beside(
    k: int, order: Sequence[int], at: Mapping[int, tuple[float, float]], least: float, most: float
) -> list[int]:
    """The nearest vehicles ahead of the k-th one in the lanes beside it; `order` is that of the road."""
    s, d = at[order[k]]
    found: dict[float, int] = {}
    for other in map(order.__getitem__, range(k + 1, len(order))):
        gap, side = at[other][0] - s, at[other][1] - d
        if gap >= most or len(found) == 2:
            break
        if gap >= least and SAME_LANE < abs(side) < NEXT_LANE:
            found.setdefault(math.copysign(1.0, side), other)
    return list(found.values())


def merge_window(
    change: LaneChangeEvent,
    steps: Sequence[BufferedStep],
    numbers: Mapping[str, int],
    rules: Rules,
    counts: Counter[str],
    seed: int = 0,
) -> Window | None:
    """The window around a lane change of the last step: the vehicle, its new follower and its new leader.

    `seed` and the vehicle's number decide where in the window the lane change is, if `rules` have a jitter. None if a
    rule excludes the lane change; the reason is counted in `counts`.
    """
    now, vehicle = steps[-1], numbers[change.vehicle]
    if vehicle not in now.row_of or (rules.strategic and not change.state & LaneChange.STRATEGIC):
        return None
    present_before = 0
    while present_before < len(steps) - 1 and vehicle in steps[-2 - present_before].row_of:
        present_before += 1
    most, row = round(rules.jitter / DT), now.row_of[vehicle]
    later = int(np.random.default_rng([seed, vehicle]).integers(-most, most + 1)) if most else 0
    crossing = min(rules.merging_steps // 2 + later, present_before)
    leader, follower = int(now.column("leader")[row]), change.new_follower
    if crossing < rules.least_before:
        counts["not seen long enough before the crossing"] += 1
    elif not follower or leader == NO_VEHICLE or leader not in now.row_of:
        counts["no vehicle ahead, or none behind"] += 1
    elif now.column("v")[row] < rules.merging_speed:
        counts["too slow at the crossing"] += 1
    else:
        return Window("merge", (vehicle, numbers[follower], leader), now.index - crossing)
    return None
