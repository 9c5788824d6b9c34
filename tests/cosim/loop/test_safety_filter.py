"""The safety filter: how far it lets a vehicle go, and where it stops lateral motion."""

import numpy as np
import pytest

from cosim.loop.limits import FilterRecord, Limited, Limits, planned_across, within
from cosim.loop.safety_filter import LANE_CHANGE, SafetyFilter
from cosim.loop.state_layouts import LongitudinalLayout, PlanarLayout
from cosim.spec.scenario import RssFilter
from cosim.world.groups import MergeLanes
from cosim.world.road_frame import RoadFrame
from cosim.world.snapshot import LaneStrip
from gri.core.dynamics import DUBINS
from tests.cosim.loop.near import near

DT = 0.2
# The lane of vehicle 0 ends at s = 300 m; the target lane is on its left.
LANES = MergeLanes(LaneStrip("source", -500.0, 300.0, 0.0, 3.5), LaneStrip("target", -500.0, 2000.0, 3.5, 3.5))


def limits(*vehicles, planned: float = 0.0, a: float = 0.0) -> tuple[float, float]:
    """The greatest acceleration of vehicle 0, and the place to which it is steered (NaN where the policy steers)."""
    found = SafetyFilter(RssFilter(), DT).limits(near(*vehicles, a=a), np.array([[planned, 0.0, 0.0]]))
    return float(found.along[0, 0]), float(found.place[0, 0])


def merging(own, *others, planned: float = 0.0, steps: int = 1, **rss) -> tuple[float, float, float]:
    """Greatest and least acceleration of vehicle 0 on the lane that ends, and its place, after some equal steps."""
    safety = SafetyFilter(RssFilter(**rss), DT, LANES)
    for _ in range(steps):
        found = safety.limits(near(own, *others), np.array([[planned, 0.0, 0.0]]))
    return float(found.along[0, 0]), float(found.least[0, 0]), float(found.place[0, 0])


def planar(side: int = 1) -> PlanarLayout:
    """The layout of one group whose target lane is at d = 0."""
    road = RoadFrame(np.array([[0.0, 0.0], [1000.0, 0.0]]))
    return PlanarLayout(np.zeros((1, 3)), np.zeros((1, 1)), road, side)


@pytest.mark.parametrize(("v", "gap", "v_ahead"), [(15.0, 40.0, 0.0), (15.0, 12.0, 15.0), (25.0, 40.0, 20.0)])
def test_a_vehicle_at_the_limit_stops_behind_one_that_brakes_hardest(v, gap, v_ahead):
    """The vehicle follows the limit in every step while the other brakes with 8 m/s²; a safe start stays safe."""
    own, other, a, least = [0.0, v], [gap + 5.0, v_ahead], 0.0, np.inf
    assert limits((0.0, 0.0, v, 0.0), (gap + 5.0, 0.0, v_ahead, 0.0))[0] > -8.0
    for _ in range(40):
        along, _ = limits((own[0], 0.0, own[1], 0.0), (other[0], 0.0, other[1], 0.0), a=a)
        own = [own[0] + own[1] * DT, max(own[1] + a * DT, 0.0)]
        a = min(along, 1.5)
        braked = max(other[1] - 8.0 * DT, 0.0)
        other = [other[0] + 0.5 * (other[1] + braked) * DT, braked]
        least = min(least, other[0] - 5.0 - own[0])
    assert 0.0 < least < 6.0


def test_a_vehicle_far_ahead_or_in_the_next_lane_is_no_limit_for_what_a_policy_does():
    assert limits((0.0, 0.0, 15.0, 0.0), (100.0, 0.0, 15.0, 0.0))[0] > 5.0
    assert limits((0.0, 0.0, 15.0, 0.0), (12.0, 3.5, 5.0, 0.0))[0] > 5.0
    assert limits((0.0, 0.0, 15.0, 0.0), (-12.0, 0.0, 30.0, 0.0))[0] > 5.0


