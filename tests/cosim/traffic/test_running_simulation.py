"""A simulation that is started from prepared input."""

import os
from pathlib import Path

import msgspec
import pytest

from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation

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
