"""The outcome in real traffic: policies that are bad on purpose, and SUMO's drivers as the negative control."""

import msgspec
import pandas as pd
import pytest

from cosim.world.episode import BrokenUpBy, Ending, EventKind
from cosim.world.outcome_columns import headline, outcome_columns
from gri.core.policy import ConstantVelocity, IntelligentDriver


class RunsInto(ConstantVelocity):
    """Full throttle, whatever is ahead."""

    def act(self, memory, state):
        return (8.0 - state[..., 2:3]) / self.dt, memory


class Stops(ConstantVelocity):
    """Stands still after two steps, which no driver behind it can do."""

    def act(self, memory, state):
        return (-200.0 - state[..., 2:3]) / self.dt, memory


@pytest.fixture
def scenario(short_scenario):
    return msgspec.structs.replace(short_scenario, episodes=4, watch=10.0)


def contacts(outcome):
    return [(episode, contact) for episode in outcome.episodes for contact in episode.contacts]


def test_a_policy_that_drives_into_the_leader(scenario, simulate):
    found = contacts(simulate(msgspec.structs.replace(scenario, horizon=8.0), RunsInto(0.2)))
    first = [(episode, contact) for episode, contact in found if contact is episode.contacts[0]]
    assert first
    for episode, contact in first:
        assert contact.who in ("0→1", "1→2")
        assert not contact.after_hand_back
        assert contact.speed_difference > 1.0
        assert episode.ending is Ending.CONTACT
        assert contact.time == episode.end
        assert not outcome_columns(episode)["completed_without_contact"]


def test_a_policy_that_brakes_to_a_standstill_is_hit_from_behind(scenario, simulate):
    changes = {"horizon": 4.0, "episodes": 6, "groups_at_once": 6, "time_limit": 20.0}
    outcome = simulate(msgspec.structs.replace(scenario, **changes), Stops(0.2))
    found = contacts(outcome)
    behind = [(episode, contact) for episode, contact in found if contact.who == "other→0"]
    assert behind
    for episode, contact in behind:
        rear, ahead = contact.vehicles
        assert ahead == episode.group.ids[0]
        assert rear not in episode.group.ids
        assert episode.outcome.contact
    evaded = [episode for episode in outcome.episodes if episode.ending is Ending.CUT_IN]
    assert {episode.broken_up_by for episode in evaded} == {BrokenUpBy.UNKNOWN}, "its followers evade into the gaps"
    bounds = headline(pd.DataFrame([outcome_columns(episode) for episode in outcome.episodes]))
    assert bounds.count < bounds.most < bounds.groups


def test_a_contact_after_the_hand_back_counts_although_the_drive_was_completed(scenario, simulate):
    """Hurled at its leader and then handed back: SUMO's driver cannot stop any more."""
    found = contacts(simulate(msgspec.structs.replace(scenario, horizon=2.4), RunsInto(0.2)))
    late = [(episode, contact) for episode, contact in found if episode.ending is Ending.HORIZON]
    assert late
    for episode, contact in late:
        assert contact.after_hand_back
        assert episode.end < contact.time <= episode.end + 10.0
        row = outcome_columns(episode)
        assert (row["completed"], row["contact"], row["completed_without_contact"]) == (True, True, False)
        assert row["contact_after_hand_back"]
        events = [event for event in episode.events if event.kind is EventKind.CONTACT]
        assert (contact.time, contact.vehicles) in [(event.time, event.vehicles) for event in events]
        assert [event.time for event in episode.events] == sorted(event.time for event in episode.events)


def test_sumos_drivers_and_idm_touch_nothing(scenario, simulate):
    outcome = simulate(scenario, IntelligentDriver(0.2))
    for episode in (*outcome.episodes, *outcome.left_to_sumo):
        assert episode.contacts == ()
        assert episode.judged_after == pytest.approx(10.0)
