"""What SUMO is started with, made before anything runs."""

import msgspec
import pytest

from cosim.perturb.traffic_demand import perturbed_traffic
from cosim.spec.loading import load_scenario, override
from cosim.traffic.route_file import arguments, route_file, sign_file
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from gri.errors import InputError


@pytest.fixture
def files(tmp_path) -> SumoFiles:
    return SumoFiles(tmp_path / "a.net.xml", tmp_path / "b.rou.xml", tmp_path / "c.log")


def test_nothing_is_written_before_write(files):
    scenario = load_scenario("us101_merge")
    inputs = prepare_simulation(scenario, files, 60.0)
    assert not files.routes.exists()
    assert inputs.end == scenario.traffic.warm_up + 60.0
    assert inputs.texts[files.routes] == route_file(scenario.traffic, scenario.seed, inputs.end)
    names = (str(path) for path in (files.net, files.routes, files.signs, files.log))
    assert inputs.arguments == tuple(arguments(scenario, *names))
    inputs.write()
    assert files.routes.read_text() == inputs.texts[files.routes]
    assert files.signs.read_text() == inputs.texts[files.signs] == sign_file(scenario.traffic)


def test_perturbed_traffic_is_in_the_files_and_the_friction_only(files):
    blocks = [{"kind": "denser_traffic", "intensity": 1.2}, {"kind": "low_friction", "intensity": 0.3}]
    scenario = override(load_scenario("us101_car_following"), {"perturbations": blocks})
    inputs = prepare_simulation(scenario, files, 60.0)
    assert inputs.scenario == scenario
    traffic = perturbed_traffic(scenario).traffic
    assert inputs.texts[files.routes] == route_file(traffic, scenario.seed, inputs.end)
    assert inputs.texts[files.signs] == sign_file(traffic) != sign_file(scenario.traffic)
    assert inputs.friction == 0.3


def test_a_replay_without_a_recording_is_refused(files):
    with pytest.raises(InputError, match="give one with --recording"):
        prepare_simulation(load_scenario("us101_replay"), files, 60.0)


def test_the_same_scenario_gives_the_same_input(files):
    scenario = load_scenario("us101_car_following")
    assert prepare_simulation(scenario, files, 60.0) == prepare_simulation(scenario, files, 60.0)
    other = prepare_simulation(msgspec.structs.replace(scenario, seed=2), files, 60.0)
    assert other.texts != prepare_simulation(scenario, files, 60.0).texts
