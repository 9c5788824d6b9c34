"""Perturbed rounds in real traffic: what happens at the take-over, and that nothing happens before it."""

import msgspec
import numpy as np
import pandas as pd
import pytest

from cosim.loop.perturbed_round import plan_intervention
from cosim.loop.round_recorder import Round
from cosim.perturb.displaced_starts import Infeasible
from cosim.process.fork import CAN_FORK
from cosim.runs.run_tables import events_table, steps_table
from cosim.spec.loading import load_scenario
from cosim.spec.perturbations import KINDS
from cosim.world.episode import COLUMNS, Ending, EventKind
from cosim.world.groups import Group
from cosim.world.snapshot import Snapshot
from gri.core.graph import EdgeType
from gri.core.policy import ConstantVelocity, IntelligentDriver

IDM = IntelligentDriver(0.2)
S, D, V, A = (COLUMNS.index(name) for name in ("s", "d", "v", "a"))


@pytest.fixture(scope="module")
def scenario(short_scenario):
    return msgspec.structs.replace(short_scenario, episodes=4)


def under(scenario, **perturbations: float):
    blocks = tuple(KINDS[kind](intensity=intensity) for kind, intensity in perturbations.items())
    return msgspec.structs.replace(scenario, perturbations=blocks)


def at_start(episode):
    """Index of the take-over."""
    return int(np.flatnonzero(episode.during_drive)[0])


def test_neutral_perturbations_change_nothing(scenario, simulate):
    """All that is done per step under perturbations, done at an intensity of 0, gives the same episodes."""
    plain = simulate(scenario, IDM)
    neutral = simulate(
        under(
            scenario,
            headway_ratio=0.0,
            observation_noise=0.0,
            dropout=0.0,
            perception_latency=0.0,
            localization_latency=0.0,
            low_friction=10.0,
            action_noise=0.0,
            action_delay=0.0,
            leader_braking=0.0,
        ),
        IDM,
    )
    for a, b in zip(plain.episodes, neutral.episodes, strict=True):
        np.testing.assert_array_equal(a.state, b.state)


def test_everything_up_to_the_take_over_is_the_same(scenario, simulate):
    plain, perturbed = simulate(scenario, IDM), simulate(under(scenario, headway_ratio=0.3), IDM)
    compared = 0
    for episode in perturbed.episodes:
        same = next((other for other in plain.episodes if other.group == episode.group), None)
        if same is not None:
            past = slice(0, at_start(episode) + 1)
            np.testing.assert_array_equal(episode.state[past], same.state[past])
            assert not np.array_equal(episode.state, same.state)
            compared += 1
    assert compared >= 2


def test_a_displaced_vehicle_starts_where_it_was_put(scenario, simulate):
    """s' = s_1 − (1 − δ)(s_1 − s_0), one step of the dynamics later; no other vehicle moves differently."""
    outcome = simulate(under(scenario, headway_ratio=0.3, speed_offset=-1.0), ConstantVelocity(0.2))
    assert outcome.episodes
    for episode in outcome.episodes:
        k = at_start(episode)
        before, after = episode.state[k], episode.state[k + 1]
        start = before[1, S] - 0.7 * (before[1, S] - before[0, S])
        v, a = before[0, V] - 1.0, before[0, A]
        assert after[0, S] == pytest.approx(start + 0.2 * v + 0.02 * a, abs=1e-6)
        assert after[0, V] == pytest.approx(v + 0.2 * a, abs=1e-6)
        assert after[1, S] == pytest.approx(before[1, S] + 0.2 * before[1, V] + 0.02 * before[1, A], abs=1e-6)
        assert not [e for e in episode.events if e.kind in (EventKind.MISPLACED, EventKind.VANISHED)]


