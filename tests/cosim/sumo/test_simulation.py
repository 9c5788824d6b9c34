"""What commands change and when it is seen, measured on the real US-101 net."""

import math
from contextlib import contextmanager
from dataclasses import replace

import libsumo
import numpy as np
import pytest

from cosim.sumo import SumoError, sumo
from cosim.sumo.positions import SHADOW
from cosim.world.road_frame import RoadFrame
from gri.resources import shipped

ROUTES = """<routes>
<vType id="car" length="5" width="1.8" accel="2" decel="3.5" sigma="0" tau="1.2" minGap="2"/>
<route id="upstream" edges="upstream entry weave exit downstream_free downstream"/>
<route id="entry" edges="entry weave exit downstream_free downstream"/>
{vehicles}
</routes>"""
ROAD = RoadFrame(np.array([[-500.0, 0.0], [1150.0, 0.0]]), origin=500.0)


def vehicle(name: str, s: float, lane: int = 2, speed: float = 15.0) -> str:
    edge, position = ("upstream", s + 500) if s < 0 else ("entry", s)
    return (
        f'<vehicle id="{name}" type="car" route="{edge}" depart="0" departLane="{lane}"'
        f' departPos="{position}" departSpeed="{speed}"/>'
    )


@pytest.fixture
def road(tmp_path):
    """A simulation with the given vehicles, one step in."""

    @contextmanager
    def road(*vehicles: str, warm: int = 1):
        routes, log = tmp_path / "r.rou.xml", tmp_path / "sumo.log"
        routes.write_text(ROUTES.format(vehicles="\n".join(vehicles)))
        options = {
            "net-file": shipped("sumo_nets/us101/us101.net.xml"),
            "route-files": routes,
            "step-length": 0.2,
            "default.speeddev": 0,
            "collision.action": "warn",
            "collision.mingap-factor": 0,
            "time-to-teleport": -1,
            "no-step-log": "true",
            "no-warnings": "true",
            "error-log": log,
        }
        with sumo([token for k, v in options.items() for token in (f"--{k}", str(v))], log) as world:
            for _ in range(warm):
                world.step()
            yield world

    return road


def state_of(world, name):
    snapshot = world.snapshot(ROAD)
    row = snapshot.rows([name])[name]
    return snapshot.s[row], snapshot.d[row], snapshot.heading[row], snapshot.v[row], snapshot.lane[row]


def test_snapshot_is_in_metres_and_radians(road):
    with road(vehicle("a", -100.0)) as world:
        snapshot = world.snapshot(ROAD)
        assert snapshot.ids == ("a",)
        # Departs with its front bumper 400 m into the upstream edge, which begins at s = -500 m.
        assert snapshot.s[0] == pytest.approx(-100.0, abs=1e-6)
        assert snapshot.heading[0] == pytest.approx(0.0, abs=1e-9)
        assert (snapshot.length[0], snapshot.width[0]) == (5.0, 1.8)
        assert snapshot.v[0] == pytest.approx(15.0)


def test_a_command_is_seen_after_the_step_and_exactly(road):
    with road(vehicle("a", 10.0)) as world:
        before = state_of(world, "a")
        world.take("a")
        world.command("a", 13.21, before[1] + 0.4, 0.05, 14.2)
        assert state_of(world, "a") == before
        world.step()
        s, d, heading, v, _ = state_of(world, "a")
        assert (s, d, v) == pytest.approx((13.21, before[1] + 0.4, 14.2), abs=1e-9)
        assert heading == pytest.approx(0.05, abs=1e-9)


def test_reported_speed_is_the_commanded_one_even_beyond_what_sumo_allows(road):
    """Full braking, and faster than the lane's limit of 29 m/s."""
    with road(vehicle("a", 10.0)) as world:
        s, d, *_ = state_of(world, "a")
        world.take("a")
        for speed in (9.0, 3.0, 35.0, 0.0):
            s += 0.2 * speed
            world.command("a", s, d, 0.0, speed)
            world.step()
            assert state_of(world, "a")[3] == pytest.approx(speed, abs=1e-9)
            assert state_of(world, "a")[0] == pytest.approx(s, abs=1e-9)


