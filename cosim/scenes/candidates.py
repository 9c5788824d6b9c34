"""Candidates for scenes in the buffered traffic: which vehicles, and from which step on. Pure functions."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.measures.relation_labels import NO_VEHICLE
from cosim.scenes.lane_change_requests import SAME_LANE, LaneChangeEvent
from cosim.scenes.scene_rules import Kind, Rules
from cosim.scenes.trajectory_buffer import BufferedStep, Lane
from cosim.world.snapshot import LaneChange

Triple = tuple[int, int, int]


@dataclass(frozen=True)
class Window:
    """A candidate: three vehicle numbers in the order of roles, and the buffer's index of its step 0."""

    kind: Kind
    vehicles: Triple
    begin: int


def rows_at_every_step(steps: Sequence[BufferedStep], vehicles: Sequence[int]) -> np.ndarray | None:
    """[V, T] Rows of the vehicles in all these steps; None if a vehicle is missing in one of them."""
    try:
        return np.array([list(map(step.row_of.__getitem__, vehicles)) for step in steps]).T
    except KeyError:
        return None


def following_chains(steps: Sequence[BufferedStep], lanes: Sequence[Lane], counts: Counter[str]) -> list[Triple]:
    """Triples in which 0 follows 1 and 1 follows 2 in one lane during all these steps, sorted.

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
    triples = [(k, i, leader_of[i]) for k, i in leader_of.items() if i in leader_of and leader_of[i] in centre_of]
    return sorted(trio for trio in triples if max(at := [centre_of[v] for v in trio]) - min(at) < SAME_LANE)


def merge_window(
    change: LaneChangeEvent,
    steps: Sequence[BufferedStep],
    numbers: Mapping[str, int],
    rules: Rules,
    counts: Counter[str],
) -> Window | None:
    """The window around a lane change of the last step: the vehicle, its new follower and its new leader.

    None if a rule excludes the lane change; the reason is counted in `counts`.
    """
    now, vehicle = steps[-1], numbers[change.vehicle]
    if vehicle not in now.row_of or (rules.strategic and not change.state & LaneChange.STRATEGIC):
        return None
    present_before = 0
    while present_before < len(steps) - 1 and vehicle in steps[-2 - present_before].row_of:
        present_before += 1
    crossing, row = min(rules.merging_steps // 2, present_before), now.row_of[vehicle]
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
