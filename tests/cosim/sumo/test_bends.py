"""SUMO's drivers on a slippery bend: limits before it, and the friction circle in simulated traffic."""

import msgspec
import numpy as np
import pytest

from cosim.spec.loading import load_scenario
from cosim.spec.perturbations import LowFriction
from cosim.sumo.bends import greatest_curvature
from cosim.traffic.running_simulation import simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from gri.resources import shipped

GRAVITY = 9.81


def test_the_curvature_of_an_arc_is_one_over_its_radius():
    """A polyline with a vertex every 10 m, as in the net of the bend."""
    angle = np.arange(0, 0.6, 10 / 600)
    arc = 600 * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=1)
    assert greatest_curvature(arc) == pytest.approx(1 / 600, rel=0.02)
    assert greatest_curvature(np.array([[0.0, 0.0], [80.0, 60.0]])) == 0


@pytest.fixture
def start(tmp_path):
    def start(name: str, friction: float):
        scenario = load_scenario(name)
        traffic = msgspec.structs.replace(scenario.traffic, warm_up=0.0, bottleneck=None)
        scenario = msgspec.structs.replace(scenario, traffic=traffic, perturbations=(LowFriction(intensity=friction),))
        net = shipped("sumo_nets", scenario.net, f"{scenario.net}.net.xml")
        files = SumoFiles(net, tmp_path / "routes.rou.xml", tmp_path / "sumo.log")
        inputs = prepare_simulation(scenario, files, 60.0)
        inputs.write()
        return simulation(inputs)

    return start


def test_lanes_in_the_bend_get_a_limit_and_straight_lanes_keep_theirs(start):
    """Half of 0.1·g on a radius of about 600 m: √(0.49 · 600) = 17.2 m/s, by the fastest driver's factor 1.2."""
    with start("curved_merge", 0.1) as running:
        bend, straight = running.world.net.limits(["merge_1", "upstream_1"])
        assert bend == pytest.approx(17.2 / 1.2, rel=0.03)
        assert straight == 29


def test_a_straight_road_and_a_dry_bend_keep_their_limits(start):
    with start("us101_car_following", 0.1) as running:
        assert set(running.world.net.limits(["entry_2", "weave_3", "exit_2"])) == {29}
    with start("curved_merge", 0.9) as running:
        assert set(running.world.net.limits(["merge_1", "exit_1"])) == {29}


@pytest.mark.parametrize("slowed", [True, False])
def test_drivers_stay_inside_the_friction_circle_in_the_bend(start, slowed, monkeypatch):
    """√(a² + (v²·κ)²) of all vehicles at all steps; without the limits it is exceeded."""
    if not slowed:
        monkeypatch.setattr("cosim.sumo.simulation.slow_before_bends", lambda _: None)
    friction = 0.1
    with start("curved_merge", friction) as running:
        total = []
        for _ in range(300):
            running.world.step()
            now = running.world.snapshot(running.frame)
            across = now.v**2 * running.frame.curvature_at(now.s, now.d)
            main = np.array([not lane.startswith("on_ramp") for lane in now.lane], dtype=bool)
            total += np.hypot(now.a, across)[main].tolist()
    assert len(total) > 1000
    assert (max(total) <= friction * GRAVITY * 1.001) == slowed
