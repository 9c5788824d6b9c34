"""Recorded vehicles in SUMO: their positions, when they come and go, and a policy among them."""

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from msgspec.structs import replace

import cosim
from cosim.commands.realism import realism
from cosim.process.fork import CAN_FORK
from cosim.runs.policy_loading import driver_of
from cosim.runs.run_tables import steps_table
from cosim.runs.traffic_survey import survey
from cosim.spec.loading import load_scenario, override, with_recording
from cosim.spec.scenario import CarFollowing, SumoDriver
from cosim.traffic.recorded_tracks import read_tracks
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.world.episode import Ending, EventKind
from gri.core.policy import ConstantVelocity, IntelligentDriver
from gri.data.recordings.parts import ReadingOptions
from gri.data.recordings.scenes import write_tidy
from gri.errors import InputError
from gri.resources import shipped

FEET = 1 / 0.3048
LANE_1, LANE_2 = 5.9 / FEET, 18.0 / FEET  # Local_X of the lanes' centres [m]
NAMES = (  # noqa: SIM905
    "Vehicle_ID Frame_ID Total_Frames Global_Time Local_X Local_Y Global_X Global_Y v_Length v_Width v_Class v_Vel "
    "v_Acc Lane_ID Preceding Following Space_Headway Time_Headway"
).split()


def quiet(*_: object) -> None:
    pass


def rows(vehicle: int, frames: range, start: float, v: float, x: float, lane: int) -> list[tuple]:
    """A vehicle at constant speed that is at `start` [m] in the first of its frames."""
    found = []
    for k, frame in enumerate(frames):
        place = x * FEET, (start + 0.1 * k * v) * FEET
        found.append(
            (vehicle, frame, 0, 1118846980000 + 100 * frame, *place, 0, 0, 4.5 * FEET, 1.8 * FEET, 2, v * FEET)
        )
    return [(*row, 0.0, lane, 0, 0, 0, 0) for row in found]


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """Four vehicles 30 m apart in lane 2 at 12 m/s for 20 s, and one in lane 1 at 10 m/s from 5 s to 10 s."""
    path = tmp_path_factory.mktemp("recording") / "us-101.csv"
    table = [row for n in range(4) for row in rows(n + 1, range(1, 202), 10 + 30.0 * n, 12.0, LANE_2, 2)]
    table += rows(5, range(51, 102), 50.0, 10.0, LANE_1, 1)
    pd.DataFrame(table, columns=NAMES).to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def scenario(recording):
    chosen = with_recording(load_scenario("us101_replay"), recording)
    rule = CarFollowing(max_time_gap=4.0)
    return replace(chosen, group=rule, history=3.0, horizon=3.0, watch=1.0, episodes=1)