def test_sumo_drives_displaced_vehicles_from_where_they_were_put(scenario, simulate):
    outcome = simulate(under(scenario, headway_ratio=0.3), None)
    assert outcome.episodes
    for episode in outcome.episodes:
        k = at_start(episode)
        before, after = episode.state[k], episode.state[k + 1]
        start = before[1, S] - 0.7 * (before[1, S] - before[0, S])
        assert after[0, S] == pytest.approx(start + 0.2 * before[0, V], abs=1e-6)
        s, v = episode.state[k + 1 :, 0, S], episode.state[k + 1 :, 0, V]
        np.testing.assert_allclose(np.diff(s), 0.2 * v[1:], atol=1e-6)  # SUMO's own steps from there on
        assert not episode.driven.any()


def test_infeasible_starts_are_counted(scenario, simulate):
    """In one lane no group can start with its follower ahead of its leader."""
    outcome = simulate(under(msgspec.structs.replace(scenario, time_limit=30.0), headway_ratio=1.5), IDM)
    assert not outcome.episodes
    assert outcome.excluded
    assert {reason for _, reason in outcome.excluded} <= {Infeasible.ORDER, Infeasible.OVERLAP}


def test_the_leader_brakes_as_planned_and_is_handed_back(scenario, simulate):
    outcome = simulate(under(scenario, leader_braking=3.0), IDM)
    for episode in outcome.episodes:
        k = at_start(episode)
        v = episode.state[k : k + 11, 2, V]
        np.testing.assert_allclose(v, np.maximum(v[0] - 0.6 * np.arange(11), 0), atol=1e-6)
        assert episode.state[k + 14, 2, V] > v[-1] - 0.7 * 3  # it does not go on braking like that
    assert max(abs(np.diff(episode.feature("d")[:, 2])).max() for episode in outcome.episodes) < 4


def test_a_removed_vehicle_is_gone_and_its_phantom_drives_on(scenario, simulate):
    outcome = simulate(under(scenario, remove_third=0.2), IDM)
    assert outcome.episodes
    for episode in outcome.episodes:
        k = at_start(episode)
        s, v = episode.feature("s")[:, 2], episode.feature("v")[:, 2]
        assert s[k + 1] == pytest.approx(s[k] + 500 + 0.2 * v[k])
        assert (v[k + 1 :] == v[k]).all()
        assert episode.ending is Ending.HORIZON
    gains = [np.ptp(episode.feature("v")[episode.during_drive][[0, -1], 1]) for episode in outcome.episodes]
    assert max(gains) > 0.5  # vehicle 1 has no leader now


def test_without_the_third_vehicle_the_graph_has_no_edge_to_it(scenario, simulate):
    from cosim.runs.policy_loading import policy_of

    outcome = simulate(under(msgspec.structs.replace(scenario, episodes=2), remove_third=0.0), policy_of(scenario))
    for episode in outcome.episodes:
        assert episode.graph is not None
        edges = episode.graph.edges()
        assert edges[(1, 0)][0] is EdgeType.FOLLOW
        assert not [pair for pair in edges if 2 in pair]


def test_a_vehicle_that_cuts_in_becomes_the_leader(scenario, simulate):
    outcome = simulate(under(msgspec.structs.replace(scenario, time_limit=240.0), neighbour_cut_in=1.0), IDM)
    assert outcome.episodes
    assert {reason for _, reason in outcome.excluded} <= {Infeasible.NO_NEIGHBOUR, Infeasible.UNAVOIDABLE}
    swapped = 0
    for episode in outcome.episodes:
        jump = np.abs(np.diff(episode.feature("s")[:, 2]) - 0.2 * episode.feature("v")[1:, 2])
        k = at_start(episode)
        if (jump[k:] > 2).any():
            swapped += 1
            first = k + int(np.argmax(jump[k:] > 2))
            assert first - k in (5, 6, 7)  # the centre is within 1 m of the lane's 1.1 to 1.4 s after it began
            assert abs(episode.feature("d")[first + 1, 2] - episode.feature("d")[k, 2]) < 1.0
    assert swapped
    assert [e.ending for e in outcome.episodes].count(Ending.HORIZON) >= 1