def test_placement_holds_across_edges(road):
    with road(vehicle("a", 170.0, speed=20.0)) as world:
        s, d, *_ = state_of(world, "a")
        world.take("a")
        lanes = set()
        for _ in range(30):
            s += 4.0
            world.command("a", s, d, 0.0, 20.0)
            world.step()
            seen = state_of(world, "a")
            assert seen[:2] == pytest.approx((s, d), abs=1e-9)
            lanes.add(seen[4])
        assert lanes == {"entry_2", "weave_3"}


def test_followers_react_to_a_driven_vehicle_one_step_later(road):
    with road(vehicle("leader", 40.0), vehicle("follower", 10.0)) as world:
        s, d, *_ = state_of(world, "leader")
        world.take("leader")
        libsumo.vehicle.setLaneChangeMode("follower", 0)  # brake, do not overtake
        speeds = []
        for k in range(40):
            speed = max(15.0 - 0.7 * (k + 1), 0.0)
            s += 0.2 * speed
            world.command("leader", s, d, 0.0, speed)
            world.step()
            speeds.append(state_of(world, "follower")[3])
        gap = s - 5.0 - state_of(world, "follower")[0]
        assert speeds[-1] < 1.0
        assert gap > 0.5


def test_release_gives_no_jump_and_restores_the_modes(road):
    with road(vehicle("a", 10.0)) as world:
        modes = libsumo.vehicle.getSpeedMode("a"), libsumo.vehicle.getLaneChangeMode("a")
        s, d, *_ = state_of(world, "a")
        world.take("a")
        assert (libsumo.vehicle.getSpeedMode("a"), libsumo.vehicle.getLaneChangeMode("a")) == (0, 0)
        for _ in range(10):
            s += 0.2 * 12.0
            world.command("a", s, d, 0.0, 12.0)
            world.step()
        world.release("a")
        assert (libsumo.vehicle.getSpeedMode("a"), libsumo.vehicle.getLaneChangeMode("a")) == modes
        world.step()
        after = state_of(world, "a")
        assert after[3] == pytest.approx(12.0 + 0.2 * 2.0, abs=1e-6)  # free road: full acceleration of 2 m/s^2
        assert after[0] == pytest.approx(s + 0.2 * after[3], abs=1e-6)
        assert after[1] == pytest.approx(d, abs=1e-6)


def test_a_returning_vehicle_is_guided_along_its_lane_and_gets_its_own_headway_back(road):
    """The tailgater keeps 5 m at the leader's speed, against its own 1.2 s, and drifts to the centre of its lane."""
    with road(vehicle("leader", 60.0), vehicle("a", 20.0)) as world:
        libsumo.vehicle.setSpeed("leader", 15.0)
        d = state_of(world, "a")[1]
        world.take("a")
        for k in range(10):
            s = state_of(world, "leader")[0] + 3.0 - 10.0
            world.command("a", s, d + 0.1 * k, 0.0, 15.0)
            world.step()
        modes = libsumo.vehicle.getSpeedMode("leader"), libsumo.vehicle.getLaneChangeMode("leader")
        offset = world.drivers.lane_offset("a")
        assert offset == pytest.approx(0.9, abs=1e-6)
        world.begin_release("a")
        assert not world.is_taken("a")
        for k in range(20):
            world.set_headway("a", 0.2, 0.5)
            world.guide("a", 15.0, offset - 0.04 * k, safely=True)
            world.step()
            leader, gap = world.drivers.leader("a")
            assert (leader, world.drivers.motion(leader)) == ("leader", (15.0, 0.0))
            assert gap == pytest.approx(5.0, abs=1e-6)
            assert state_of(world, "a")[1] == pytest.approx(d + offset - 0.04 * k, abs=1e-6)
        world.release("a")
        assert (libsumo.vehicle.getSpeedMode("a"), libsumo.vehicle.getLaneChangeMode("a")) == modes
        assert world.drivers.headway("a") == (1.2, 2.0)
        world.step()
        assert state_of(world, "a")[3] < 14.5


