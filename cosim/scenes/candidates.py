"""Candidates for scenes on a tape: who they are, and when they begin; pure."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.measures.relation_labels import NOBODY
from cosim.scenes.lane_change_requests import SAME_LANE, Change
from cosim.scenes.rules import Kind, Rules
from cosim.scenes.trajectory_buffer import BufferedStep, Lane
from cosim.world.snapshot import LaneChange

Triple = tuple[int, int, int]


@dataclass(frozen=True)
class Window:
    """Three vehicles by number in the order of roles, and the index of the moment of their step 0."""

    kind: Kind
    vehicles: Triple
    begin: int


def rows_throughout(moments: Sequence[BufferedStep], vehicles: Sequence[int]) -> np.ndarray | None:
    """[V, T] Rows of vehicles in all these moments; None where one is missing somewhere."""
    try:
        return np.array([list(map(moment.row.__getitem__, vehicles)) for moment in moments]).T
    except KeyError:
        return None


def chains(moments: Sequence[BufferedStep], lanes: Sequence[Lane], counts: Counter[str]) -> list[Triple]:
    """Who followed whom followed whom in one lane all through these moments, sorted."""
    first = moments[0]
    all_through = set(first.row).intersection(*(moment.row for moment in moments))
    there = [number for number in first.row if number in all_through]
    rows = rows_throughout(moments, there) if there else None
    if rows is None:
        return []
    leader, lane = (
        np.stack([moment.of(name)[rows[:, t]] for t, moment in enumerate(moments)], 1).astype(int)  # Shape: (V, T)
        for name in ("leader", "lane")
    )
    centre = np.array([lane.centre for lane in lanes])[lane]
    stays = (leader == leader[:, :1]).all(1) & (np.ptp(centre, axis=1) < SAME_LANE)
    counts["leader or lane changes"] += int((~stays).sum())
    ahead = dict(zip(np.array(there)[stays].tolist(), leader[stays, 0].tolist(), strict=True))
    of = dict(zip(there, centre[:, 0].tolist(), strict=True))
    found = [(k, i, ahead[i]) for k, i in ahead.items() if i in ahead and ahead[i] in of]
    return sorted(trio for trio in found if max(at := [of[v] for v in trio]) - min(at) < SAME_LANE)


def merge_of(
    change: Change, moments: Sequence[BufferedStep], numbers: Mapping[str, int], rules: Rules, counts: Counter[str]
) -> Window | None:
    """The window around a lane change of the last moment, with the vehicles it drives between from then on."""
    now, vehicle = moments[-1], numbers[change.vehicle]
    if vehicle not in now.row or (rules.strategic and not change.state & LaneChange.STRATEGIC):
        return None
    seen = 0
    while seen < len(moments) - 1 and vehicle in moments[-2 - seen].row:
        seen += 1
    crossing, row = min(rules.merging_steps // 2, seen), now.row[vehicle]
    leader, behind = int(now.of("leader")[row]), change.behind
    if crossing < rules.least_before:
        counts["not seen long enough before the crossing"] += 1
    elif not behind or leader == NOBODY or leader not in now.row:
        counts["no vehicle ahead, or none behind"] += 1
    elif now.of("v")[row] < rules.merging_speed:
        counts["too slow at the crossing"] += 1
    else:
        return Window("merge", (vehicle, numbers[behind], leader), now.index - crossing)
    return None
