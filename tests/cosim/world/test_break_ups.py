"""The cause that broke up a group, on hand-made traffic: the group a, b, c in one lane, x beside it."""

import pytest

from cosim.spec.scenario import AFTERMATH
from cosim.world.break_ups import NEAR_GROUP, SAME_TIME, compared, lane_entries, with_cause
from cosim.world.episode import BrokenUpBy, Contact, Ending, LaneEntry
from cosim.world.groups import SAME_LANE
from tests.cosim.world.traffic import LANE, episode, snapshot

CHAIN = {"a": (0.0, 0.0), "b": (20.0, 0.0), "c": (40.0, 0.0)}
START = snapshot(0.0, **CHAIN, x=(30.0, LANE))
MERGE = (1, 0, 2)


def judged(ending: Ending, *trace, takeover=START, members=("a", "b", "c"), **changes):
    """The episode with its cause, and its lane entries."""
    end = trace[-1].time
    [entries] = lane_entries(takeover, trace, [members], [end])
    return with_cause(episode(ending, end, lane_entries=entries, **changes), members, takeover, trace)


def cut_in(at: float, vehicle: str = "x"):
    """A vehicle changes into the gap between b and c."""
    takeover = snapshot(0.0, **CHAIN, **{vehicle: (30.0, LANE)})
    trace = [snapshot(at - 0.2, **CHAIN, **{vehicle: (30.0, LANE)}), snapshot(at, **CHAIN, **{vehicle: (30.0, 0.0)})]
    return judged(Ending.CUT_IN, *trace, takeover=takeover)


def test_a_driven_vehicle_that_leaves_its_lane_is_the_policys_doing():
    left = judged(Ending.LANE_LEFT, snapshot(0.2, **CHAIN | {"b": (20.0, -LANE)}))
    assert left.broken_up_by is BrokenUpBy.POLICY
    counterpart = judged(Ending.LANE_LEFT, snapshot(0.2, **CHAIN | {"b": (20.0, -LANE)}))
    assert compared(left, counterpart).broken_up_by is BrokenUpBy.POLICY, "whatever SUMO's drivers do"


def test_an_undriven_vehicle_that_leaves_its_lane_is_not():
    left = snapshot(0.2, **CHAIN | {"c": (40.0, -LANE)})
    assert judged(Ending.LANE_LEFT, left).broken_up_by is BrokenUpBy.OTHERS
    assert judged(Ending.LANE_LEFT, left, judged_roles=(0,)).broken_up_by is BrokenUpBy.OTHERS
    b_left = snapshot(0.2, **CHAIN | {"b": (20.0, LANE)})
    assert judged(Ending.LANE_LEFT, b_left, judged_roles=(0,)).broken_up_by is BrokenUpBy.OTHERS


def test_a_policy_that_drifts_out_of_its_lane_step_by_step_is_not_hidden_behind_a_cut_in():
    """No step is a jump, so that the group ends when c is no longer the next vehicle ahead of b."""
    trace = [snapshot(0.2 * k, **CHAIN | {"b": (20.0, 0.3 * k)}) for k in range(1, 5)]
    assert judged(Ending.CUT_IN, *trace).broken_up_by is BrokenUpBy.POLICY
    trace = [snapshot(0.2 * k, **CHAIN | {"c": (40.0, 0.3 * k)}) for k in range(1, 5)]
    assert judged(Ending.CUT_IN, *trace).broken_up_by is BrokenUpBy.OTHERS


def test_a_lag_vehicle_that_drifts_out_of_the_target_lane():
    takeover = snapshot(0.0, a=(10.0, -LANE), b=(0.0, 0.0), c=(40.0, 0.0))
    trace = [snapshot(0.2 * k, a=(10.0, -LANE), b=(0.0, 0.4 * k), c=(40.0, 0.0)) for k in range(1, 6)]
    found = judged(Ending.LANE_LEFT, *trace, takeover=takeover, order=MERGE)
    assert found.broken_up_by is BrokenUpBy.POLICY


def test_every_vehicle_of_a_platoon_has_to_keep_the_lane_and_in_a_merge_only_the_two_in_it():
    """Vehicle a, which is last in the platoon, and merges between the others in a merge."""
    left = snapshot(0.2, **CHAIN | {"a": (0.0, LANE)})
    assert judged(Ending.LANE_LEFT, left).broken_up_by is BrokenUpBy.POLICY
    assert judged(Ending.LANE_LEFT, left, order=MERGE).broken_up_by is BrokenUpBy.UNKNOWN, "nobody left its lane"


