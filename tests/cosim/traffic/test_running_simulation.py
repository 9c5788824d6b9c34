"""A simulation that is started from prepared input."""

import os
from pathlib import Path

import msgspec
import pytest

from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.spec.scenario import Road
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from gri.errors import InputError

OPEN_FILES = Path("/proc/self/fd")


@pytest.mark.skipif(not OPEN_FILES.is_dir(), reason="this system does not list open files")
def test_the_route_file_is_not_kept_open(tmp_path):
    """A branch would share the open file with the trunk: what the one reads is missing for the other."""
    scenario = msgspec.structs.replace(load_scenario("us101_car_following"), time_limit=1000.0)
    files = SumoFiles(find_net(scenario.net), tmp_path / "a.rou.xml", tmp_path / "c.log")
    inputs = prepare_simulation(scenario, files, scenario.time_limit)
    inputs.write()
    with simulation(inputs) as running:
        running.world.step()
        open_files = {os.path.realpath(handle) for handle in OPEN_FILES.iterdir()}
    assert str(files.log.resolve()) in open_files
    assert str(files.routes.resolve()) not in open_files


@pytest.mark.parametrize(
    ("road", "message"),
    [
        (Road(edges=("weave", "entry"), origin="entry", length=100), "'weave' does not lead to edge 'entry'"),
        (Road(edges=("entry", "exit"), origin="entry", length=100), "'entry' does not lead to edge 'exit'"),
        (Road(edges=("entry", "weave", "exit"), origin="weave", length=5000), "road.length: got 5000 m, but from"),
    ],
)
def test_a_road_that_does_not_join_or_is_too_short_is_refused(tmp_path, road, message):
    scenario = msgspec.structs.replace(load_scenario("us101_car_following"), road=road)
    inputs = prepare_simulation(
        scenario, SumoFiles(find_net(scenario.net), tmp_path / "a.rou.xml", tmp_path / "c.log"), 1.0
    )
    inputs.write()
    with pytest.raises(InputError, match=message), simulation(inputs):
        pass
