"""The limits of a bottleneck in a running simulation."""

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from cosim.spec.demand import Fluctuation, Hold, Pulses
from cosim.spec.input_files import find_net
from cosim.spec.loading import load_scenario
from cosim.traffic.bottleneck_limits import base_limits, pulse_limits
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from gri.errors import InputError

SECONDS = 40
HOLD = Hold(edges=("upstream",), mean_speed=(5.0,), window=5.0, delay=2.0, start=10.0)


def limits_over_time(folder: Path, seconds: int = SECONDS, every: int = 5, **parts: object) -> np.ndarray:
    """The limits of the bottleneck's lanes after every fifth step (each second, or after as many steps as told).

    The bottleneck of the simulation has these parts.
    """
    scenario = load_scenario("us101_car_following")
    bottleneck = scenario.traffic.bottleneck
    assert bottleneck is not None
    moving = replace(bottleneck, **parts)
    scenario = replace(scenario, horizon=1.0, watch=1.0, traffic=replace(scenario.traffic, bottleneck=moving))
    inputs = prepare_simulation(scenario, SumoFiles(find_net("us101"), folder / "r.rou.xml", folder / "log"), 60.0)
    inputs.write()
    found = []
    with simulation(inputs) as running:
        for _ in range(seconds * 5 // every):
            for _ in range(every):
                running.world.step()
            found.append(running.world.net.limits(moving.lanes))
    return np.array(found)


def test_limits_fluctuate_and_pulse_as_computed(tmp_path):
    parts = {"fluctuation": Fluctuation(sd=0.2), "pulses": Pulses(lanes=("downstream_4",), first=15.0)}
    found = limits_over_time(tmp_path, **parts)
    bottleneck = load_scenario("us101_car_following").traffic.bottleneck
    assert bottleneck is not None
    moving = replace(bottleneck, **parts)
    wanted = np.minimum(base_limits(moving, 300.0, 1, 60.0), pulse_limits(moving, 1, 60.0))[:SECONDS]
    assert found == pytest.approx(wanted)
    assert found[20, 4] == pytest.approx(0.6)


def test_gradual_limits_move_in_every_step_and_reach_each_value_a_second_later(tmp_path):
    parts = {"fluctuation": Fluctuation(sd=0.5), "hold": HOLD}
    at_once = limits_over_time(tmp_path, **parts)
    gradual = limits_over_time(tmp_path, every=1, changes="gradual", **parts)
    np.testing.assert_allclose(gradual[4::5][:10], at_once[:10])  # until feedback begins, which sees other traffic
    within = gradual[:50].reshape(10, 5, -1)
    steps = np.diff(within[1:], axis=1)
    np.testing.assert_allclose(steps, steps[:, :1].repeat(4, axis=1), atol=1e-9)  # evenly
    assert np.abs(np.diff(gradual, axis=0)).max() < 0.5 * np.abs(np.diff(at_once, axis=0)).max()


def test_feedback_lowers_the_limits_of_traffic_that_is_too_fast(tmp_path):
    found = limits_over_time(tmp_path, hold=HOLD)
    assert (found[:9] == 15.0).all()
    assert (found[-1] < 12.0).all()
    assert np.array_equal(found, limits_over_time(tmp_path, hold=HOLD))


def test_without_any_of_them_sumos_signs_set_the_limits(tmp_path):
    assert (limits_over_time(tmp_path, 5) == 15.0).all()


def test_an_edge_that_the_net_lacks_is_told(tmp_path):
    with pytest.raises(InputError, match=r"bottleneck.hold.edges: the net .* has no edge 'nowhere'"):
        limits_over_time(tmp_path, 1, hold=replace(HOLD, edges=("nowhere",)))
    with pytest.raises(InputError, match=r"bottleneck.lanes: the net .* has no lane 'downstream_9'"):
        limits_over_time(tmp_path, 1, lanes=("downstream_9",), hold=HOLD)