def test_a_jump_to_the_side_is_more_than_one_metre():
    for moved, cause in ((SAME_LANE, BrokenUpBy.UNKNOWN), (SAME_LANE + 0.125, BrokenUpBy.POLICY)):
        jump = snapshot(0.2, **CHAIN | {"b": (20.0, moved)})
        assert judged(Ending.LANE_LEFT, jump).broken_up_by is cause
        drift = snapshot(0.1, **CHAIN | {"b": (20.0, 0.5 * moved)})
        assert judged(Ending.LANE_LEFT, drift, jump).broken_up_by is cause
    drifted = snapshot(0.2, **CHAIN | {"b": (20.0, SAME_LANE)})
    assert judged(Ending.CUT_IN, drifted).broken_up_by is BrokenUpBy.POLICY, "no longer in the lane"


def test_the_cause_is_read_at_the_end_of_the_drive_whatever_comes_later():
    """At 0.4 s c leaves the lane; b does so after the hand-back."""
    trace = [
        snapshot(0.2, **CHAIN),
        snapshot(0.4, **CHAIN | {"c": (40.0, LANE)}),
        snapshot(0.6, **CHAIN | {"b": (20.0, LANE)}),
    ]
    for end in (0.4, 0.4 + 5e-7, 0.4 - 5e-7):
        cause = with_cause(episode(Ending.LANE_LEFT, end), ("a", "b", "c"), START, trace).broken_up_by
        assert cause is BrokenUpBy.OTHERS
    beyond = with_cause(episode(Ending.LANE_LEFT, 9.0), ("a", "b", "c"), START, trace)
    assert beyond.broken_up_by is BrokenUpBy.POLICY, "the last snapshot, where the drive ended after it"


def test_a_vehicle_that_is_not_there_has_not_moved_sideways():
    """c vanished, and b came back from nowhere: nobody is seen to leave the lane."""
    takeover = snapshot(0.0, a=(0.0, 10.0), b=(20.0, 10.0), c=(40.0, 10.0))
    gone = snapshot(0.2, a=(0.0, 10.0), b=(20.0, 10.0))
    assert judged(Ending.LANE_LEFT, gone, takeover=takeover).broken_up_by is BrokenUpBy.UNKNOWN
    back = snapshot(0.4, a=(0.0, 10.0), b=(20.0, 10.0), c=(40.0, 10.0))
    assert judged(Ending.LANE_LEFT, gone, back, takeover=takeover).broken_up_by is BrokenUpBy.UNKNOWN


def test_only_outsiders_between_the_members_and_in_their_lane_cut_in():
    """x came into the lane 1 s before the end; where it drives then decides whether it is the intruder."""
    for s, d, cause in (
        (30.0, 0.0, BrokenUpBy.UNKNOWN),
        (0.0, 0.0, None),  # beside the last one
        (40.0, 0.0, None),  # beside the first one
        (-10.0, 0.0, None),
        (50.0, 0.0, None),
        (30.0, SAME_LANE, None),
        (30.0, LANE, None),
    ):
        trace = [
            snapshot(0.2, **CHAIN, x=(30.0, LANE)),
            snapshot(0.4, **CHAIN, x=(30.0, 0.0)),
            snapshot(1.4, **CHAIN, x=(s, d)),
        ]
        found = judged(Ending.CUT_IN, *trace)
        assert [entry.vehicle for entry in found.intruders] == (["x"] if cause else [])
        assert found.broken_up_by is (cause or BrokenUpBy.UNKNOWN)


def test_an_outsider_that_came_into_the_lane_long_before_is_no_intruder():
    trace = [snapshot(0.2, **CHAIN, x=(30.0, 0.0)), snapshot(0.4 + SAME_TIME, **CHAIN, x=(30.0, 0.0))]
    assert judged(Ending.CUT_IN, *trace).intruders == ()
    assert judged(Ending.CUT_IN, trace[0], snapshot(0.2 + SAME_TIME, **CHAIN, x=(30.0, 0.0))).intruders != ()


