"""Vehicles on their way back to SUMO's drivers, on the real US-101 net."""

import math
from pathlib import Path

import libsumo
import numpy as np
import pytest

from cosim.loop.gradual_hand_back import DURATION, FIRM_JERK
from cosim.loop.returning_vehicles import ReturningVehicles
from cosim.sumo import sumo
from cosim.world.road_frame import RoadFrame
from gri.resources import shipped

DT = 0.2
ROUTES = """<routes>
<vType id="car" length="5" width="1.8" accel="2" decel="3.5" sigma="0" tau="1.2" minGap="2" maxSpeed="15"/>
<route id="on" edges="on_ramp weave exit downstream_free downstream"/>
<vehicle id="a" type="car" route="on" depart="0" departLane="0" departPos="100" departSpeed="15"/>
</routes>"""
ROAD = RoadFrame(np.array([[-500.0, 0.0], [1150.0, 0.0]]), origin=500.0)


@pytest.mark.parametrize("way", [60.0, 90.0, 140.0])
def test_who_cannot_leave_a_lane_that_ends_brakes_for_its_end_in_time_and_softly(tmp_path: Path, way: float) -> None:
    """SUMO's driver begins so late that it needs its 3.5 m/s², and takes them in one step."""
    routes, log = tmp_path / "r.rou.xml", tmp_path / "sumo.log"
    routes.write_text(ROUTES)
    options = f"-n {shipped('sumo_nets/us101/us101.net.xml')} -r {routes} --step-length {DT} --default.speeddev 0"
    with sumo([*options.split(), "--no-step-log", "--time-to-teleport", "-1", "--error-log", str(log)], log) as world:
        world.step()
        drivers = world.drivers
        libsumo.vehicle.setLaneChangeMode("a", 0)
        while drivers.way_in_lane("a") == math.inf or drivers.way_in_lane("a") > way:
            world.step()
        world.take("a")
        returning = ReturningVehicles(DT)
        v = [float(world.snapshot(ROAD).v[0])]
        returning.hand_back(world, "a", 0.0, 0.0, checked=True)
        for _ in range(round(DURATION / DT)):
            libsumo.vehicle.setLaneChangeMode("a", 0)  # there never is a gap for it
            returning.command(world, ROAD, world.snapshot(ROAD))
            world.step()
            v.append(float(world.snapshot(ROAD).v[0]))
        a = np.diff(v) / DT
        assert v[-1] ** 2 / 2 < drivers.way_in_lane("a")  # 1 m/s² is still enough
        assert -a.min() < max(1.3 * v[0] ** 2 / (2 * way), 1.3)
        assert np.abs(np.diff(a, prepend=0.0)).max() / DT <= FIRM_JERK + 1e-6


BESIDE = """<routes>
<vType id="car" length="5" width="1.8" accel="2" decel="3.5" sigma="0" tau="1.2" minGap="2" maxSpeed="15"/>
<route id="on" edges="on_ramp weave exit downstream_free downstream"/>
<route id="through" edges="entry weave exit downstream_free downstream"/>
<vehicle id="b" type="car" route="through" depart="0" departLane="0" departPos="100" departSpeed="4"/>
<vehicle id="a" type="car" route="on" depart="0" departLane="0" departPos="100" departSpeed="4"/>
</routes>"""


@pytest.mark.parametrize("gap", [1.0, 4.0, 12.0, 60.0])
def test_who_drifts_across_a_line_keeps_behind_the_vehicle_there(tmp_path: Path, gap: float) -> None:
    """SUMO's driver knows the lane of its vehicle only, and would drive into the slower vehicle in the other one."""
    routes, log = tmp_path / "r.rou.xml", tmp_path / "sumo.log"
    routes.write_text(BESIDE)
    options = f"-n {shipped('sumo_nets/us101/us101.net.xml')} -r {routes} --step-length {DT} --default.speeddev 0"
    with sumo([*options.split(), "--no-step-log", "--error-log", str(log)], log) as world:
        world.step()
        road = world.net.road(("upstream", "entry", "weave", "exit", "downstream_free", "downstream"), "entry")
        libsumo.vehicle.setSpeedMode("b", 0)
        libsumo.vehicle.setLaneChangeMode("b", 0)
        libsumo.vehicle.setSpeed("a", 0.0)
        libsumo.vehicle.setSpeed("b", 4.0)
        while libsumo.vehicle.getRoadID("b") != "weave" or libsumo.vehicle.getLanePosition("b") < 120:
            world.step()
        now = world.snapshot(road)
        row = now.row_of["b"]
        lane = libsumo.vehicle.getLaneID("b")
        right = f"weave_{int(lane.rpartition('_')[2]) - 1}"
        s, d = float(now.s[row] - now.length[row]) - gap, float(now.d[row]) - 2.0  # 0.2 m beside the way of b
        libsumo.vehicle.setLaneChangeMode("a", 0b011000000001)  # for its route only, with regard to the others
        world.take("a")
        for _ in range(3):
            xy, along = road.to_world(np.array([s]), np.array([d]))
            world.command("a", float(xy[0, 0]), float(xy[0, 1]), float(along[0]), 4.0, right)
            world.step()
            s += 4.0 * DT
        returning = ReturningVehicles(DT)
        returning.hand_back(world, "a", 0.5, 0.75, checked=True)
        for _ in range(round(DURATION / DT)):
            returning.command(world, road, world.snapshot(road))
            world.step()
            now = world.snapshot(road)
            one, other = now.row_of["a"], now.row_of["b"]
            assert now.d[one] < now.d[other] + 0.5  # a change of lanes takes it to that lane, not beyond
            across = abs(now.d[one] - now.d[other]) < 0.5 * (now.width[one] + now.width[other])
            level = now.s[other] - now.length[other] < now.s[one] < now.s[other] + now.length[one]
            assert not (across and level)
        assert float(now.v[one]) > 4.0  # and it does not wait for it for ever
