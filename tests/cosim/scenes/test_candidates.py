"""Candidates on hand-made tapes: lanes 0 (right) and 1 (left) of one edge, vehicles a.0 to a.9 are numbers 0 to 9."""

from collections import Counter

import msgspec
import numpy as np

from cosim.measures.relation_labels import NOBODY
from cosim.scenes.candidates import Window, chains, merge_of, rows_throughout
from cosim.scenes.lane_change_requests import Change
from cosim.scenes.rules import Rules
from cosim.scenes.trajectory_buffer import COLUMN, COLUMNS, BufferedStep, Lane, Numbers
from cosim.world.snapshot import LaneChange

LANES = [Lane("road", np.array([[0.0, y], [100.0, y]]), 100.0, y) for y in (-3.5, 0.0)]
RULES = Rules()
STRATEGIC = int(LaneChange.STRATEGIC | LaneChange.LEFT)


def moment(index: int, lane: dict[int, int], leader: dict[int, int], v: float = 10.0) -> BufferedStep:
    """Vehicles by number with their lane and leader."""
    values = np.zeros((len(lane), len(COLUMNS)))
    values[:, COLUMN["lane"]] = list(lane.values())
    values[:, COLUMN["leader"]] = [leader.get(number, NOBODY) for number in lane]
    values[:, COLUMN["v"]] = v
    ids = [f"a.{number}" for number in lane]
    leaders = [f"a.{leader[number]}" if number in leader else "" for number in lane]
    return BufferedStep(index, 0.2 * index, ids, leaders, {number: row for row, number in enumerate(lane)}, values, [])


def test_numbers_say_flow_and_vehicle():
    numbers = Numbers(["through", "on.ramp"])
    assert [numbers[name] for name in ("through.7", "on.ramp.12", "")] == [7, 1_000_012, NOBODY]


def test_a_chain_keeps_its_order_and_lane_all_through():
    lane, leader = {0: 0, 1: 0, 2: 0, 3: 1}, {0: 1, 1: 2}
    counts: Counter[str] = Counter()
    assert chains([moment(k, lane, leader) for k in range(4)], LANES, counts) == [(0, 1, 2)]
    assert not counts["leader or lane changes"]
    other = moment(2, lane, {0: 2, 1: 2})
    assert chains([moment(0, lane, leader), moment(1, lane, leader), other], LANES, counts) == []
    assert counts["leader or lane changes"] == 1
    over = moment(1, lane | {0: 1}, leader)
    assert chains([moment(0, lane, leader), over], LANES, counts) == []


def test_a_leader_in_another_lane_makes_no_chain():
    assert chains([moment(k, {0: 0, 1: 0, 2: 1}, {0: 1, 1: 2}) for k in range(3)], LANES, Counter()) == []


def test_who_is_not_seen_all_through_has_no_rows():
    both = [moment(0, {5: 0, 6: 0}, {}), moment(1, {6: 0, 5: 0}, {})]
    rows = rows_throughout(both, [6, 5])
    assert rows is not None
    assert rows.tolist() == [[1, 0], [0, 1]]
    assert rows_throughout([*both, moment(2, {5: 0}, {})], [6, 5]) is None


def merge(moments: list[BufferedStep], rules: Rules = RULES, behind: str = "a.1", state: int = STRATEGIC):
    counts: Counter[str] = Counter()
    change = Change("a.0", 0, 1, state, behind)
    return merge_of(change, moments, Numbers(["a"]), rules, counts), counts


def before(steps: int, **options: float) -> list[BufferedStep]:
    there = [moment(k, {0: 0, 1: 1, 2: 1}, {1: 2}, **options) for k in range(steps)]
    return [*there, moment(steps, {0: 1, 1: 1, 2: 1}, {0: 2, 1: 0}, **options)]


def test_a_merge_is_cut_so_that_it_happens_in_the_middle():
    assert merge(before(30))[0] == Window("merge", (0, 1, 2), 10)


def test_who_came_late_begins_its_scene_late():
    assert merge(before(12))[0] == Window("merge", (0, 1, 2), 0)
    found, counts = merge(before(5))
    assert found is None
    assert counts["not seen long enough before the crossing"] == 1


def test_merges_need_a_reason_a_gap_and_speed():
    for_speed = int(LaneChange.LEFT) | 1 << 5
    assert merge(before(30), state=for_speed)[0] is None
    assert merge(before(30), msgspec.structs.replace(RULES, strategic=False), state=for_speed)[0] is not None
    assert merge(before(30), behind="")[1]["no vehicle ahead, or none behind"] == 1
    assert merge(before(30, v=1.0))[1]["too slow at the crossing"] == 1
