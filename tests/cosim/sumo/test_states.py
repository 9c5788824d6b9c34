"""Reading all vehicles and the near ones at once; the ids that are kept between steps."""

import libsumo
import numpy as np
import pytest
from msgspec.structs import replace

from cosim.spec.input_files import find_net
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


def test_near_and_all_at_once_are_what_two_readings_give(running):
    world = running.world
    for _ in range(300):
        world.step()
    around = world.snapshot(running.frame).ids[40:60:7]
    for _ in range(12):  # more than a second, so that the near ones are looked for again
        world.step()
        near, everybody = world.near_and_all(running.frame, around)
        whole = world.snapshot(running.frame)
        assert_same(near, world.snapshot(running.frame, around))
        assert 3 < len(near.ids) < len(whole.ids)
        assert (everybody.time, everybody.ids) == (whole.time, whole.ids)
        assert np.array_equal(everybody.state, whole.state)
        assert np.array_equal(everybody.length, whole.length)
        assert np.array_equal(everybody.width, whole.width)


def assert_same(one: Snapshot, other: Snapshot) -> None:
    assert (one.time, one.ids, one.lane) == (other.time, other.ids, other.lane)
    for name in ("state", "length", "width"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