def test_a_vehicle_that_moves_into_the_lane_counts_before_it_is_there_but_with_comfortable_braking():
    assert limits((0.0, 0.0, 15.0, 0.0), (12.0, 2.5, 5.0, -1.0))[0] == pytest.approx(-4.0)
    assert limits((0.0, 0.0, 15.0, 0.0), (12.0, 2.5, 5.0, 1.0))[0] > 5.0


@pytest.mark.parametrize(
    ("other", "free"),
    [
        ((1.0, 3.5, 15.0, 0.0), False),  # beside
        ((9.0, 3.5, 10.0, 0.0), False),  # 4 m ahead and 5 m/s slower
        ((-9.0, 3.5, 25.0, 0.0), False),  # 4 m behind and 10 m/s faster
        ((60.0, 3.5, 15.0, 0.0), True),
        ((-60.0, 3.5, 15.0, 0.0), True),
        ((1.0, 7.0, 15.0, 0.0), True),  # two lanes away
        ((1.0, -3.5, 15.0, 0.0), True),  # on the other side
    ],
)
def test_lateral_motion_stops_before_an_occupied_place(other, free):
    place = limits((0.0, 0.0, 15.0, 0.0), other, planned=1.2)[1]
    assert np.isnan(place) == free
    assert np.isnan(limits((0.0, 0.0, 15.0, 0.0), other)[1]), "without lateral motion there is nothing to stop"


def test_a_vehicle_that_is_too_close_across_the_road_is_left():
    assert limits((0.0, 0.0, 15.0, 0.2), (0.0, 2.2, 15.0, 0.0), planned=0.5)[1] == pytest.approx(-0.2)


def test_a_vehicle_that_may_not_move_over_returns_to_its_lane_and_stays_on_the_road():
    beside = (2.0, 3.5, 15.0, 0.0)
    assert merging((0.0, 0.9, 15.0, 0.8), beside, planned=0.8)[2] == LANES.source.centre
    assert np.isnan(merging((0.0, 0.9, 15.0, 0.8), planned=0.8)[2]), "without others the policy steers"
    assert merging((0.0, -0.5, 15.0, -0.8), planned=-0.8)[2] == LANES.source.centre, "to the right is no road"
    assert merging((0.0, 4.0, 15.0, 0.8), planned=0.8)[2] == LANES.target.centre, "not beyond the target lane"


def test_a_steered_vehicle_is_the_policys_again_when_it_drives_straight_on():
    safety, beside = SafetyFilter(RssFilter(), DT, LANES), (2.0, 3.5, 15.0, 0.0)
    wants, not_any_more = np.array([[0.8, 0.0, 0.0]]), np.zeros((1, 3))
    assert safety.limits(near((0.0, 0.9, 15.0, 0.8), beside), wants).place[0, 0] == LANES.source.centre
    assert safety.limits(near((3.0, 0.9, 15.0, -0.5), beside), not_any_more).place[0, 0] == LANES.source.centre
    assert np.isnan(safety.limits(near((6.0, 0.2, 15.0, -0.1), beside), not_any_more).place[0, 0])


def test_a_vehicle_that_cannot_move_over_stops_where_it_still_could():
    v, s = 15.0, 200.0
    a = 0.0
    for _ in range(300):
        along = (
            SafetyFilter(RssFilter(), DT, LANES)
            .limits(near((s, 0.0, v, 0.0), (s - 4, 3.5, v, 0.0), a=a), np.zeros((1, 3)))
            .along[0, 0]
        )
        s, v, a = s + v * DT, max(v + a * DT, 0.0), min(along, 1.0)
    assert v < 0.01
    assert abs(LANES.source.end - LANE_CHANGE - s) < 0.5
    assert merging((260.0, 0.0, 15.0, 0.0))[0] < 5.0
    assert merging((260.0, 0.0, 15.0, 0.0), merge_within=0.0)[0] > 100.0, "without help the policy decides"


