"""Whole runs of merges on both real nets: placement in the plane, shadow vehicles, endings, driven roles, graphs."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from cosim.loop.closed_loop import SumoCounts, run
from cosim.loop.driving import Driver
from cosim.loop.round_recorder import PLACEMENT_TOLERANCE
from cosim.runs.run_tables import events_table, graphs_table, groups_table, steps_table
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Enforced
from cosim.sumo.positions import SHADOW
from cosim.traffic.simulation_input import SumoFiles
from cosim.world.episode import COLUMNS, Ending, EventKind, Outcome
from gri.core.dynamics import DUBINS
from gri.core.graph import LANE_CHANGING, InteractionGraph
from gri.core.merging_policy import MergingDriver
from gri.core.policy import ConstantVelocity, IntelligentDriver, PolicyState
from gri.resources import shipped

DRIVER = MergingDriver(IntelligentDriver(0.2))


def short(site: str, **changes):
    """Few merges after a minute of warm-up."""
    scenario = load_scenario(f"{site}_merge")
    traffic = msgspec.structs.replace(scenario.traffic, warm_up=90.0)
    defaults = {"watch": 1.0, "episodes": 3, "time_limit": 200.0}
    return msgspec.structs.replace(scenario, traffic=traffic, **(defaults | changes))


@pytest.fixture(scope="module", params=["us101", "i80"])
def outcome(request, tmp_path_factory):
    scratch: Path = tmp_path_factory.mktemp("run")
    net = shipped("sumo_nets", request.param, f"{request.param}.net.xml")
    files = SumoFiles(net, scratch / "r.rou.xml", scratch / "sumo.log")
    return run(short(request.param), files, Driver("idm", DRIVER), lambda *_: None)


def test_groups_are_driven_until_they_merged(outcome):
    assert len(outcome.episodes) >= 2
    assert Ending.MERGED in {episode.ending for episode in outcome.episodes}
    for episode in outcome.episodes:
        if episode.ending is Ending.MERGED:
            assert episode.outcome == Outcome(contact=False, completed=True, order_kept=True)
            at_the_end = episode.feature("d")[np.flatnonzero(episode.during_drive)[-1]]
            assert abs(at_the_end[0] - at_the_end[2]) < 1.0
            k = np.flatnonzero(episode.during_drive)[-1]
            s, d, v = (episode.feature(name)[k : k + 2, 0] for name in ("s", "d", "v"))
            assert d[1] == pytest.approx(d[0], abs=0.2 * 0.6)  # the hand-back moves it neither sideways
            assert s[1] - s[0] == pytest.approx(0.2 * v.mean(), abs=0.2 * 0.9)  # nor along the road


def test_driven_vehicles_move_by_dubins_equations(outcome):
    """x' = x + v cosθ dt, y' = y + v sinθ dt, v' = v + a dt between all driven instants of the merger."""
    for episode in outcome.episodes:
        kinds = {event.kind for event in episode.events}
        assert not kinds & {EventKind.MISPLACED, EventKind.VANISHED, EventKind.DISAGREEMENT}
        k = np.flatnonzero(episode.driven[:, 0])[1:]
        s, d, heading, v, a = (episode.feature(name)[:, 0] for name in ("s", "d", "heading", "v", "a"))
        before = k - 1
        np.testing.assert_allclose(s[k] - s[before], 0.2 * (v * np.cos(heading))[before], atol=PLACEMENT_TOLERANCE)
        np.testing.assert_allclose(d[k] - d[before], 0.2 * (v * np.sin(heading))[before], atol=PLACEMENT_TOLERANCE)
        np.testing.assert_allclose(v[k], np.maximum(v + 0.2 * a, 0)[before], atol=PLACEMENT_TOLERANCE)


def test_shadow_vehicles_are_in_no_table(outcome):
    ids = {vehicle for episode in outcome.episodes for event in episode.events for vehicle in event.vehicles}
    ids |= {vehicle for episode in outcome.episodes for vehicle in episode.group.ids}
    assert not [vehicle for vehicle in ids if vehicle.startswith(SHADOW)]
    assert outcome.trunk == SumoCounts()


