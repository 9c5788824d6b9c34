"""Whole runs on real traffic: placement, hand-over, branches, determinism."""

import multiprocessing

import msgspec
import numpy as np
import pandas as pd
import pytest

from cosim.loop.closed_loop import SumoCounts
from cosim.loop.driving import Driver
from cosim.loop.round_recorder import PLACEMENT_TOLERANCE
from cosim.process.fork import CAN_FORK, BranchError, fork
from cosim.runs.run_tables import events_table, groups_table, steps_table
from cosim.world.episode import COLUMNS, Ending, EventKind
from cosim.world.groups import expected_graph
from cosim.world.hand_back_columns import hand_back_columns
from gri.core.policy import ConstantVelocity, IntelligentDriver

IDM = IntelligentDriver(0.2)


def tables_of(outcome, scenario):
    episodes = [*outcome.episodes, *outcome.left_to_sumo]
    expected = expected_graph(scenario.group)
    return steps_table(episodes), groups_table(episodes, expected), events_table(episodes)


@pytest.fixture(scope="module")
def outcome(short_scenario, tmp_path_factory):
    from pathlib import Path

    from cosim.loop.closed_loop import run
    from cosim.traffic.simulation_input import SumoFiles
    from gri.resources import shipped

    scratch: Path = tmp_path_factory.mktemp("run")
    files = SumoFiles(shipped("sumo_nets/us101/us101.net.xml"), scratch / "r.rou.xml", scratch / "sumo.log")
    return run(short_scenario, files, Driver("idm", IDM), lambda *_: None)


def test_the_wanted_number_of_groups_is_driven(outcome, short_scenario):
    assert len(outcome.episodes) == short_scenario.episodes
    assert any(episode.ending is Ending.HORIZON for episode in outcome.episodes)
    for episode in outcome.episodes:
        if episode.ending is Ending.HORIZON:
            assert episode.end - episode.group.time == pytest.approx(short_scenario.horizon)


def test_no_vehicle_is_in_two_groups(outcome):
    ids = [vehicle for episode in outcome.episodes for vehicle in episode.group.ids]
    assert len(set(ids)) == len(ids)


def test_driven_vehicles_stand_where_the_dynamics_put_them(outcome):
    """x' = x + v dt + a dt²/2 and v' = v + a dt between all driven instants, and nothing was misplaced."""
    for episode in outcome.episodes:
        assert not [event for event in episode.events if event.kind in (EventKind.MISPLACED, EventKind.VANISHED)]
        s, v, a = (episode.feature(name)[:, :2] for name in ("s", "v", "a"))
        k = np.flatnonzero(episode.driven[:, 0])[1:]
        before, dt = k - 1, 0.2
        moved = v[before] * dt + 0.5 * a[before] * dt**2
        np.testing.assert_allclose(s[k] - s[before], moved, atol=PLACEMENT_TOLERANCE)
        np.testing.assert_allclose(v[k] - v[before], a[before] * dt, atol=PLACEMENT_TOLERANCE)


def test_hand_over_and_hand_back_leave_no_jump(outcome):
    """In every step of every phase the vehicles move by what lies between the speeds before and after."""
    for episode in outcome.episodes:
        s, v = episode.feature("s")[:, :2], episode.feature("v")[:, :2]
        step = np.diff(s, axis=0)
        low, high = 0.2 * np.minimum(v[1:], v[:-1]), 0.2 * np.maximum(v[1:], v[:-1])
        assert (step >= low - 1e-6).all()
        assert (step <= high + 1e-6).all()
        assert np.abs(np.diff(v, axis=0)).max() < 0.2 * 4.6


def test_both_sides_share_their_past_exactly(outcome):
    for driven, left in zip(outcome.episodes, outcome.left_to_sumo, strict=True):
        past = driven.time <= driven.group.time + 1e-6
        np.testing.assert_array_equal(driven.state[past], left.state[past])
        assert driven.group == left.group
        assert not np.array_equal(driven.state, left.state)


def test_left_to_sumo_is_a_null_run(outcome, short_scenario, simulate):
    assert outcome.trunk == SumoCounts()
    null_run = simulate(short_scenario, None, "sumo")
    assert null_run.trunk == SumoCounts()
    same = min(len(null_run.episodes), len(outcome.left_to_sumo))
    assert same >= short_scenario.episodes
    for a, b in zip(null_run.episodes[:same], outcome.left_to_sumo[:same], strict=True):
        assert a.group == b.group
        np.testing.assert_array_equal(a.state, b.state)
    assert not any(episode.driven.any() for episode in null_run.episodes)