def test_a_returning_vehicle_brakes_for_what_only_sumo_sees_unless_told_not_to(road):
    with road(vehicle("leader", 100.0, speed=5.0), vehicle("a", 30.0)) as world:
        libsumo.vehicle.setSpeed("leader", 5.0)
        for name in ("a", "leader"):
            libsumo.vehicle.setLaneChangeMode(name, 0)
        world.take("a")
        world.begin_release("a")
        for _ in range(50):
            world.guide("a", 15.0, 0.0, safely=True)
            world.step()
        assert state_of(world, "a")[3] < 6.5
        world.guide("a", 15.0, 0.0, safely=False)
        world.step()
        assert state_of(world, "a")[3] == 15.0


def test_a_vehicle_with_a_headway_of_its_own_survives_its_shadow(road):
    """SUMO deletes the type that such a vehicle has of its own together with any vehicle that has it."""
    with road(vehicle("a", 60.0, lane=1)) as world:
        s, d, *_ = state_of(world, "a")
        world.take("a")
        world.begin_release("a")
        for k in range(6):
            world.set_headway("a", 0.5 + 0.01 * k, 1.0)
            world.guide("a", 12.0, 0.0, safely=True)
            s += 0.2 * 12.0
            if k % 2:
                world.remove_shadow("a")
            else:
                world.place_shadow("a", s, d, 0.0, 12.0, "entry_2")
            world.step()
        world.release("a")
        world.step()
        assert world.drivers.headway("a") == (1.2, 2.0)


def straddle(world, with_shadow: bool) -> tuple[float, list[tuple[str, str]], set[str]]:
    """A car stands across the line between lanes 1 and 2 while another one comes along in lane 2 at 15 m/s.

    Returns where the other car ends up relative to it [m], what SUMO reported, and all ids that were seen.
    """
    s, d, *_ = state_of(world, "a")
    line = d + 0.5 * 3.37  # entry_1 is 3.37 m wide
    libsumo.vehicle.setLaneChangeMode("b", 0)
    world.take("a")
    collisions, seen = [], set()
    for k in range(60):
        speed = max(15.0 - 1.4 * k, 0.0)
        s += 0.2 * speed
        across = min(d + 0.1 * k, line - 0.05)  # its centre stays in lane 1
        world.command("a", s, across, 0.0, speed, lane="entry_1")
        if with_shadow and across > line - 0.9:
            world.place_shadow("a", s, across, 0.0, speed, "entry_2")
        report = world.step()
        collisions += report.collisions
        seen |= {*world.snapshot(ROAD).ids, *report.arrived, *report.teleported}
    behind = s - state_of(world, "b")[0]
    if with_shadow:
        world.remove_shadow("a")
        world.step()
        assert not [v for v in libsumo.vehicle.getIDList() if v.startswith(SHADOW)]
    world.release("a")
    return behind, collisions, seen


def test_a_vehicle_across_a_line_is_seen_in_both_lanes_only_with_a_shadow(road):
    """The other car's lane is the one that `a` is not booked on: without a shadow it drives through."""
    with road(vehicle("a", 100.0, lane=1), vehicle("b", 30.0, lane=2)) as world:
        behind, *_ = straddle(world, with_shadow=False)
        assert behind < 0
    with road(vehicle("a", 100.0, lane=1), vehicle("b", 30.0, lane=2)) as world:
        behind, collisions, seen = straddle(world, with_shadow=True)
        assert behind - 5.0 > 0.5
        assert not collisions
        assert seen == {"a", "b"}
        assert world.waiting() == 0


def test_placement_beside_a_shadow_is_exact(road):
    with road(vehicle("a", 60.0, lane=1)) as world:
        s, d, *_ = state_of(world, "a")
        world.take("a")
        for _ in range(5):
            s, d = s + 0.2 * 12.0, d + 0.3
            world.place_shadow("a", s, d, 0.1, 12.0, "entry_2")
            world.command("a", s, d, 0.1, 12.0, lane="entry_1")
            world.step()
            assert state_of(world, "a")[:4] == pytest.approx((s, d, 0.1, 12.0), abs=1e-9)
            assert state_of(world, "a")[4] == "entry_1"


def test_a_vehicle_beside_the_road_has_no_lane(road):
    with road(vehicle("a", 60.0, lane=0)) as world:
        s, d, *_ = state_of(world, "a")
        world.take("a")
        world.command("a", s + 3.0, d - 6.0, 0.0, 15.0)
        world.step()
        assert state_of(world, "a")[4] == ""


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_non_finite_commands_are_refused(road, bad):
    with road(vehicle("a", 10.0)) as world:
        world.take("a")
        for k in range(4):
            command = [bad if k == which else 1.0 for which in range(4)]
            with pytest.raises(SumoError, match="non-finite"):
                world.command("a", *command)