def test_no_vehicle_cuts_in_for_two_groups_or_out_of_one():
    """Two groups side by side: between them, each sees the other's vehicles in its gap, and only they fit."""
    now = snapshot(
        *(("a" + str(k), 100.0 + 30 * k, 0.0) for k in range(3)),
        *(("b" + str(k), 112.0 + 30 * k, -3.66) for k in range(3)),
        ("free", 150.0, 3.66),
    )
    found = plan_intervention(*arguments(now, "a0 a1 a2", "b0 b1 b2"))
    assert [change.successor for change in found.changes] == ["free"]
    assert [reason for _, reason in found.excluded] == [Infeasible.NO_NEIGHBOUR]
    middle = snapshot(
        *(("a" + str(k), 100.0 + 30 * k, 3.66) for k in range(3)),
        *(("b" + str(k), 100.0 + 30 * k, -3.66) for k in range(3)),
        ("free", 150.0, 0.0),
    )
    found = plan_intervention(*arguments(middle, "a0 a1 a2", "b0 b1 b2"))
    assert [change.successor for change in found.changes] == ["free"]
    assert len(found.excluded) == 1


def snapshot(*vehicles: tuple[str, float, float]) -> Snapshot:
    """All vehicles drive at 10 m/s along the x axis."""
    ids = tuple(name for name, _, _ in vehicles)
    s, d = (np.array([vehicle[k] for vehicle in vehicles]) for k in (1, 2))
    n = np.ones(len(ids))
    return Snapshot(0.0, ids, np.stack([s, d], 1), 0 * n, 10 * n, 0 * n, s, d, 5 * n, 1.8 * n, ("e_0",) * len(ids))


def arguments(now: Snapshot, *groups: str):
    """Arguments of `plan_intervention` for these groups and a neighbour that cuts in."""
    scenario = under(load_scenario("us101_car_following"), neighbour_cut_in=0.0)
    made = tuple(Group(tuple(ids.split()), 0.0) for ids in groups)
    return scenario, now, Round(made, scenario.group, (0, 1), 40, 0, 0.2)


def test_a_policy_does_not_react_to_what_it_cannot_observe(scenario, simulate):
    """Under total drop-out the follower drives as if its leader still stood where it was at the take-over."""
    blind = simulate(under(scenario, dropout=1.0), IDM)
    seeing = simulate(scenario, IDM)
    for a, b in zip(blind.episodes, seeing.episodes, strict=False):
        if a.group == b.group:
            assert not np.array_equal(a.state, b.state)


def test_perturbed_runs_repeat(scenario, simulate):
    noisy = under(scenario, observation_noise=1.0, action_noise=2.0)
    first, second = simulate(noisy, IDM), simulate(noisy, IDM)
    for a, b in zip(first.episodes, second.episodes, strict=True):
        np.testing.assert_array_equal(a.state, b.state)


def test_low_friction_limits_what_is_driven(scenario, simulate):
    outcome = simulate(under(scenario, low_friction=0.1), IDM)
    for episode in outcome.episodes:
        driven = episode.state[..., A][episode.driven]
        assert np.abs(driven).max() <= 0.981 + 1e-9


@pytest.mark.slow
@pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork; only replay exists here")
@pytest.mark.parametrize("kinds", [{"headway_ratio": 0.3}, {"leader_braking": 3.0, "observation_noise": 0.5}])
def test_forked_and_replayed_interventions_are_the_same(scenario, simulate, kinds):
    small = under(msgspec.structs.replace(scenario, episodes=3, horizon=2.0), **kinds)
    forked, replayed = (simulate(small, IDM, forking=forking) for forking in (True, False))
    for table in (steps_table, events_table):
        pd.testing.assert_frame_equal(table(forked.episodes), table(replayed.episodes), check_exact=True)