def test_same_seed_same_tables_other_seed_other_tables(outcome, short_scenario, simulate):
    again = tables_of(simulate(short_scenario, IDM, "idm"), short_scenario)
    for first, second in zip(tables_of(outcome, short_scenario), again, strict=True):
        pd.testing.assert_frame_equal(first, second, check_exact=True)
    other = simulate(msgspec.structs.replace(short_scenario, seed=2, episodes=2), IDM, "idm")
    assert not tables_of(other, short_scenario)[0].equals(again[0])


@pytest.mark.slow
@pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork; only replay exists here")
def test_forked_and_replayed_branches_are_the_same(short_scenario, simulate):
    small = msgspec.structs.replace(short_scenario, episodes=5, horizon=2.0)
    forked = tables_of(simulate(small, IDM, "idm", forking=True), small)
    replayed = tables_of(simulate(small, IDM, "idm", forking=False), small)
    for first, second in zip(forked, replayed, strict=True):
        pd.testing.assert_frame_equal(first, second, check_exact=True)


class RunsInto(ConstantVelocity):
    """Full throttle, whatever is ahead."""

    def act(self, memory, state):
        return (8.0 - state[..., 2:3]) / self.dt, memory


def test_a_contact_ends_the_group_and_both_tests_see_it(short_scenario, simulate):
    long = msgspec.structs.replace(short_scenario, horizon=8.0, episodes=3)
    outcome = simulate(long, RunsInto(0.2), "crash")
    contacts = [episode for episode in outcome.episodes if episode.ending is Ending.CONTACT]
    assert contacts
    for episode in contacts:
        kinds = {event.kind for event in episode.events if event.time <= episode.end}
        assert EventKind.CONTACT in kinds
        assert EventKind.SUMO_COLLISION in kinds
        assert episode.gap[episode.during_drive].min() < 0
        assert episode.outcome.contact
        assert not episode.outcome.completed
        assert not episode.order_kept
        assert not episode.driven[episode.time > episode.end].any()


def test_after_a_contact_both_vehicles_brake_to_a_standstill(short_scenario, simulate):
    """The faster one at 8 m/s², the slower one at 4 m/s², instead of SUMO's stop within a step."""
    scenario = msgspec.structs.replace(short_scenario, horizon=8.0, watch=10.0, episodes=3)
    outcome = simulate(scenario, RunsInto(0.2), "crash")
    stopped = 0
    for episode in outcome.episodes:
        if episode.ending is not Ending.CONTACT:
            continue
        after = (episode.time > episode.end + 1e-6)[:, None] & episode.valid[:, :2]
        assert episode.feature("a")[:, :2][after].min() >= -9.0 - 1e-6
        hit = [contact for contact in episode.contacts if contact.time == pytest.approx(episode.end)]
        for role, vehicle in enumerate(episode.group.ids):
            if any(vehicle in contact.vehicles for contact in hit):
                v = episode.feature("v")[:, role]
                assert v[-1] == 0
                at_the_end = np.flatnonzero(episode.during_drive)[-1]
                assert v[at_the_end + 2] > 0  # not at once
                stopped += 1
    assert stopped >= 2


def test_the_hand_back_is_gradual(short_scenario, simulate):
    """Vehicles that were driven too close open the headway without braking hard, with little jerk."""
    scenario = msgspec.structs.replace(short_scenario, horizon=4.0, watch=10.0, episodes=6)
    tailgater = IntelligentDriver(0.2, time_headway=0.3, minimum_gap=1.0, acceleration=2.0)
    outcome = simulate(scenario, tailgater, "tailgates")
    shocks = [hand_back_columns(episode) for episode in outcome.episodes if episode.ending is Ending.HORIZON]
    assert len(shocks) >= 4
    assert max(shock["braking_after"] for shock in shocks) < 3.0
    assert max(shock["jerk_after"] for shock in shocks) <= 10.0
    assert not any(contact.after_hand_back for episode in outcome.episodes for contact in episode.contacts)


def test_vehicles_stay_in_their_lane_while_driven(outcome):
    d = COLUMNS.index("d")
    for episode in outcome.episodes:
        lateral = episode.state[episode.driven[:, 0]][:, :2, d]
        np.testing.assert_allclose(lateral, np.broadcast_to(lateral[:1], lateral.shape), atol=1e-6)


def _die():
    import os
    import signal

    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork")
def test_a_branch_returns_values_and_reports_failures():
    assert fork(lambda: {"answer": 42}).result() == {"answer": 42}
    with pytest.raises(BranchError, match="ZeroDivisionError"):
        fork(lambda: 1 // 0).result()
    with pytest.raises(BranchError, match="SIGKILL"):
        fork(_die).result()
    assert not multiprocessing.active_children()