def test_a_second_simulation_is_refused_and_the_first_lives_on(road):
    with road(vehicle("a", 10.0)) as world:
        with pytest.raises(SumoError, match="already running"), road(vehicle("b", 10.0)):
            pass
        assert world.step().time == pytest.approx(0.4)
    with road(vehicle("c", 10.0)) as world:
        assert world.snapshot(ROAD).ids == ("c",)


def test_closing_with_a_pending_command_is_safe(road):
    for _ in range(3):
        with road(vehicle("a", 10.0)) as world:
            world.take("a")
            world.command("a", 12.0, state_of(world, "a")[1], 0.0, 10.0)


def test_errors_carry_sumos_own_message(road):
    with pytest.raises(SumoError, match="nowhere"), road(vehicle("a", 10.0).replace('type="car"', 'type="nowhere"')):
        pass


def test_sumo_reports_the_overlap_that_we_cause(road):
    with road(vehicle("a", 10.0), vehicle("b", 50.0)) as world:
        s, d, *_ = state_of(world, "b")
        world.take("a")
        world.command("a", s + 0.2 * 15 - 2.0, d, 0.0, 15.0)
        assert ("a", "b") in world.step().collisions


def test_road_frame_of_the_net_starts_where_the_study_area_starts(road):
    with road(vehicle("a", 10.0)) as world:
        frame = world.net.road(("upstream", "entry", "weave", "exit", "downstream_free", "downstream"), "entry")
        s, _ = frame.to_road(np.array([[0.0, -5.0], [640.0, -5.0]]))
        assert s.tolist() == [0.0, 640.0]
        assert replace(frame, origin=0.0).to_road(np.array([[0.0, 0.0]]))[0] == 500.0


def test_a_vehicle_that_is_nowhere_is_in_no_snapshot(road, monkeypatch):
    """SUMO may go on listing a vehicle that left all lanes for a few steps, and answers with a sentinel."""
    known, nowhere = libsumo.vehicle.getPosition, (libsumo.constants.INVALID_DOUBLE_VALUE,) * 2
    with road(vehicle("a", 50.0), vehicle("b", 100.0)) as world:
        monkeypatch.setattr("cosim.sumo.positions._point", lambda v: nowhere if v == "a" else known(v))
        assert world.snapshot(ROAD).ids == ("b",)
        assert world.snapshot(ROAD, around=["a", "b"]).ids == ("b",)


def test_who_looks_farther_along_the_lane_sees_more_at_once(road):
    """Who is near is remembered for a second, plus 30 m; a farther look must not wait for that."""
    with road(vehicle("a", 50.0), vehicle("b", 120.0), vehicle("c", 250.0)) as world:
        assert world.snapshot(ROAD, around=["a"], lane_ahead=10.0).ids == ("a",)
        assert world.snapshot(ROAD, around=["a"], lane_ahead=80.0).ids == ("a", "b")
        assert world.snapshot(ROAD, around=["a"], lane_ahead=10.0).ids == ("a", "b")


def test_lanes_keep_their_distance_in_a_bend(tmp_path):
    """Where edges of a bend meet, rounded lane shapes overlap by centimetres; the road must not turn back there."""
    net, log = shipped("sumo_nets/curved/curved.net.xml"), tmp_path / "sumo.log"
    with sumo(["--net-file", str(net), "--no-step-log", "--error-log", str(log)], log) as world:
        road = world.net.road(["entry", "merge", "exit", "downstream_free"], "entry")
        for edge, lanes in (("entry", 3), ("merge", 4), ("exit", 3)):
            for index in range(lanes):
                strip = world.net.strip(f"{edge}_{index}", road)
                assert strip.centre == pytest.approx(-3.5 * (lanes - 1 - index), abs=0.02)
        source, beyond = world.net.strip("merge_0", road), world.net.strip("exit_0", road)
    assert (source.begin, source.end) == pytest.approx((150.0, 300.5), abs=0.15)
    assert beyond.begin == pytest.approx(source.end, abs=0.05)
