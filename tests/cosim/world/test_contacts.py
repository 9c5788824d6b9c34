"""Contacts on hand-made traffic: which vehicle drove into which, how fast, and until when they count."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.spec.scenario import AFTERMATH
from cosim.world.contacts import SAME_PLACE, contacts_of, touching_pairs
from cosim.world.episode import CUTTER, Contact, Ending, Outcome
from tests.cosim.world.traffic import LANE, episode, snapshot

NAMES = {"a": "0", "b": "1", "c": "2"}


def found(*trace, end=100.0, names=NAMES) -> tuple[Contact, ...]:
    [contacts] = contacts_of(trace, [names], [end])
    return contacts


def test_the_rear_vehicle_drove_into_the_other_at_the_difference_of_speeds():
    [contact] = found(snapshot(1.0, a=(16.0, 0.0, 12.0), b=(20.0, 0.0, 9.0), c=(60.0, 0.0)))
    assert (contact.vehicles, contact.who, contact.time) == (("a", "b"), "0→1", 1.0)
    assert contact.speed_difference == pytest.approx(3.0)


def test_vehicles_in_one_place_of_the_plane_but_far_apart_along_the_road_are_on_different_levels():
    """5 m long each: 60 m apart along the road may still be a bend, more is a bridge. x is in their place, too."""
    now = snapshot(1.0, a=(20.0, 0.0), b=(20.0, 0.0), x=(20.0, 0.0))
    for apart, pairs in ((10.0 + SAME_PLACE, 6), (10.1 + SAME_PLACE, 2)):
        bridge = replace(now, s=np.array([20.0, 20.0 + apart, 20.0]))
        hits = touching_pairs(bridge, np.arange(3))
        assert len(hits) == pairs
        assert {(0, 2), (2, 0)} <= {tuple(hit) for hit in hits.tolist()}
        assert len(found(bridge)) == pairs / 2


def test_a_vehicle_that_has_just_appeared_may_touch():
    before, now = snapshot(0.8, a=(16.0, 0.0)), snapshot(1.0, a=(16.0, 0.0), b=(20.0, 0.0))
    assert [contact.who for contact in found(before, now)] == ["0→1"]


def test_a_contact_one_step_after_the_hand_back_is_after_it():
    [contact] = found(snapshot(3.2, a=(16.0, 0.0), b=(20.0, 0.0)), end=3.0)
    assert contact.after_hand_back


def test_a_contact_from_behind_names_the_outsider_first():
    [contact] = found(snapshot(1.0, a=(16.0, 0.0, 0.0), b=(60.0, 0.0), c=(80.0, 0.0), x=(12.0, 0.5, 9.0)))
    assert (contact.who, contact.vehicles) == ("other→0", ("x", "a"))
    assert contact.speed_difference == pytest.approx(9.0)


def test_a_vehicle_that_passes_the_others_front_within_a_step_still_came_from_behind():
    before = snapshot(0.8, a=(14.0, 0.0, 40.0), b=(20.0, 0.0), c=(60.0, 0.0))
    now = snapshot(1.0, a=(22.0, 0.0, 40.0), b=(21.0, 0.0), c=(60.0, 0.0))
    assert [contact.who for contact in found(before, now)] == ["0→1"]


def test_only_the_first_moment_of_a_pair_counts_and_boxes_beside_each_other_do_not_touch():
    apart = snapshot(0.8, a=(20.0, LANE), b=(20.0, 0.0), c=(60.0, 0.0))
    near = snapshot(1.0, a=(20.0, 1.75), b=(21.0, 0.0), c=(60.0, 0.0))
    nearer = snapshot(1.2, a=(20.0, 1.0), b=(21.0, 0.0), c=(60.0, 0.0))
    assert [contact.time for contact in found(apart, near, nearer, nearer)] == [1.0]
    assert found(apart) == ()


def test_contacts_count_until_the_end_of_the_aftermath():
    crash = {"a": (16.0, 0.0), "b": (20.0, 0.0)}
    [late] = found(snapshot(3.0 + AFTERMATH, **crash), end=3.0)
    assert late.after_hand_back
    assert found(snapshot(3.2 + AFTERMATH, **crash), end=3.0) == ()
    [during] = found(snapshot(3.0, **crash), end=3.0)
    assert not during.after_hand_back


def test_every_member_is_watched_but_an_undriven_one_hit_by_an_outsider_does_not_count():
    contacts = found(snapshot(1.0, a=(0.0, 0.0), b=(20.0, 0.0), c=(60.0, 0.0), x=(63.0, 0.0)))
    assert [contact.who for contact in contacts] == ["2→other"]
    whole = episode(Ending.HORIZON, 2.0, contacts=contacts)
    assert (whole.counted_contacts, whole.outcome) == ((), Outcome(contact=False, completed=True, order_kept=True))
    members = found(snapshot(1.0, a=(0.0, 0.0), b=(57.0, 0.0), c=(60.0, 0.0)))
    only_0 = episode(Ending.HORIZON, 2.0, contacts=members, judged_roles=(0,))
    assert [contact.who for contact in members] == ["1→2"]
    assert only_0.outcome.contact, "two members touched each other"


def test_a_neighbour_that_was_made_to_cut_in_has_a_name_and_is_no_member():
    now = snapshot(1.0, a=(0.0, 0.0), b=(20.0, 0.0), c=(60.0, 0.0), y=(23.0, 0.0), x=(26.0, 0.0))
    [contact] = found(now, names=NAMES | {"y": CUTTER})
    assert contact.who == f"1→{CUTTER}"


def test_groups_are_outsiders_to_each_other():
    now = snapshot(1.0, a=(0.0, 0.0), b=(20.0, 0.0), c=(40.0, 0.0), k=(37.0, 0.0), l=(80.0, 0.0), m=(90.0, 0.0))
    first, second = contacts_of([now], [NAMES, {"k": "0", "l": "1", "m": "2"}], [2.0, 2.0])
    assert [contact.who for contact in (*first, *second)] == ["other→2", "0→other"]


def test_a_contact_of_one_group_is_none_of_another():
    now = snapshot(1.0, a=(0.0, 0.0), b=(3.0, 0.0), c=(40.0, 0.0), k=(60.0, 0.0), l=(80.0, 0.0), m=(90.0, 0.0))
    first, second = contacts_of([now], [NAMES, {"k": "0", "l": "1", "m": "2"}], [2.0, 2.0])
    assert [contact.who for contact in first] == ["0→1"]
    assert second == ()


def test_completed_with_a_contact_after_the_hand_back():
    contacts = found(snapshot(4.0, a=(16.0, 0.0), b=(20.0, 0.0), c=(60.0, 0.0)), end=3.0)
    after = episode(Ending.HORIZON, 3.0, last=8.0, contacts=contacts)
    assert after.outcome == Outcome(contact=True, completed=True, order_kept=True)
    assert after.judged_after == pytest.approx(5.0), "the watch is shorter than the aftermath"
