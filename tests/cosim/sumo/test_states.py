"""Reading the near vehicles and those to record at once; what is kept between steps instead of read."""

import libsumo
import numpy as np
import pytest
from msgspec.structs import replace

from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.world.snapshot import Snapshot


@pytest.fixture
def running(short_scenario, tmp_path):
    """A minute of dense traffic in which vehicles enter and leave, and with a driven vehicle that is removed."""
    scenario = replace(short_scenario, road=replace(short_scenario.road, length=300.0))
    files = SumoFiles(find_net(scenario.net), tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
    inputs = prepare_simulation(scenario, files, scenario.time_limit)
    inputs.write()
    with simulation(inputs) as running:
        yield running


def test_kept_ids_are_those_that_sumo_lists(running):
    world, entered, left, before = running.world, set(), set(), set()
    for step in range(450):
        world.step()
        now = world.snapshot(running.frame).ids
        assert now == tuple(libsumo.vehicle.getIDList())
        entered, left, before = entered | ({*now} - before), left | (before - {*now}), {*now}
        if step == 300:
            world.remove(now[0])
            assert now[0] not in world.snapshot(running.frame).ids
    assert len(entered) > 100
    assert len(left) > 20


def test_near_ones_and_those_in_spans_are_what_two_readings_give(running):
    """The spans move with the vehicles, as those of groups do, and are far shorter than the road."""
    world = running.world
    for _ in range(300):
        world.step()
    before = world.snapshot(running.frame)
    around = before.ids[40:60:7]
    left_out = 0
    for _ in range(60):  # more than 5 s, so that all rings of vehicles are made again
        s = before.s[[before.row_of[vehicle] for vehicle in around if vehicle in before.row_of]]
        spans = np.array([[s.min() - 120.0, s.max() + 120.0]])
        world.step()
        near, recorded = world.near_and_recorded(running.frame, around, lambda spans=spans: spans)
        before = world.snapshot(running.frame)
        rows = [before.row_of[vehicle] for vehicle in near.ids]
        assert np.array_equal(near.state, before.state[rows])
        assert near.lane == tuple(before.lane[row] for row in rows)
        rows = [before.row_of[vehicle] for vehicle in recorded.ids]
        assert rows == sorted(rows)
        assert np.array_equal(recorded.state, before.state[rows])
        assert np.array_equal([recorded.length, recorded.width], [before.length[rows], before.width[rows]])
        inside = (before.s >= spans[0, 0]) & (before.s <= spans[0, 1])
        assert {before.ids[row] for row in np.flatnonzero(inside)} <= {*recorded.ids}
        left_out += len(before.ids) - len(rows)
    assert left_out > 1000


def test_near_ones_do_not_depend_on_who_is_recorded(running):
    """Rings of vehicles for one kind of reading are made anew for the other kind."""
    world = running.world
    for _ in range(300):
        world.step()
    around = world.snapshot(running.frame).ids[40:60:7]
    for _ in range(6):
        world.step()
        near, everybody = world.near_and_recorded(running.frame, around, lambda: np.array([[-1e6, 1e6]]))
        assert_same(near, world.snapshot(running.frame, around))
        assert everybody.ids == world.snapshot(running.frame).ids


@pytest.mark.parametrize("name", ["us101_car_following", "i80_merge", "curved_merge"])
def test_accelerations_that_are_not_read_are_those_that_sumo_has(name, tmp_path):
    """On every shipped net, with vehicles that are taken, commanded across lanes, and handed back."""
    scenario = load_scenario(name)
    files = SumoFiles(find_net(scenario.net), tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
    inputs = prepare_simulation(scenario, files, scenario.time_limit)
    inputs.write()
    with simulation(inputs) as running:
        world = running.world
        compared, lane_changes = 0, 0
        for step in range(300):
            world.step()
            now = world.snapshot(running.frame)
            assert now.a.tolist() == [libsumo.vehicle.getAcceleration(vehicle) for vehicle in now.ids]
            compared += len(now.ids)
            if step >= 150:
                for vehicle in now.ids[::9]:
                    row = now.row_of[vehicle]
                    if step % 50 == 0:
                        world.take(vehicle)
                    if world.is_taken(vehicle) and step % 50 == 30:
                        world.release(vehicle)
                    elif world.is_taken(vehicle):
                        aside = now.d[row] + 0.1 * (-1) ** (step // 25)
                        xy, heading = running.frame.to_world(now.s[[row]] + 0.2 * now.v[row], np.array([aside]))
                        world.command(vehicle, *xy[0].tolist(), float(heading[0]), float(now.v[row]))
            lane_changes += int((now.a == 0).sum())
    assert compared > 10_000
    assert lane_changes > 0


def assert_same(one: Snapshot, other: Snapshot) -> None:
    assert (one.time, one.ids, one.lane) == (other.time, other.ids, other.lane)
    for name in ("state", "length", "width"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