def test_the_lane_of_a_group_is_where_vehicle_1_was_at_the_take_over():
    """c is 0.6 m to the left of b; x is 0.7 m to the right of b."""
    chain = CHAIN | {"c": (40.0, 0.6)}
    takeover = snapshot(0.0, **chain, x=(30.0, LANE))
    [entry] = judged(Ending.CUT_IN, snapshot(0.2, **chain, x=(30.0, -0.7)), takeover=takeover).intruders
    assert entry.vehicle == "x"


def test_a_member_that_vanishes_in_a_cut_in_did_not_drift():
    gone = {name: place for name, place in CHAIN.items() if name != "b"}
    assert judged(Ending.CUT_IN, snapshot(0.2, **gone)).broken_up_by is BrokenUpBy.UNKNOWN


def test_an_outsider_that_appears_between_the_members_was_passed_by_nobody():
    now = snapshot(0.2, **CHAIN, new=(30.0, 0.0))
    assert judged(Ending.CUT_IN, now).broken_up_by is BrokenUpBy.UNKNOWN


def test_a_vehicle_that_is_gone():
    assert judged(Ending.LOST, snapshot(0.2, b=(20.0, 0.0), c=(40.0, 0.0))).broken_up_by is BrokenUpBy.POLICY
    assert judged(Ending.LOST, snapshot(0.2, a=(0.0, 0.0), b=(20.0, 0.0))).broken_up_by is BrokenUpBy.OTHERS


def test_a_cut_in_is_unknown_until_the_counterpart_shows_it_too():
    branch = cut_in(at=4.0)
    assert branch.intruders == (LaneEntry("x", 4.0),)
    assert branch.broken_up_by is BrokenUpBy.UNKNOWN
    assert compared(branch, cut_in(at=4.0 + SAME_TIME)).broken_up_by is BrokenUpBy.OTHERS
    assert compared(branch, cut_in(at=5.2 + SAME_TIME)).broken_up_by is BrokenUpBy.UNKNOWN, "too late to be the same"
    assert compared(branch, cut_in(at=4.0, vehicle="y")).broken_up_by is BrokenUpBy.UNKNOWN, "another vehicle"
    assert compared(branch, cut_in(at=4.2 + SAME_TIME)).broken_up_by is BrokenUpBy.UNKNOWN
    undisturbed = judged(Ending.HORIZON, snapshot(4.0, **CHAIN, x=(30.0, LANE)))
    assert compared(branch, undisturbed).broken_up_by is BrokenUpBy.UNKNOWN
    assert compared(branch, branch).broken_up_by is BrokenUpBy.OTHERS, "a counterpart is its own counterpart"


def test_the_counterpart_counts_the_same_lane_change_also_where_it_is_no_cut_in():
    """The counterpart is elsewhere along the road by then: x changes lane behind it."""
    ahead = {name: (s + 40.0, d) for name, (s, d) in CHAIN.items()}
    trace = [snapshot(3.8, **ahead, x=(30.0, LANE)), snapshot(4.0, **ahead, x=(30.0, 0.0))]
    assert compared(cut_in(at=4.0), judged(Ending.HORIZON, *trace)).broken_up_by is BrokenUpBy.OTHERS


def test_a_vehicle_that_falls_behind_an_outsider_that_kept_its_lane():
    """In a merge the lag vehicle b drops behind x, which was in the target lane behind it all the time."""
    takeover = snapshot(0.0, a=(10.0, -LANE), b=(20.0, 0.0), c=(40.0, 0.0), x=(12.0, 0.0))
    trace = [
        snapshot(0.2, a=(10.0, -LANE), b=(20.0, 0.6), c=(40.0, 0.0), x=(19.0, 0.0)),
        snapshot(0.4, a=(10.0, -LANE), b=(20.0, 0.6), c=(40.0, 0.0), x=(21.0, 0.0)),
    ]
    found = judged(Ending.CUT_IN, *trace, takeover=takeover, order=MERGE)
    assert (found.broken_up_by, found.intruders) == (BrokenUpBy.POLICY, ())
    assert judged(Ending.CUT_IN, *trace, takeover=takeover, order=MERGE, judged_roles=(0,)).broken_up_by is (
        BrokenUpBy.OTHERS
    )