def test_the_same_recording_in_another_layout_is_replayed_in_the_same_way(recording, tmp_path):
    tidy = tmp_path / "tidy.csv"
    write_tidy([recording], tidy, ReadingOptions(site="us-101"))
    background = load_scenario("us101_replay").background
    ours, theirs = (read_tracks(replace(background, recording=str(path)), 0.2) for path in (recording, tidy))
    assert len(ours) == len(theirs) == 5
    for one, other in zip(ours, theirs, strict=True):
        assert (one.lane, one.truck, one.length, one.first_step) == (
            other.lane,
            other.truck,
            other.length,
            other.first_step,
        )
        for name in ("s", "d", "heading", "v"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def at(name: str, ids: tuple[str, ...]) -> int:
    """Row of the vehicle with that number in the file."""
    return next(row for row, vehicle in enumerate(ids) if vehicle.split("/")[1].split(".")[0] == name)


def test_vehicles_stand_where_they_were_recorded_and_come_and_go_at_their_times(scenario, tmp_path):
    """Frame 1 is at the first step, t = 0.2 s: 1 is at 10 + 12·(t − 0.2), 5 there from 5.2 s to 10.2 s."""
    files = SumoFiles(shipped("sumo_nets/us101/us101.net.xml"), tmp_path / "r.xml", tmp_path / "log")
    inputs = prepare_simulation(scenario, files, 30.0)
    inputs.write()
    with simulation(inputs) as road:
        for step in range(1, 110):
            road.world.step()
            now, t = road.world.snapshot(road.frame), 0.2 * step
            there = 5.2 - 1e-6 <= t <= 10.2 + 1e-6
            assert len(now.ids) == (5 if there else 4 if t <= 20.2 + 1e-6 else 0)
            if t > 20.2 + 1e-6:
                continue
            row = at("1", now.ids)
            assert now.s[row] == pytest.approx(10 + 12 * (t - 0.2), abs=1e-3)
            assert now.d[row] == pytest.approx(1.80 - LANE_2, abs=1e-3)
            assert now.v[row] == pytest.approx(12.0, abs=1e-3)
            assert abs(now.a[row]) < 0.01
            assert (now.length[row], now.width[row]) == pytest.approx((4.5, 1.8), abs=1e-4)
            assert now.lane[row].endswith("_3") or now.lane[row] == "weave_4"
            if there:
                row = at("5", now.ids)
                assert now.s[row] == pytest.approx(50 + 10 * (t - 5.2), abs=1e-3)
                assert now.d[row] == pytest.approx(0.0, abs=2e-3)


@pytest.fixture
def outcome(scenario, simulate):
    return simulate(scenario, IntelligentDriver(0.2), "idm")


def test_the_policy_drives_and_the_leader_moves_as_recorded(outcome):
    (driven,), (left,) = outcome.episodes, outcome.left_to_sumo
    assert driven.ending is left.ending is Ending.HORIZON
    assert (driven.driver, left.driver) == ("idm", "recorded")
    assert driven.group == left.group
    np.testing.assert_allclose(left.feature("v"), 12.0, atol=1e-3)
    np.testing.assert_array_equal(driven.state[:, 2], left.state[:, 2])  # the leader, bit for bit
    way = driven.driven[:, 0]
    assert np.abs(driven.feature("v")[way][-1, :2] - 12.0).min() > 0.05  # IDM keeps other gaps
    kinds = {event.kind for event in driven.events}
    assert kinds == {EventKind.TAKEN, EventKind.HANDED_BACK}


def test_a_vehicle_that_was_handed_back_stays_with_sumo(outcome):
    (driven,), (left,) = outcome.episodes, outcome.left_to_sumo
    after = driven.time > driven.end + 1e-6
    assert after.sum() == 5
    step = np.diff(driven.feature("s")[:, 0])
    assert step.max() < 0.2 * 15  # no jump back to where it was recorded
    assert np.abs(driven.feature("s")[after, 0] - left.feature("s")[after, 0]).min() > 0.1


def test_sumos_drivers_take_the_place_of_recorded_ones(scenario, simulate):
    """With headways of 3 s SUMO's drivers fall back behind their recorded places; they keep their lane."""
    kinds = tuple(replace(kind, car_following="EIDM", imperfection=None, tau=3.0) for kind in scenario.traffic.vehicles)
    chosen = replace(scenario, policy=SumoDriver(), traffic=replace(scenario.traffic, vehicles=kinds))
    driver = driver_of(chosen)
    assert (driver.name, driver.policy) == ("EIDM", None)
    (driven,), (left,) = (lambda found: (found.episodes, found.left_to_sumo))(simulate(chosen, driver))
    assert (driven.driver, left.driver) == ("EIDM", "recorded")
    np.testing.assert_array_equal(driven.state[:, 2], left.state[:, 2])
    way = driven.during_drive
    np.testing.assert_allclose(left.feature("v")[way], 12.0, atol=1e-3)
    assert (driven.feature("s")[way][-1, :2] < left.feature("s")[way][-1, :2] - 0.3).all()
    assert np.ptp(driven.feature("d")[way], axis=0).max() < 0.1
    with pytest.raises(ValueError, match="sumo_driver, which takes the place of recorded drivers"):
        override(load_scenario("us101_car_following"), {"policy": {"kind": "sumo_driver"}})


def test_driven_vehicles_are_compared_with_how_they_were_recorded(scenario, tmp_path):
    done = cosim.run(replace(scenario, horizon=5.0), "constant_velocity", folder=tmp_path / "run")
    realism(str(done.folder), counterparts=True, out=tmp_path / "compared")
    found = pd.read_csv(tmp_path / "compared" / "distances.csv")
    assert {"v", "gap", "relative_speed"} <= set(found["quantity"])
    assert set(found["part"]) == {"constant velocity"}
    assert found.set_index("quantity").loc["v", "wasserstein"] == pytest.approx(0.0, abs=0.3)
    with pytest.raises(InputError, match="is for run folders"):
        realism("us101_car_following", counterparts=True)
    with pytest.raises(InputError, match="expected one of them"):
        realism(str(done.folder), against=done.folder, counterparts=True)


def test_contacts_are_seen_by_our_own_test(scenario, simulate):
    class RunsInto(ConstantVelocity):
        def act(self, memory, state):
            return (25.0 - state[..., 2:3]) / self.dt, memory

    (episode,) = simulate(replace(scenario, horizon=5.0), RunsInto(0.2), "crash").episodes
    assert episode.ending is Ending.CONTACT
    assert EventKind.CONTACT in {event.kind for event in episode.events}


@pytest.mark.skipif(not CAN_FORK, reason="this system cannot fork; only replay exists here")
def test_forked_and_replayed_branches_are_the_same(scenario, simulate):
    forked, again = (simulate(scenario, IntelligentDriver(0.2), "idm", forking=forking) for forking in (True, False))
    pd.testing.assert_frame_equal(steps_table(forked.episodes), steps_table(again.episodes), check_exact=True)


def test_a_survey_of_a_replay_shows_the_recording(scenario, tmp_path):
    files = SumoFiles(shipped("sumo_nets/us101/us101.net.xml"), tmp_path / "r.xml", tmp_path / "log")
    result = survey(scenario, files, 600.0, quiet)
    assert result.samples["vehicle"].nunique() == 5
    assert result.samples.groupby("lane")["v"].mean().tolist() == pytest.approx([10.0, 12.0], abs=1e-3)
    assert result.collisions == result.teleports == 0


def test_bad_recordings_are_refused(scenario, recording, tmp_path):
    with pytest.raises(InputError, match="give one with --recording"):
        read_tracks(load_scenario("us101_replay").background, 0.2)
    with pytest.raises(InputError, match="no file"):
        read_tracks(with_recording(scenario, tmp_path / "none.csv").background, 0.2)
    with pytest.raises(InputError, match="is simulated"):
        with_recording(load_scenario("us101_car_following"), recording)
    flat = pd.read_csv(recording).assign(Local_X=0.0)
    flat.to_csv(tmp_path / "us-101.csv", index=False)
    with pytest.raises(InputError, match="no lateral positions"):
        read_tracks(with_recording(scenario, tmp_path / "us-101.csv").background, 0.2)


def test_a_recording_without_places_and_sizes_is_put_on_lane_centres(scenario, tmp_path):
    """One vehicle keeps lane 2 for 8 s, another changes from lane 2 to 1 after 4 s."""
    time = np.round(np.arange(0.0, 8.05, 0.1), 1)
    keeps = pd.DataFrame({"time_s": time, "vehicle_id": 1, "lane": 2, "s_m": 10.0 + 12.0 * time})
    changes = keeps.assign(vehicle_id=2, s_m=keeps["s_m"] + 40.0, lane=np.where(time < 4.0, 2, 1))
    pd.concat([keeps, changes]).to_csv(tmp_path / "tidy.csv", index=False)
    background = replace(with_recording(scenario, tmp_path / "tidy.csv").background, lane_1=0.0)
    with pytest.raises(InputError, match=r"no lateral positions, .*or background\.lane_width"):
        read_tracks(background, 0.2)
    with pytest.raises(InputError, match=r"no sizes of vehicles, .*or background\.vehicle_length"):
        read_tracks(replace(background, lane_width=3.6), 0.2)
    one, other = read_tracks(replace(background, lane_width=3.6, vehicle_length=4.8), 0.2)
    np.testing.assert_allclose(one.d, -3.6)
    np.testing.assert_allclose((other.d[0], other.d[-1]), (-3.6, 0.0), atol=1e-9)
    assert (np.diff(other.d) >= -1e-9).all()
    assert np.diff(other.d).max() <= 3.6 / 3.0 * 0.2 + 0.05  # three seconds from centre to centre
    for track in (one, other):
        assert (track.length, track.width) == pytest.approx((4.8, 1.8), abs=1e-6)


def test_a_vehicle_faster_than_its_driver_would_be_is_replayed(scenario, tmp_path):
    time = np.round(np.arange(0.0, 4.05, 0.1), 1)
    table = pd.DataFrame({"time_s": time, "vehicle_id": 1, "lane": 1, "s_m": 10.0 + 45.0 * time})
    table.to_csv(tmp_path / "tidy.csv", index=False)
    background = replace(scenario.background, recording=str(tmp_path / "tidy.csv"), lane_width=3.6, vehicle_length=4.8)
    files = SumoFiles(shipped("sumo_nets/us101/us101.net.xml"), tmp_path / "r.xml", tmp_path / "log")
    result = survey(replace(scenario, background=background), files, 4.0, quiet)
    assert result.samples["v"].tolist() == pytest.approx([45.0] * len(result.samples), abs=1e-3)
    assert len(result.samples) >= 3


def test_an_unknown_flow_is_refused(scenario, simulate):
    background = {"kind": "replay", "recording": scenario.background.recording, "lane_1": 1.8, "flows": {7: "ramp"}}
    with pytest.raises(InputError, match=r"background\.flows: got 'ramp'"):
        simulate(override(scenario, {"background": background}), None)


REAL = Path(os.environ.get("NGSIM_US101", "/nowhere"))


@pytest.mark.skipif(not REAL.is_file(), reason="set NGSIM_US101 to a US-101 trajectory file to run this")
def test_a_real_recording_is_played_on_the_road(tmp_path):
    """Vehicles are on lanes of the net, hardly ever touch, and most of them are there for as long as they should."""
    scenario = with_recording(load_scenario("us101_replay"), REAL)
    files = SumoFiles(shipped("sumo_nets/us101/us101.net.xml"), tmp_path / "r.xml", tmp_path / "log")
    inputs = prepare_simulation(scenario, files, 100.0)
    inputs.write()
    seen: set[str] = set()
    off_road = there = 0
    with simulation(inputs) as road:
        for _ in range(300):
            road.world.step()
            now = road.world.snapshot(road.frame)
            seen |= set(now.ids)
            there, off_road = there + len(now.ids), off_road + sum(lane == "" for lane in now.lane)
    tracks = [track for track in inputs.tracks if track.first_step <= 300]
    assert seen == {track.name for track in tracks}
    assert there == sum(min(track.last_step, 300) - track.first_step + 1 for track in tracks)
    assert off_road < 0.02 * there