def test_the_filter_moves_over_where_the_policy_hesitates_and_there_is_room():
    own = (230.0, 0.0, 12.0, 0.0)
    assert np.isnan(merging(own, steps=5)[2]), "the policy has its chance"
    assert merging(own, steps=15)[2] == LANES.target.centre
    assert np.isnan(merging(own, (228.0, 3.5, 12.0, 0.0), steps=15)[2]), "somebody is there"
    assert np.isnan(merging(own, steps=15, merge_within=0.0)[2]), "no help is asked for"
    assert np.isnan(merging((0.0, 0.0, 12.0, 0.0), steps=15)[2]), "the lane does not end yet"
    assert np.isnan(merging(own, planned=0.6, steps=15)[2]), "the policy moves over itself"


def test_vehicles_make_room_for_a_merge():
    ahead, behind = (232.0, 3.5, 12.0, 0.0), (225.0, 3.5, 12.0, 0.0)
    assert merging((230.0, 0.0, 12.0, 0.0), ahead)[0] == -2.0, "it falls behind who is farther ahead"
    along, least, _ = merging((230.0, 0.0, 2.0, 0.0), behind)
    assert along > 0
    assert least == 1.5, "others wait for it"
    found = near((230.0, 0.0, 12.0, 0.0), members=((222.0, 3.5, 12.0, 0.0), (280.0, 3.5, 12.0, 0.0)))
    lets_in = SafetyFilter(RssFilter(), DT, LANES).limits(found, np.zeros((1, 3))).along[0, 1]
    assert lets_in == -2.0, "the lag vehicle lets it in"


def test_limits_change_only_what_exceeds_them():
    state, layout = np.zeros((1, 3, 3)), LongitudinalLayout(np.zeros((1, 3)), np.zeros((1, 3)))
    state[..., 1], action = 10.0, np.full((1, 3, 1), 5.0)  # the acceleration of the next step is 1 m/s²
    every, none = np.ones((1, 3)), np.full((1, 3), np.nan)
    assert (within(Limits(2 * every, none, -every), state, action, layout, DT).action == action).all()
    limited = within(Limits(-3 * every, 0 * every, -np.inf * every), state, action, layout, DT)
    assert limited.action[0, 0, 0] * DT == pytest.approx(-3.0)
    assert limited.changed[0].tolist() == pytest.approx([4.0] * 3)
    assert not limited.steered.any(), "a vehicle in one lane does not steer"
    raised = within(Limits(9 * every, none, 1.5 * every), state, action, layout, DT)
    assert raised.action[0, 0, 0] * DT == pytest.approx(1.5)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("v", [3.0, 12.0, 30.0])
def test_steering_to_a_place_does_not_swing(side, v):
    state, layout = np.zeros((1, 3, 6)), planar(side)
    state[..., 1], state[..., 2], state[..., 3] = -2.0, v, min(0.1, 1.2 / v)  # y, v, and the heading to the target lane
    limit, path = Limits(np.full((1, 3), np.inf), np.full((1, 3), side * -3.5), np.full((1, 3), -np.inf)), []
    for _ in range(60):
        action = within(limit, state, np.zeros((1, 3, 2)), layout, DT).action
        state = DUBINS.step(state, action, DT)
        path.append(state[0, 0, 1])
    assert max(path) < -0.2, "it turns around within less than a lane"
    assert path[-1] == pytest.approx(-3.5, abs=0.1)
    assert min(path) > -3.75, "and does not overshoot"
    assert np.abs(planned_across(state, np.zeros((1, 3, 2)), layout, DT)).max() < 0.05


@pytest.mark.parametrize("size", [2, 3, 5])
def test_groups_of_any_size_are_filtered(size):
    found = near((0.0, 0.0, 15.0, 0.0), (8.0, 0.0, 5.0, 0.0), members=((-50.0, 0.0, 10.0, 0.0),) * (size - 1))
    along = SafetyFilter(RssFilter(), DT).limits(found, np.zeros((1, size))).along
    assert along.shape == (1, size)
    assert along[0, 0] == pytest.approx(-8.0)