def test_the_lane_change_of_the_merging_vehicle_breaks_up_nothing():
    """Vehicle a merges in the step in which c leaves its lane."""
    now = snapshot(0.2, a=(10.0, 0.0), b=(0.0, 0.0), c=(40.0, LANE))
    takeover = snapshot(0.0, a=(10.0, -LANE), b=(0.0, 0.0), c=(40.0, 0.0))
    assert judged(Ending.LANE_LEFT, now, takeover=takeover, order=MERGE).broken_up_by is BrokenUpBy.OTHERS


def test_a_contact_that_is_not_the_policys_is_a_break_up_by_others():
    contact = Contact(0.2, ("x", "b"), "other→1", 3.0, after_hand_back=False)
    crash = {"ending": Ending.CONTACT, "contacts": (contact,)}
    assert judged(*[crash["ending"], START], contacts=(contact,)).broken_up_by is BrokenUpBy.NOBODY
    undriven = judged(Ending.CONTACT, START, contacts=(contact,), judged_roles=(0,))
    assert undriven.broken_up_by is BrokenUpBy.OTHERS
    assert not undriven.outcome.contact


@pytest.mark.parametrize("ending", [Ending.HORIZON, Ending.MERGED, Ending.LATE, Ending.LANE_END, Ending.OFF_ROAD])
def test_other_endings_break_up_nothing(ending):
    assert judged(ending, snapshot(0.2, **CHAIN)).broken_up_by is BrokenUpBy.NOBODY


def test_lane_entries_by_hand_beside_the_axis_of_the_road():
    """The lane is at d = 10. x comes from 1 m beside it, which is outside; y reaches 1 m, which is not inside."""
    chain = {name: (s, 10.0) for name, (s, _) in CHAIN.items()}
    trace = [
        snapshot(0.2, x=(30.0, 10 + SAME_LANE), y=(30.0, 10 - LANE), new=(10.0, 10.0), **chain),
        snapshot(0.4, x=(30.0, 10.5), y=(30.0, 10 - SAME_LANE), new=(10.0, 10.0), late=(5.0, 10.0), **chain),
    ]
    takeover = snapshot(0.0, x=(30.0, 10 + LANE), y=(30.0, 10 - LANE), **chain)
    for members in (("a", "b", "c"), ("a", "b")):  # of two, vehicle 2 was removed
        assert lane_entries(takeover, trace, [members], ends=[0.4]) == [(LaneEntry("x", 0.4),)]


def test_lane_entries_reach_as_far_as_stated_behind_and_ahead_and_as_long():
    """Members at 0 to 40 m."""
    for s, counts in ((-NEAR_GROUP, 1), (-NEAR_GROUP - 0.5, 0), (40 + NEAR_GROUP, 1), (40.5 + NEAR_GROUP, 0)):
        takeover, now = snapshot(0.0, **CHAIN, x=(s, LANE)), snapshot(0.2, **CHAIN, x=(s, 0.0))
        assert len(lane_entries(takeover, [now], [("a", "b", "c")], ends=[0.2])[0]) == counts
    takeover, now = snapshot(0.0, **CHAIN, x=(30.0, LANE)), snapshot(0.2, **CHAIN, x=(30.0, 0.0))
    for end, counts in ((0.2 - AFTERMATH, 1), (0.1 - AFTERMATH, 0)):
        assert len(lane_entries(takeover, [now], [("a", "b", "c")], ends=[end])[0]) == counts


def test_without_snapshots_there_are_no_lane_entries():
    assert lane_entries(START, [], [("a", "b", "c")], ends=[1.0]) == [()]
    assert lane_entries(START, [snapshot(0.2)], [("a", "b", "c")], ends=[1.0]) == [()]


def test_lane_entries_are_changes_into_the_lane_near_the_group():
    trace = [
        snapshot(0.2, **CHAIN, x=(30.0, 2.0), far=(45.0 + NEAR_GROUP, LANE), new=(10.0, 0.0)),
        snapshot(0.4, **CHAIN, x=(30.0, 0.9), far=(45.0 + NEAR_GROUP, 0.0), new=(10.0, 0.0)),
        snapshot(0.6, **CHAIN, x=(30.0, 0.0), far=(45.0 + NEAR_GROUP, 0.0), new=(10.0, 0.0)),
    ]
    [found] = lane_entries(START, trace, [("a", "b", "c")], ends=[0.6])
    assert found == (LaneEntry("x", 0.4),), "neither far away, nor in the lane when it was first seen"
    assert lane_entries(START, trace, [("a", "b", "c")], ends=[-10.0]) == [()]
