"""What the trunk remembers of the traffic: vehicles that wait outside, and why vehicles cannot be in groups."""

from msgspec.structs import replace

from cosim.loop.trunk import MANY_WAITING, Backlog
from cosim.spec.scenario import Road
from gri.core.policy import IntelligentDriver


def test_a_backlog_lasts_since_it_was_never_small_again():
    backlog = Backlog()
    for time, waiting in ((10.0, MANY_WAITING), (20.0, MANY_WAITING - 1), (30.0, 50), (40.0, 90)):
        backlog = backlog.updated(waiting, time)
    assert backlog == Backlog(90, 30.0)
    assert backlog.updated(0, 50.0) == Backlog(0, None)


def test_a_road_that_is_full_has_a_backlog_and_a_free_one_has_none(short_scenario, simulate):
    flows = tuple(replace(flow, per_hour=(40000.0,)) for flow in short_scenario.traffic.flows)
    full = replace(short_scenario, episodes=1, traffic=replace(short_scenario.traffic, flows=flows))
    backlog = simulate(full, None).backlog
    assert backlog.waiting > 500
    assert backlog.since is not None
    assert backlog.since < 10
    assert simulate(replace(short_scenario, episodes=1), None).backlog.since is None


def test_a_road_may_be_shorter_than_the_routes(short_scenario, simulate):
    """Its vehicles leave it by its end; only those that leave it before cannot be in a group."""
    road = Road(edges=("entry", "weave", "exit"), origin="entry", length=600.0)
    outcome = simulate(replace(short_scenario, road=road, episodes=4), IntelligentDriver(0.2))
    assert len(outcome.episodes) == 4
    assert not any(vehicle.startswith("leaving") for episode in outcome.episodes for vehicle in episode.group.ids)
    assert outcome.search.failed["not on the main road, or leaving it"] > 0


def test_a_search_without_groups_says_why(short_scenario, simulate):
    rule = replace(short_scenario.group, min_gap=40.0, max_gap=41.0)
    outcome = simulate(replace(short_scenario, group=rule, time_limit=5.0), IntelligentDriver(0.2))
    assert not outcome.episodes
    assert outcome.search.seen == sum(outcome.search.failed.values()) > 20
    assert outcome.search.failed["gap < 40 m"] > 0