@pytest.mark.slow
def test_forked_and_replayed_merges_are_the_same(simulate):
    scenario = short("i80", episodes=1)
    pairs = [simulate(scenario, DRIVER, "idm", forking=forking) for forking in (True, False)]
    for table in (steps_table, events_table):
        first, second = (table([*outcome.episodes, *outcome.left_to_sumo]) for outcome in pairs)
        assert first.equals(second)


def test_sumo_drives_the_roles_that_the_policy_does_not(simulate):
    scenario = short("us101", episodes=1, driven=(0,))
    episode = simulate(scenario, DRIVER).episodes[0]
    assert episode.driven[:, 0].any()
    assert not episode.driven[:, 1:].any()
    assert all(len(e.vehicles) == 1 for e in episode.events if e.kind is EventKind.TAKEN)


class TurnsAway(MergingDriver):
    """Steers off the road."""

    def act(self, memory, state):
        action, memory = super().act(memory, state)
        action[:, 0, 1] = (-0.3 - state[:, 0, 3] - state[:, 0, 5]) / self.dt
        return action, memory


def test_leaving_the_road_ends_the_group(simulate):
    episode = simulate(short("us101", episodes=1), TurnsAway(IntelligentDriver(0.2))).episodes[0]
    assert episode.ending is Ending.OFF_ROAD
    assert not episode.outcome.completed
    assert EventKind.VANISHED not in {event.kind for event in episode.events}


def standstill(episode) -> np.ndarray:
    """Whether vehicle 0 is present to the end, stopped there, and braked at most as hard as its own driver does."""
    k = np.flatnonzero(episode.during_drive)[-1]
    v, a = episode.feature("v")[k:, 0], episode.feature("a")[k:, 0]
    assert episode.valid[:, 0].all()
    assert v[1] > 1.0
    assert a[1:].min() >= -3.5 - 1e-6
    return v[-1] == 0


def test_a_vehicle_beside_the_road_brakes_and_stays(simulate):
    episode = simulate(short("us101", episodes=1, watch=10.0), TurnsAway(IntelligentDriver(0.2))).episodes[0]
    assert episode.ending is Ending.OFF_ROAD
    assert standstill(episode)


def test_at_the_end_of_its_lane_a_vehicle_brakes_beyond_it(simulate):
    """SUMO would stop it within a step, in front of the end."""
    scenario = short("us101", episodes=3, watch=10.0, driven=(0,))
    endings = simulate(scenario, ConstantVelocity(0.2, dynamics=DUBINS)).episodes
    episode = next(episode for episode in endings if episode.ending is Ending.LANE_END)
    assert standstill(episode)
    assert episode.feature("s")[-1, 0] > episode.feature("s")[np.flatnonzero(episode.during_drive)[-1], 0] + 2.0


class Fickle(MergingDriver):
    """Believes in another graph each time it is asked."""

    def begin(self, history):
        seen = int(history.state.shape[2])
        assert seen == self.history_steps
        logits = torch.zeros(len(history.state), 6, 4)
        logits[..., 1] = torch.sign(history.state[:, 0, -1, 1, None] + 2.0)  # follow once it is past y = -2
        return PolicyState(InteractionGraph(logits, LANE_CHANGING), history.state.new_zeros(len(logits), 3, 0))


def test_the_graph_is_inferred_anew_and_may_be_overruled(simulate):
    scenario = short("i80", episodes=1)
    policy = Fickle(IntelligentDriver(0.2), history_steps=5)
    driver = Driver("fickle", policy, Enforced(edges={"0->1": "yield"}), reinfer=5)
    episode = simulate(scenario, driver).episodes[0]
    assert episode.graph is not None
    np.testing.assert_allclose(np.diff(episode.graph_time), 1.0, atol=1e-6)
    assert episode.graph_time[0] == episode.group.time
    types = [episode.graph.edges(k).get((2, 0)) is not None for k in range(len(episode.graph))]
    assert types[0] is False
    assert types[-1] is True
    assert all(episode.graph.edges(k)[0, 1][0] == "yield" for k in range(len(episode.graph)))
    table = graphs_table([episode])
    assert len(table) == 6 * len(episode.graph)
    assert groups_table([episode], {})["edge_0_1"].tolist() == ["yield"]
    assert set(COLUMNS) <= set(steps_table([episode]).columns)
