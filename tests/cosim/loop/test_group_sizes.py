"""Groups of two to eight vehicles in closed loop."""

import msgspec
import numpy as np
import pytest

import gri
from cosim.loop.driving import Driver
from cosim.loop.round_recorder import PLACEMENT_TOLERANCE
from cosim.runs.policy_loading import policy_of
from cosim.runs.run_tables import graphs_table, groups_table, steps_table
from cosim.spec.loading import load_scenario, override
from cosim.spec.perturbations import Dropout, LeaderBraking, PerceptionLatency
from cosim.spec.scenario import TrainedPolicy
from cosim.world.episode import EventKind
from cosim.world.groups import expected_graph
from gri.errors import InputError


def of_size(scenario, size: int, **changes):
    group = msgspec.structs.replace(scenario.group, size=size)
    return msgspec.structs.replace(scenario, group=group, episodes=2, horizon=2.0, **changes)


def tables_of(outcome, scenario):
    expected = expected_graph(scenario.group)
    return steps_table(outcome.episodes), groups_table(outcome.episodes, expected), graphs_table(outcome.episodes)


@pytest.mark.parametrize("size", [pytest.param(2, marks=pytest.mark.slow), 5, pytest.param(8, marks=pytest.mark.slow)])
def test_gri_drives_all_but_the_leader(size: int, short_scenario, simulate):
    scenario = of_size(short_scenario, size)
    driver = Driver("gri", gri.load("us101_car_following"))
    outcome = simulate(scenario, driver)
    steps, groups, graphs = tables_of(outcome, scenario)
    assert len(groups) == 2
    for episode in outcome.episodes:
        assert len(episode.group.ids) == size
        assert np.flatnonzero(episode.driven.any(0)).tolist() == list(range(size - 1))
        assert not [event for event in episode.events if event.kind is EventKind.MISPLACED]
        s, v, a = (episode.feature(name)[:, : size - 1] for name in ("s", "v", "a"))
        k = np.flatnonzero(episode.driven[:, 0])[1:]
        np.testing.assert_allclose(s[k] - s[k - 1], 0.2 * v[k - 1] + 0.02 * a[k - 1], atol=PLACEMENT_TOLERANCE)
    assert set(steps["role"]) == set(range(size))
    neighbours = {(j + 1, j) for j in range(size - 1)} | {(j, j + 1) for j in range(size - 1)}
    assert set(zip(graphs["sender"], graphs["receiver"], strict=True)) == neighbours
    assert {f"edge_{j + 1}_{j}" for j in range(size - 1)} <= set(groups.columns)
    assert (groups["leader_deviation"] == 0).all() if "leader_deviation" in groups else True


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, 4])
def test_groups_of_other_sizes_are_perturbed(size: int, short_scenario, simulate):
    perturbations = (LeaderBraking(intensity=3.0), Dropout(intensity=0.3), PerceptionLatency(intensity=0.4))
    scenario = of_size(short_scenario, size, perturbations=perturbations, reinfer_s=1.0)
    outcome = simulate(scenario, Driver("gri", gri.load("us101_car_following"), reinfer=5))
    assert outcome.episodes
    assert {effect.perturbation for effect in outcome.effects} == {"leader_braking", "dropout", "perception_latency"}
    braking = [e for e in outcome.effects if e.perturbation == "leader_braking"]
    assert all(e.measured == pytest.approx(3.0, abs=0.1) for e in braking)
    assert graphs_table(outcome.episodes)["time"].nunique() >= 2


def test_checkpoints_for_three_vehicles_refuse_other_sizes():
    scenario = override(load_scenario("us101_car_following"), {"group": {"rule": "car_following", "size": 4}})
    policy = TrainedPolicy(checkpoint="sumo_car_following")
    with pytest.raises(InputError, match=r"for groups of three, group\.size is 4"):
        policy_of(msgspec.structs.replace(scenario, policy=policy))
