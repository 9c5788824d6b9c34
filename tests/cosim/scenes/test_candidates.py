"""Candidates in hand-made traffic: lanes 0 (right) and 1 (left) of one edge, vehicles a.0 to a.9 are numbers 0 to 9."""

from collections import Counter

import msgspec
import numpy as np
import pytest

from cosim.measures.relation_labels import NO_VEHICLE
from cosim.scenes.candidates import Window, following_chains, merge_window, rows_at_every_step, triples
from cosim.scenes.lane_change_requests import LaneChangeEvent
from cosim.scenes.scene_rules import Rules
from cosim.scenes.trajectory_buffer import COLUMN, COLUMNS, BufferedStep, Lane, RoadSection, VehicleNumbers
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import LaneChange

LANES = [Lane("road", np.array([[0.0, y], [100.0, y]]), 100.0, y) for y in (-3.5, 0.0)]
RULES = Rules()
STRATEGIC = int(LaneChange.STRATEGIC | LaneChange.LEFT)


def buffered_step(index: int, lane: dict[int, int], leader: dict[int, int], v: float = 10.0) -> BufferedStep:
    """Vehicles by number with their lane and leader."""
    values = np.zeros((len(lane), len(COLUMNS)))
    values[:, COLUMN["lane"]] = list(lane.values())
    values[:, COLUMN["leader"]] = [leader.get(number, NO_VEHICLE) for number in lane]
    values[:, COLUMN["v"]] = v
    ids = [f"a.{number}" for number in lane]
    leaders = [f"a.{leader[number]}" if number in leader else "" for number in lane]
    return BufferedStep(index, 0.2 * index, ids, leaders, {number: row for row, number in enumerate(lane)}, values, [])


def test_numbers_say_flow_and_vehicle():
    numbers = VehicleNumbers(["through", "on.ramp"])
    assert [numbers[name] for name in ("through.7", "on.ramp.12", "")] == [7, 1_000_012, NO_VEHICLE]


def test_a_chain_keeps_its_order_and_lane_all_through():
    lane, leader = {0: 0, 1: 0, 2: 0, 3: 1}, {0: 1, 1: 2}
    counts: Counter[str] = Counter()
    assert following_chains([buffered_step(k, lane, leader) for k in range(4)], LANES, counts, 3) == [(0, 1, 2)]
    assert not counts["leader or lane changes"]
    other = buffered_step(2, lane, {0: 2, 1: 2})
    assert (
        following_chains([buffered_step(0, lane, leader), buffered_step(1, lane, leader), other], LANES, counts, 3)
        == []
    )
    assert counts["leader or lane changes"] == 1
    over = buffered_step(1, lane | {0: 1}, leader)
    assert following_chains([buffered_step(0, lane, leader), over], LANES, counts, 3) == []


@pytest.mark.parametrize(("size", "chains"), [(2, 4), (3, 3), (4, 2), (5, 1), (6, 0)])
def test_chains_have_as_many_vehicles_as_wanted(size, chains):
    """Five vehicles one behind the other; the first one ahead has no leader."""
    lane, leader = dict.fromkeys(range(5), 0), {k: k + 1 for k in range(4)}
    found = following_chains([buffered_step(k, lane, leader) for k in range(3)], LANES, Counter(), size)
    assert found == [tuple(range(k, k + size)) for k in range(chains)]


def test_a_leader_in_another_lane_makes_no_chain():
    assert (
        following_chains([buffered_step(k, {0: 0, 1: 0, 2: 1}, {0: 1, 1: 2}) for k in range(3)], LANES, Counter(), 3)
        == []
    )


def test_vehicles_that_are_missing_in_a_step_have_no_rows():
    both = [buffered_step(0, {5: 0, 6: 0}, {}), buffered_step(1, {6: 0, 5: 0}, {})]
    rows = rows_at_every_step(both, [6, 5])
    assert rows is not None
    assert rows.tolist() == [[1, 0], [0, 1]]
    assert rows_at_every_step([*both, buffered_step(2, {5: 0}, {})], [6, 5]) is None


