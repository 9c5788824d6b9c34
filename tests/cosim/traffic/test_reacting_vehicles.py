"""Recorded vehicles that react: who is released, when, and what it changes."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from msgspec.structs import replace

from cosim.process.fork import CAN_FORK
from cosim.runs.run_tables import events_table, steps_table
from cosim.spec.loading import load_scenario, with_recording
from cosim.spec.scenario import CarFollowing
from cosim.world.episode import Ending, EventKind
from gri.core.policy import ConstantVelocity, IntelligentDriver
from gri.errors import InputError

LENGTH, SPEED, APART = 4.5, 12.0, 20.0
LANES = {1: 0.0, 2: -3.6}  # d of the lanes' centres [m]


def rows(vehicle: int, lane: int, start: float, seconds: float, first: float = 0.0) -> pd.DataFrame:
    """A vehicle in a lane at SPEED, at s = `start` [m] at the time `first` [s]."""
    time = np.round(np.arange(0.0, seconds + 0.05, 0.1), 1)
    return pd.DataFrame(
        {
            "time_s": time + first,
            "vehicle_id": vehicle,
            "lane": lane,
            "s_m": start + SPEED * time,
            "d_m": LANES[lane],
            "speed_mps": SPEED,
            "length_m": LENGTH,
            "width_m": 1.8,
        }
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """Five vehicles in lane 2 one behind the other (5 is ahead of all), and two in lane 1 beside them, for 20 s."""
    path = tmp_path_factory.mktemp("recording") / "tidy.csv"
    table = [rows(n, 2, 10 + APART * n, 20.0) for n in range(1, 6)] + [
        rows(n, 1, APART * (n - 5), 20.0) for n in (6, 7)
    ]
    pd.concat(table).to_csv(path, index=False)
    return path


def scenario_of(recording: Path, **background):
    chosen = with_recording(load_scenario("us101_replay"), recording)
    chosen = replace(chosen, background=replace(chosen.background, lane_1=0.0, **background))
    rule = CarFollowing(max_time_gap=4.0)
    return replace(chosen, group=rule, history=3.0, horizon=6.0, watch=1.0, episodes=1, driven=(0, 1))


class Brakes(ConstantVelocity):
    """Brakes with 4 m/s² to 2 m/s."""

    def act(self, memory, state):
        wanted = np.where(state[..., 1:2] > 2.0, -4.0, 0.0)
        return (state.new_tensor(wanted) - state[..., 2:3]) / self.dt, memory


def number(vehicle: str) -> str:
    return vehicle.rpartition("/")[2].partition(".")[0]


def released(episode) -> list[tuple[str, str]]:
    """Who was released behind whom, by their numbers in the recording."""
    events = [event for event in episode.events if event.kind is EventKind.RELEASED]
    return [(number(e.vehicles[0]), number(e.detail.removeprefix("behind "))) for e in events]


@pytest.fixture(scope="module")
def driven(recording):
    """Vehicles 3 and 4 brake behind 5; 1 and 2 are behind them, 6 and 7 in the next lane."""

    def run(simulate, policy=Brakes, **background):
        (episode,) = simulate(scenario_of(recording, **background), policy(0.2), "test").episodes
        assert [number(vehicle) for vehicle in episode.group.ids] == ["3", "4", "5"]
        return episode

    return run


def test_those_behind_a_braking_vehicle_react_one_after_the_other(driven, simulate):
    episode = driven(simulate, react=True)
    assert released(episode) == [("2", "3"), ("1", "2")]
    times = [event.time for event in episode.events if event.kind is EventKind.RELEASED]
    assert times[0] < times[1]
    assert episode.ending is Ending.HORIZON
    assert not episode.contacts


def test_without_the_option_they_drive_into_it(driven, simulate):
    episode = driven(simulate)
    assert not released(episode)
    assert episode.ending is Ending.CONTACT


def test_a_released_vehicle_keeps_to_its_path_and_stays_behind_the_one_ahead(driven, simulate):
    episode = driven(simulate, react=True)
    around = episode.surroundings
    (release, *_) = [event for event in episode.events if event.kind is EventKind.RELEASED]
    mine = around.vehicle == around.ids.index(release.vehicles[0])
    time, s, d, v = around.time[mine], *around.state[mine].T[[0, 1, 5]]
    before = time <= release.time + 1e-6
    np.testing.assert_allclose(v[before], SPEED, atol=1e-3)  # as recorded until then
    assert v[~before].min() < SPEED - 5.0
    assert np.diff(v).min() > -9.0 * 0.2 - 1e-6
    np.testing.assert_allclose(d, LANES[2], atol=1e-3)
    at = [int(np.argmin(np.abs(episode.time - t))) for t in time]
    assert (episode.feature("s")[at, 0] - LENGTH - s).min() > 0.5


def test_who_moves_as_recorded_hinders_nobody(driven, simulate):
    assert not released(driven(simulate, ConstantVelocity, react=True))


def test_without_a_driven_vehicle_nothing_changes(recording, simulate):
    tables = []
    for react in (False, True):
        episodes = simulate(scenario_of(recording, react=react), None, "null").episodes
        tables.append((steps_table(episodes), events_table(episodes)))
    for one, other in zip(*tables, strict=True):
        pd.testing.assert_frame_equal(one, other, check_exact=True)


@pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork; only replay exists here")
def test_releases_repeat_and_are_the_same_in_forks_and_in_processes_of_their_own(recording, simulate):
    found = []
    for forking in (True, True, False):
        episodes = simulate(scenario_of(recording, react=True), IntelligentDriver(0.2), "idm", forking=forking).episodes
        found.append((steps_table(episodes), events_table(episodes)))
    for other in found[1:]:
        for one, again in zip(found[0], other, strict=True):
            pd.testing.assert_frame_equal(one, again, check_exact=True)


@pytest.fixture(scope="module")
def two_chains(tmp_path_factory) -> Path:
    """Three vehicles in lane 2 for 20 s, and three in lane 1 that come 2 s later."""
    path = tmp_path_factory.mktemp("two_chains") / "tidy.csv"
    table = [rows(n, 2, 10 + APART * n, 20.0) for n in range(1, 4)]
    table += [rows(n, 1, 10 + APART * (n - 3), 18.0, first=2.0) for n in range(4, 7)]
    pd.concat(table).to_csv(path, index=False)
    return path


@pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork, and rounds that overlap are refused there")
def test_rounds_that_overlap_find_more_groups_and_drive_them_alike(two_chains, simulate):
    """Without overlap the second chain comes too late for a round of its own within its recording."""
    policy, groups = IntelligentDriver(0.2), {}
    for overlap in (False, True):
        scenario = replace(scenario_of(two_chains, overlap=overlap), episodes=5, horizon=8.0, time_limit=60.0)
        groups[overlap] = simulate(scenario, policy, "idm").episodes
    assert [len(groups[overlap]) for overlap in (False, True)] == [1, 2]
    first, again = (steps_table(episodes[:1]) for episodes in groups.values())
    pd.testing.assert_frame_equal(first, again, check_exact=True)


def test_rounds_that_overlap_are_refused_without_fork(recording, simulate):
    with pytest.raises(InputError, match=r"background\.overlap"):
        simulate(scenario_of(recording, overlap=True), IntelligentDriver(0.2), "idm", forking=False)