def test_the_use_counts_steps_of_driven_vehicles_up_to_the_end():
    record, none = FilterRecord(), np.zeros((1, 3), dtype=bool)
    for time, changed in ((0.0, [2.0, 0.0, 9.0]), (0.2, [0.0, 0.0, 9.0]), (0.4, [5.0, 5.0, 9.0])):
        record.add(time, Limited(np.zeros((1, 3, 1)), np.array([changed]), none))
    use = record.of(0, [0, 1], end=0.4)
    assert (use.along, use.across, use.hardest) == (0.25, 0.0, 2.0)


@pytest.mark.parametrize(("leader", "yields"), [(-4.0, True), (-4.9, True), (-5.1, False)])
def test_a_vehicle_falls_behind_the_leader_that_is_beside_it(leader, yields):
    """Both drive at 4 m/s, 80 m before the end of the lane. Once vehicle 0 has passed the leader, it goes ahead."""
    lag, beside = (180.0, 3.5, 4.0, 0.0), (220.0 + leader, 3.5, 4.0, 0.0)
    safety = SafetyFilter(RssFilter(), DT, LANES)
    found = safety.limits(near((220.0, 0.0, 4.0, 0.0), members=(lag, beside)), np.zeros((1, 3)))
    if yields:
        assert found.along[0, 0] == pytest.approx(-2.0)
        assert np.isinf(found.least[0, 0])
    else:
        assert found.least[0, 0] == pytest.approx(1.5)


@pytest.mark.parametrize(("v", "held"), [(6.0, True), (1.0, False)])
@pytest.mark.parametrize("s", [-9.0, 9.0])
def test_a_rear_does_not_swing_into_a_vehicle_that_will_be_beside_it_soon(s, v, held):
    """4 m behind or ahead, 1 m to the left; it is beside the vehicle within a second, or stays where it is."""
    own, other = (1.0, v) if s < 0 else (v, 1.0)
    found = SafetyFilter(RssFilter(), DT).limits(near((0.0, 0.0, own, 0.0), (s, 3.0, other, 0.0)), np.zeros((1, 3)))
    assert found.turned is not None
    assert found.turned[1][0, 0] == pytest.approx(np.arcsin(0.9 / 5.0) if held else np.pi / 2)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("steers", ["policy", "filter"])
def test_a_rear_does_not_swing_into_a_vehicle_beside_it(side, steers):
    """1 m is free on the left of a slow vehicle, 5 m long, that turns to the right as hard as it can."""
    found = SafetyFilter(RssFilter(), DT).limits(near((0.0, 0.0, 1.0, 0.0), (-3.0, 3.0, 1.0, 0.0)), np.zeros((1, 3)))
    assert found.turned is not None
    left, right = found.turned
    assert right[0, 0] == pytest.approx(np.arcsin(0.9 / 5.0))  # 0.1 m are kept
    assert left[0, 0] == pytest.approx(np.pi / 2)
    layout, state = planar(side), np.zeros((1, 3, 6))
    state[..., DUBINS.index("v")] = 1.0
    place = np.full((1, 3), np.nan if steers == "policy" else -20.0)
    limit = Limits(found.along, place, found.least, found.turned)
    action = np.stack([np.zeros((1, 3)), np.full((1, 3), -side * 2.0)], -1)
    for _ in range(20):
        limited = within(limit, state, action, layout, DT)
        state = DUBINS.step(state, limited.action, DT)
        heading = side * state[0, 0, DUBINS.index("heading")]
        assert heading >= -right[0, 0] - 1e-9
        assert heading <= 1e-9
    assert heading == pytest.approx(-right[0, 0], abs=0.02), "it is not held back more than it has to be"
    free = Limits(found.along, place, found.least)
    for _ in range(20):
        state = DUBINS.step(state, within(free, state, action, layout, DT).action, DT)
    assert side * state[0, 0, DUBINS.index("heading")] < -right[0, 0] - 0.01