def section(lanes: list[Lane]) -> RoadSection:
    found = object.__new__(RoadSection)
    found.lanes, found.centres = lanes, [lane.centre for lane in lanes]
    found.names, found.road = ["road_0", "road_1"], RoadFrame(np.array([[0.0, 0.0], [500.0, 0.0]]), 0.0)
    return found


def lined_up(lane: dict[int, int], leader: dict[int, int], places: dict[int, float]) -> list[BufferedStep]:
    steps = [buffered_step(k, lane, leader) for k in range(4)]
    for step in steps:
        step.values[:, COLUMN["position"]] = [places[number] for number in lane]
    return steps


def test_triples_are_sorted_by_the_graph_that_leaders_suggest():
    long = [Lane("road", np.array([[0.0, y], [500.0, y]]), 500.0, y) for y in (-3.5, 0.0)]
    places = {0: 0.0, 1: 30.0, 2: 60.0, 3: 90.0, 5: 14.0, 6: 74.0}
    steps = lined_up({0: 0, 1: 0, 2: 0, 3: 0, 5: 1, 6: 1}, {0: 1, 1: 2, 2: 3, 5: 6}, places)
    found = triples(steps, section(long), RULES)
    assert found["0 follows 1, 1 follows 2"] == [(0, 1, 2), (1, 2, 3)]
    assert found["0 follows 2"] == [(0, 5, 1), (2, 6, 3), (5, 1, 6)]  # vehicles 5 and 6 drive in the lane beside
    assert (0, 2, 3) in found["1 follows 2"]  # vehicle 1 is between 0 and 2
    assert (0, 5, 6) in found["1 follows 2"]
    assert (0, 1, 3) in found["0 follows 1"]
    assert (0, 5, 2) in found["nobody follows"]
    for trios in found.values():
        assert all(places[a] + 7 <= places[b] and places[b] + 7 <= places[c] for a, b, c in trios)


def test_vehicles_that_change_lanes_or_leave_are_in_no_triple():
    long = [Lane("road", np.array([[0.0, y], [500.0, y]]), 500.0, y) for y in (-3.5, 0.0)]
    steps = lined_up({0: 0, 1: 0, 2: 0}, {0: 1, 1: 2}, {0: 0.0, 1: 30.0, 2: 60.0})
    assert triples(steps, section(long), RULES)["0 follows 1, 1 follows 2"] == [(0, 1, 2)]
    steps[2].values[1, COLUMN["lane"]] = 1
    assert not any(triples(steps, section(long), RULES).values())


def merge(steps: list[BufferedStep], rules: Rules = RULES, behind: str = "a.1", state: int = STRATEGIC):
    counts: Counter[str] = Counter()
    change = LaneChangeEvent("a.0", 0, 1, state, behind)
    return merge_window(change, steps, VehicleNumbers(["a"]), rules, counts), counts


def before(count: int, **options: float) -> list[BufferedStep]:
    there = [buffered_step(k, {0: 0, 1: 1, 2: 1}, {1: 2}, **options) for k in range(count)]
    return [*there, buffered_step(count, {0: 1, 1: 1, 2: 1}, {0: 2, 1: 0}, **options)]


def test_a_merge_is_cut_so_that_it_happens_in_the_middle():
    assert merge(before(30))[0] == Window("merge", (0, 1, 2), 10)


def test_a_jitter_moves_the_lane_change_within_the_window():
    rules, begins = Rules(jitter=2.4), set()
    for seed in range(40):
        change = LaneChangeEvent("a.0", 0, 1, STRATEGIC, "a.1")
        window = merge_window(change, before(40), VehicleNumbers(["a"]), rules, Counter(), seed)
        assert window == merge_window(change, before(40), VehicleNumbers(["a"]), rules, Counter(), seed)
        assert window is not None
        begins.add(window.begin)
    assert len(begins) > 15
    assert 8 <= min(begins) < 14
    assert 26 < max(begins) <= 32, "at least 8 steps are before the lane change"


def test_the_window_of_a_late_vehicle_begins_when_it_appears():
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
