"""What the trunk remembers of the traffic: vehicles that wait outside, and why vehicles cannot be in groups."""

from msgspec.structs import replace

from cosim.loop.trunk import Trunk
from cosim.spec.input_files import find_net
from cosim.spec.scenario import Road
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.traffic.warm_up import warm_up
from cosim.world.backlog import MANY_WAITING, Backlog
from cosim.world.group_search import search_groups
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


def test_a_history_has_everybody_at_its_end_and_before_that_those_who_could_be_in_a_group(short_scenario, tmp_path):
    """The groups are those that a history of all vehicles has."""
    length = 400.0  # [m]; vehicles more than 70 m behind or ahead of it could not be in a group
    scenario = replace(short_scenario, history=1.0, road=replace(short_scenario.road, length=length))
    files = SumoFiles(find_net(scenario.net), tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
    inputs = prepare_simulation(scenario, files, scenario.time_limit)
    inputs.write()
    with simulation(inputs) as running:
        world = running.world
        trunk = Trunk(running, inputs.scenario, warm_up(world, inputs.scenario, lambda *_: None))
        whole, step = [], world.step

        def recorded_step():
            report = step()
            whole.append(world.snapshot(running.frame))
            return report

        world.step = recorded_step
        for _ in range(3):
            history = trunk.observe_history()
            everybody = whole[-len(history) :]
            assert history[-1].ids == everybody[-1].ids
            assert all(len(now.ids) < len(then.ids) for now, then in zip(history[:-1], everybody, strict=False))
            rule = {"rule": scenario.group, "zone": (0.0, length), "barred": {}, "limit": 9}
            found = search_groups(history, **rule)
            assert found == search_groups(everybody, **rule)
            assert found.seen
