"""Safety measures against numbers worked by hand, invariances, and SUMO's own SSM device."""

import subprocess
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.measures import surrogate_safety
from cosim.measures.surrogate_safety import Track
from cosim.sumo import sumo
from cosim.world.road_frame import RoadFrame
from gri.resources import shipped


def track(s, v, d=0.0, *, time=None, a=0.0, length=5.0, width=2.0) -> Track:
    """A vehicle along the x axis; scalars last for all instants."""
    time = np.array([0.0, 1.0]) if time is None else np.array(time, dtype=float)
    s, v, d, a = (np.broadcast_to(np.array(x, dtype=float), time.shape) for x in (s, v, d, a))
    return Track(time, s, d, v, a, np.stack([s, d], axis=1), np.zeros(len(time)), length, width)


def test_following_by_hand():
    """30 m between fronts and 5 m of leader: 25 m net, closing at 5 m/s: TTC 5 s, DRAC 25/50 = 0.5, headway 30/15."""
    rear, front = track(0.0, 15.0), track(30.0, 10.0)
    assert surrogate_safety.gap(rear, front).tolist() == [25.0, 25.0]
    assert surrogate_safety.ttc(rear, front).tolist() == [5.0, 5.0]
    assert surrogate_safety.drac(rear, front).tolist() == [0.5, 0.5]
    assert surrogate_safety.time_headway(rear, front).tolist() == [2.0, 2.0]


def test_nobody_is_behind_the_vehicle_ahead_of_it_or_in_the_next_lane():
    rear, front, beside = track(0.0, 15.0), track(30.0, 10.0), track(30.0, 10.0, d=3.5)
    for i, j in ((front, rear), (rear, beside)):
        assert np.isinf(surrogate_safety.ttc(i, j)).all()
        assert np.isinf(surrogate_safety.time_headway(i, j)).all()
        assert surrogate_safety.drac(i, j).tolist() == [0.0, 0.0]
        assert np.isinf(surrogate_safety.gap(i, j)).all()


def test_the_smallest_gap_is_to_a_vehicle_in_the_path():
    """1 m behind a vehicle in the next lane, 25 m behind one in the own lane."""
    found = surrogate_safety.conflicts([track(0.0, 15.0), track(30.0, 10.0), track(6.0, 10.0, d=3.5)], (0,))
    assert found["min_gap"] == 25.0


def test_standing_side_by_side_has_no_headway():
    assert surrogate_safety.time_headway(track(5.0, 0.0), track(5.0, 0.0, d=3.5)).tolist() == [np.inf, np.inf]


def test_a_gap_that_opens_is_no_conflict():
    rear, front = track(0.0, 10.0), track(30.0, 12.0)
    assert np.isinf(surrogate_safety.ttc(rear, front)).all()
    assert surrogate_safety.drac(rear, front).tolist() == [0.0, 0.0]


def test_bumper_to_bumper_at_the_same_speed_needs_no_braking():
    rear, front = track(0.0, 10.0), track(5.0, 10.0)
    assert surrogate_safety.gap(rear, front).tolist() == [0.0, 0.0]
    assert surrogate_safety.drac(rear, front).tolist() == [0.0, 0.0]


def test_measures_of_following_begin_with_any_closing_speed():
    """10 m net at 0.5 m/s closing: TTC 20 s, DRAC 0.25/20."""
    rear, front = track(0.0, 10.5), track(15.0, 10.0)
    assert surrogate_safety.ttc(rear, front).tolist() == [20.0, 20.0]
    assert surrogate_safety.drac(rear, front).tolist() == [0.0125, 0.0125]


def test_bumper_to_bumper_at_the_same_speed_never_collides():
    assert surrogate_safety.ttc(track(0.0, 10.0), track(5.0, 10.0)).tolist() == [np.inf, np.inf]


def test_a_vehicle_is_in_the_path_if_their_widths_overlap():
    """2 m and 1 m wide: they overlap up to 1.5 m between their centres; touching is no overlap."""
    rear, front = track(0.0, 10.0, d=[-0.5, -0.5]), track(20.0, 10.0, d=[0.9375, 1.0], width=1.0)
    assert surrogate_safety.behind(rear, front).tolist() == [True, False]
    assert surrogate_safety.behind(rear, track(0.0, 10.0)).tolist() == [False, False], "side by side"


def test_pet_of_following_is_the_time_gap_that_was_kept():
    """Both at 10 m/s, 25 m net: the follower is where the leader's rear was 2.5 s later (found to 0.02 s)."""
    time = np.arange(0, 6.1, 0.2)
    rear, front = track(10 * time, 10.0, time=time), track(30 + 10 * time, 10.0, time=time)
    assert surrogate_safety.pet(rear, front) == pytest.approx(2.5, abs=0.021)
    assert surrogate_safety.pet(front, rear) == np.inf
    assert surrogate_safety.pet(rear, front, below=1.0) == np.inf  # not looked for
    assert surrogate_safety.pet(rear, front, below=2.6) == pytest.approx(2.5, abs=0.021)


def test_pet_of_a_merge_counts_only_where_the_first_was_in_the_lane():
    """The first drives 10 m/s with its rear at 10 + 10t and is in the lane from t = 3 s (rear at 40 m) on.

    The second comes at 20 m/s from −50 m: it is at 40 + 10u after 4.5 + u/2 s, which the rear left after 3 + u s.
    PET = 1.5 − u/2: 1 s at u = 1, t = 5 s, where the first record ends. In the second the first leaves the lane at
    5 s, u = 2: 0.5 s. From −10 m the second is there before the first comes in, and they meet.
    """
    time = np.arange(0, 5.05, 0.1)
    first = track(15 + 10 * time, 10.0, np.where(time > 2.95, 0.0, -3.5), time=time)
    assert surrogate_safety.pet(track(20 * time - 50, 20.0, time=time), first) == pytest.approx(1.0, abs=0.03)
    longer = np.arange(0, 6.05, 0.1)
    first = track(15 + 10 * longer, 10.0, np.where(longer > 2.95, 0.0, -3.5) - 9 * (longer > 5.05), time=longer)
    assert surrogate_safety.pet(track(20 * longer - 50, 20.0, time=longer), first) == pytest.approx(0.5, abs=0.03)
    assert surrogate_safety.pet(track(20 * longer - 10, 20.0, time=longer), first) == 0.0


def crossing_track(x: float, front, v: float, time, heading=np.pi / 2, **options) -> Track:
    """A vehicle at a right angle to the road, at `x`; `front` is where its bumper is across the road."""
    plain = track(np.full(len(time), float(x)), v, front, time=time, **options)
    return replace(plain, heading=np.full(len(time), heading))


def test_pet_of_a_crossing_by_hand():
    """At x = 0 one vehicle crosses to the left with 10 m/s; its rear leaves the lane, d = 1, at 0.6 s.

    The other comes along the road with 10 m/s: its front is at x = −1, the side of the first one, at 2 s.
    """
    for begins in (0.0, 500.0):  # on the clock
        time = np.arange(0, 4.05, 0.1)
        first = crossing_track(0.0, 10 * time, 10.0, begins + time)
        second = track(10 * time - 21.0, 10.0, time=begins + time)
        assert surrogate_safety.pet(second, first) == pytest.approx(1.4, abs=0.021)
        assert surrogate_safety.pet(second, first, below=1.35) in (np.inf, pytest.approx(1.4, abs=0.021))
        assert surrogate_safety.pet(second, first, below=1.45) == pytest.approx(1.4, abs=0.021)
        assert surrogate_safety.pet(first, second) == np.inf


@pytest.mark.parametrize("substeps", [29, 30, 31, 35])
def test_pet_is_exact_to_a_tenth_of_a_step(substeps: int):
    """Both drive 1 m per tenth of a step; n + 0.5 m between rear and front close to less than 0 after n + 1 tenths."""
    time = np.arange(0, 9.0)
    rear, front = track(10 * time, 10.0, time=time), track(5 + substeps - 0.5 + 10 * time, 10.0, time=time)
    assert surrogate_safety.pet(rear, front) == substeps / 10


def test_vehicles_that_touch_at_the_first_instant_alone_have_no_time_between_them():
    """The one ahead begins with its rear 1 m inside the other, and drives away with 30 m/s."""
    ahead, standing = track([4.0, 34.0, 64.0], 30.0, time=[0, 1, 2]), track(0.0, 0.0, time=[0, 1, 2])
    assert surrogate_safety.pet(ahead, standing) == 0.0


def test_a_vehicle_that_drives_inside_the_one_behind_it_has_no_time_between_them():
    time = np.arange(0, 3.05, 0.1)
    rear, front = track(10 * time, 10.0, time=time), track(4 + 10 * time, 10.0, time=time)
    assert surrogate_safety.pet(front, rear) == 0.0


def test_vehicles_back_to_back_are_in_contact_where_their_rears_overlap():
    """Fronts at 0 and −9.5, 5 m long, in opposite directions: rears at −5 and −4.5."""
    one, other = track(0.0, 0.0), replace(track(-9.5, 0.0), heading=np.full(2, np.pi))
    assert surrogate_safety.pet(other, one) == 0.0
    assert surrogate_safety.pet(replace(other, xy=other.xy - [1.0, 0.0]), one) == np.inf


def test_box_distance_by_hand():
    """Rears at −5: side by side 3.5 m apart with 2 m width: 1.5 m. Diagonally 3 m along and 4 m across: 5 m."""
    one = track(0.0, 10.0)
    assert surrogate_safety.box_distance(one, track(0.0, 10.0, d=3.5)).tolist() == [1.5, 1.5]
    assert surrogate_safety.box_distance(one, track(8.0, 10.0, d=6.0)).tolist() == [5.0, 5.0]
    assert surrogate_safety.box_distance(one, track(12.0, 10.0)).tolist() == [7.0, 7.0]
    assert surrogate_safety.box_distance(one, track(4.9, 10.0)).tolist() == [0.0, 0.0]
    crossing = replace(one, heading=np.full(2, np.pi / 2), xy=np.array([[-2.5, 2.5]] * 2))  # a cross: no corner inside
    assert surrogate_safety.box_distance(one, crossing).tolist() == [0.0, 0.0]


pose = st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3.1, 3.1))


@given(pose, pose)
def test_box_distance_is_symmetric_and_no_sampled_points_are_nearer(p, q):
    boxes = [
        replace(track(0.0, 1.0), xy=np.array([[x, y]] * 2), heading=np.full(2, heading)) for x, y, heading in (p, q)
    ]
    distance = surrogate_safety.box_distance(*boxes)[0]
    assert surrogate_safety.box_distance(*boxes[::-1])[0] == pytest.approx(distance)
    points = [_outline(*pose) for pose in (p, q)]
    sampled = np.linalg.norm(points[0][:, None] - points[1][None], axis=-1).min()
    assert distance <= sampled + 1e-9
    if distance > 0:
        assert sampled < distance + 0.3


def _outline(x, y, heading) -> np.ndarray:
    u, w = np.linspace(-5, 0, 26), np.linspace(-1, 1, 11)
    body = np.concatenate([[(a, b) for a in u for b in (-1, 1)], [(a, b) for a in (-5, 0) for b in w]])
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    return body @ turn + [x, y]


def test_comfort_by_hand():
    braking = track(0.0, 10.0, time=[0, 0.5, 1, 1.5, 2], a=[0, -5, -5, -1, -6])
    assert surrogate_safety.jerk(braking).tolist() == [-10, 0, 8, -10]
    assert surrogate_safety.brakings(braking) == 2
    assert surrogate_safety.brakings(track(0.0, 10.0, a=-5.0)) == 1
    assert surrogate_safety.brakings(braking, 0.5) == 1, "the vehicle brakes on from 0.5 s to the end"
    assert surrogate_safety.brakings(braking, 5.0) == 1, "only the last one is harder than 5"


def test_lateral_change_and_effect_by_hand():
    """Together from 3.5 to 0.5 m: Δy = −3, wherever the lane is. A follower that brakes from 12 to 9 m/s loses 3."""
    one, other = track(0.0, 1.0, d=[6.5, 9.0, 9.5], time=[0, 1, 2]), track(9.0, 1.0, d=10.0, time=[0, 1, 2])
    assert surrogate_safety.lateral_change(one, other) == -3.0
    assert surrogate_safety.lateral_change(track(0.0, 1.0, d=[3.5, 0.5]), track(9.0, 1.0)) == -3.0
    effect = surrogate_safety.effect_on(track(0.0, [12.0, 9.0, 11.0], time=[0, 1, 2], a=[-7.0, -3.0, 2.0]))
    assert effect == {"follower_min_acceleration": -3.0, "follower_speed_loss": 3.0}


def test_conflicts_are_the_worst_of_all_pairs_with_a_driven_vehicle_behind():
    tracks = (track(0.0, 15.0), track(30.0, 10.0), track(50.0, 10.0))
    found = surrogate_safety.conflicts(tracks, (0, 1))
    assert found["min_ttc"] == 5.0
    assert found["max_drac"] == 0.5
    assert found["min_gap"] == 15.0
    assert found["min_distance"] == 15.0
    assert found["min_headway"] == 2.0
    assert surrogate_safety.conflicts(tracks[:2], (1,))["min_ttc"] == np.inf, "0 runs into 1, which is not its doing"
    assert surrogate_safety.conflicts((tracks[0], tracks[2]), (0,))["min_ttc"] == 9.0  # 50 − 5 m net, at 5 m/s


def test_a_vehicle_without_others_has_no_conflicts():
    found = surrogate_safety.conflicts([track(0.0, 15.0)], (0,))
    assert found.pop("max_drac") == found.pop("max_drac_to_others") == 0.0
    assert set(found.values()) == {np.inf}


def test_a_conflict_of_one_instant_has_no_pet_and_one_of_two_instants_has():
    rear, front = track([0.0, 10.0], 10.0), track([4.0, 14.0], 10.0)
    assert surrogate_safety.conflicts((rear, front), (0,))["min_pet"] == 0.0
    found = surrogate_safety.conflicts((rear[:1], front[:1]), (0,))
    assert (found["min_distance"], found["min_pet"]) == (0.0, np.inf)


@pytest.mark.parametrize("aside", [0.0, 40.0])
@pytest.mark.parametrize("speed", [10.0, 1.0])
def test_conflicts_find_the_pet_of_vehicles_that_cross_the_road(speed: float, aside: float):
    """A vehicle drives across the road to the left, over the place where a standing one has its rear.

    At x = −5.9 its right side is at −4.9, 0.1 m inside the standing one. Its body is 5 m behind its front, so that it
    is still there when its front is 3.5 m beside the road. The one that stands in its way is met at the same time.
    """
    time = np.arange(0, 3.05, 0.1)
    standing = track(0.0, 0.0, aside, time=time)
    for front in (speed * time - 1.5, speed * time + 3.5):
        passing = crossing_track(-5.9, aside + front, speed, time)
        assert surrogate_safety.conflicts((passing, standing), (0,))["min_pet"] == 0.0
        assert surrogate_safety.conflicts((standing, passing), (0,))["min_pet"] == 0.0
        clear = crossing_track(-6.1, aside + front, speed, time)
        assert surrogate_safety.conflicts((clear, standing), (0,))["min_pet"] == np.inf


def test_conflicts_find_the_pet_of_a_standing_vehicle_at_an_angle():
    """It is turned by 0.2 rad: its rear corner is 5·sin 0.2 + cos 0.2 = 1.97 m beside its front.

    The side of the other vehicle is 1.7 m beside it, and passes the corner.
    """
    time = np.arange(0, 3.05, 0.1)
    turned = replace(track(0.0, 0.0, time=time), heading=np.full(len(time), 0.2))
    passing = track(10 * time - 15.0, 10.0, -2.7, time=time)
    assert surrogate_safety.conflicts((passing, turned), (0,))["min_pet"] == 0.0
    assert surrogate_safety.conflicts((turned, passing), (0,))["min_pet"] == 0.0


def test_the_pair_of_the_second_and_the_first_leader_counts_as_any_other():
    """1 closes up on 2 with 5 m/s over 15 m; 0 keeps behind 1."""
    tracks = (track(0.0, 15.0), track(30.0, 15.0), track(50.0, 10.0))
    assert surrogate_safety.conflicts(tracks, (0, 1))["min_ttc"] == 3.0


def test_vehicles_outside_the_group_have_measures_of_their_own():
    """A standing vehicle 20 m net ahead of 0, which drives 10 m/s: TTC 2 s, DRAC 100/40; 1 m beside 1: distance 1 m."""
    time = np.arange(0, 3.1, 0.5)
    member, beside = track(10 * time, 10.0, time=time), track(200 + 10 * time, 10.0, time=time)
    others = (
        track(25.0, 0.0, time=time),
        track(195 + 10 * time, 10.0, 3.0, time=time),
        track(5.0, 0.0, time=time + 99),
    )
    found = surrogate_safety.conflicts((member, beside), (0, 1), others)
    alone = surrogate_safety.conflicts((member, beside), (0, 1))
    assert {name: value for name, value in found.items() if not name.endswith("_to_others")} == {
        name: value for name, value in alone.items() if not name.endswith("_to_others")
    }
    assert surrogate_safety.conflicts((member[:1], beside[:1]), (0, 1), others)["min_ttc_to_others"] == 2.0
    assert surrogate_safety.conflicts((member[:1], beside[:1]), (0, 1), others)["max_drac_to_others"] == 2.5
    assert found["min_ttc_to_others"] == 0.0, "it drives into the standing vehicle at 2 s"
    assert found["min_pet_to_others"] == 0.0
    assert surrogate_safety.conflicts((beside,), (0,), others)["min_distance_to_others"] == pytest.approx(1.0)
    assert surrogate_safety.conflicts((beside,), (0,), others)["min_ttc_to_others"] == np.inf


@given(st.floats(-60, 60), st.floats(-4, 4), st.floats(0, 20))
def test_what_is_sorted_out_before_pet_has_none(s, d, v):
    time = np.arange(0, 4.1, 0.2)
    one, other = track(12 * time, 12.0, time=time), track(s + v * time, v, d + 0.1 * time, time=time)
    for second, first in ((one, other), (other, one)):
        if not surrogate_safety._paths_may_cross(second, first):
            assert surrogate_safety.pet(second, first) == np.inf


def test_conflicts_are_looked_for_only_while_both_are_there():
    short = track([100.0, 5.0], 0.0, time=[1.0, 2.0])
    long = track([0.0, 10.0, 20.0, 30.0], 10.0, time=[0.0, 1.0, 2.0, 3.0])
    assert surrogate_safety.conflicts((long, short), (0,))["min_headway"] == 9.0  # at 1 s: (100 − 10)/10
    assert surrogate_safety.conflicts((long, track(5.0, 0.0, time=[7.0, 8.0])), (0,))["min_ttc"] == np.inf


def test_comfort_of_several_vehicles():
    calm, braking = track(0.0, 1.0, time=[0, 1, 2]), track(0.0, 1.0, time=[0, 1, 2], a=[0, -6, 0])
    found = surrogate_safety.comfort((calm, braking))
    assert found == {
        "jerk_50": 3.0, "jerk_95": 6.0, "jerk_99": 6.0, "min_acceleration": -6.0,
        "brakings_2": 1.0, "brakings_3": 1.0, "hard_brakings": 1.0,
    }  # fmt: skip


def test_one_instant_has_no_jerk():
    found = surrogate_safety.comfort((track(0.0, 1.0, time=[0.0], a=-5.0),))
    assert [found[f"jerk_{q}"] for q in (50, 95, 99)] == [0.0] * 3
    assert (found["min_acceleration"], found["hard_brakings"]) == (-5.0, 1.0)


def test_measures_do_not_depend_on_where_the_road_begins():
    tracks = (track([0.0, 14], 15.0), track([30.0, 41], 10.0), track([50.0, 60], 10.0))
    moved = tuple(replace(t, s=t.s + 777, xy=t.xy + np.array([777.0, 0.0])) for t in tracks)
    assert surrogate_safety.conflicts(moved, (0, 1)) == pytest.approx(surrogate_safety.conflicts(tracks, (0, 1)))


# SUMO's SSM device


def simulated(folder: Path, net: Path, routes: str, road: RoadFrame, steps: int, **options) -> dict[str, Track]:
    """Tracks of all vehicles of a run in which SUMO's SSM device watches as well."""
    (folder / "r.rou.xml").write_text(routes)
    arguments = {
        "net-file": net, "route-files": folder / "r.rou.xml", "step-length": 0.2, "default.speeddev": 0,
        "device.ssm.probability": 1, "device.ssm.measures": "TTC DRAC PET", "device.ssm.thresholds": "20 0.01 9",
        "device.ssm.range": 100, "device.ssm.extratime": 5, "device.ssm.file": folder / "ssm.xml",
        "collision.action": "warn", "collision.mingap-factor": 0, "no-step-log": "true", "no-warnings": "true",
        "xml-validation": "never", "error-log": folder / "log", **options,
    }  # fmt: skip
    snapshots = []
    with sumo([token for k, v in arguments.items() for token in (f"--{k}", str(v))], folder / "log") as world:
        for _ in range(steps):
            world.step()
            snapshots.append(world.snapshot(road))
    found = {}
    for name in {name for snapshot in snapshots for name in snapshot.ids}:
        seen = [(snapshot, snapshot.ids.index(name)) for snapshot in snapshots if name in snapshot.ids]
        s, d, v, a, heading, length, width = (
            np.array([getattr(snapshot, key)[row] for snapshot, row in seen])
            for key in ("s", "d", "v", "a", "heading", "length", "width")
        )
        xy = np.array([snapshot.xy[row] for snapshot, row in seen])
        time = np.array([snapshot.time for snapshot, _ in seen])
        found[name] = Track(time, s, d, v, a, xy, heading, float(length[0]), float(width[0]))
    return found


def conflict(folder: Path, ego: str, foe: str) -> ElementTree.Element:
    root = ElementTree.parse(folder / "ssm.xml").getroot()
    return next(c for c in root.iter("conflict") if (c.get("ego"), c.get("foe")) == (ego, foe))


def worst(element: ElementTree.Element, name: str) -> tuple[float, float]:
    """(value, time) of a conflict's worst value."""
    found = element.find(name)
    assert found is not None
    return float(found.get("value", "nan")), float(found.get("time", "nan"))


FOLLOWING = """<routes>
<vType id="car" length="5" width="1.8" accel="2" decel="3.5" sigma="0" tau="1.0"/>
<vType id="slow" length="7" width="1.8" accel="2" decel="3.5" sigma="0" maxSpeed="6"/>
<route id="r" edges="entry weave exit"/>
<vehicle id="slow" type="slow" route="r" depart="0" departLane="3" departPos="120" departSpeed="6"/>
<vehicle id="fast" type="car" route="r" depart="0" departLane="3" departPos="10" departSpeed="20">
  <param key="lcSpeedGain" value="0"/></vehicle>
</routes>""".replace("<vType id", '<vType lcSpeedGain="0" lcStrategic="0" lcCooperative="0" lcKeepRight="0" id')


def test_ttc_and_drac_agree_with_sumo(tmp_path):
    """A fast vehicle closes up on a slow one.

    SUMO prints values to 0.01, which is the tolerance. It looks at the same instants, so nothing else differs.
    """
    net = shipped("sumo_nets/us101/us101.net.xml")
    road = RoadFrame(np.array([[0.0, 0.0], [640.0, 0.0]]))
    tracks = simulated(tmp_path, net, FOLLOWING, road, 120)
    both = np.isin(tracks["fast"].time, tracks["slow"].time)
    fast = tracks["fast"]
    assert both.all()
    element = conflict(tmp_path, "fast", "slow")
    ttc, drac = surrogate_safety.ttc(fast, tracks["slow"]), surrogate_safety.drac(fast, tracks["slow"])
    value, time = worst(element, "minTTC")
    assert value == pytest.approx(ttc.min(), abs=0.006)
    assert time == pytest.approx(fast.time[ttc.argmin()], abs=0.2 + 1e-6)
    value, time = worst(element, "maxDRAC")
    assert value == pytest.approx(drac.max(), abs=0.006)
    assert drac.max() > 0.3


CROSSING = """<routes>
<vType id="car" length="5" width="1.8" accel="2" decel="3.5" sigma="0"/>
<vehicle id="first" type="car" depart="0" departPos="100" departSpeed="13"><route edges="south north"/></vehicle>
<vehicle id="second" type="car" depart="0" departPos="60" departSpeed="13"><route edges="west east"/></vehicle>
</routes>"""


@pytest.fixture(scope="module")
def crossing(tmp_path_factory) -> Path:
    """Two one-lane roads that cross at a right angle in the origin."""
    from sumo_nets.build import find_netconvert

    folder = tmp_path_factory.mktemp("crossing")
    places = {"w": (-200, 0), "e": (200, 0), "s": (0, -200), "n": (0, 200), "m": (0, 0)}
    nodes = "".join(f'<node id="{name}" x="{x}" y="{y}"/>' for name, (x, y) in places.items())
    ways = {"west": ("w", "m", 1), "east": ("m", "e", 1), "south": ("s", "m", 2), "north": ("m", "n", 2)}
    edges = "".join(
        f'<edge id="{name}" from="{a}" to="{b}" priority="{p}" numLanes="1" speed="13" spreadType="center"/>'
        for name, (a, b, p) in ways.items()
    )
    (folder / "n.nod.xml").write_text(f"<nodes>{nodes}</nodes>")
    (folder / "e.edg.xml").write_text(f"<edges>{edges}</edges>")
    command = [find_netconvert(), f"--node-files={folder}/n.nod.xml", f"--edge-files={folder}/e.edg.xml"]
    command += [f"--output-file={folder}/net.net.xml", "--no-turnarounds", "--xml-validation=never"]
    command += ["--offset.disable-normalization"]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "net.net.xml"


def test_pet_agrees_with_sumo(tmp_path, crossing):
    """One vehicle crosses in front of another, which yields.

    SUMO takes the moments at which the vehicles leave and enter an area as wide as they are, interpolated; here whole
    boxes meet, looked at every 0.02 s. Both see the same, up to two of those.
    """
    tracks = simulated(tmp_path, crossing, CROSSING, RoadFrame(np.array([[-200.0, 0.0], [200.0, 0.0]])), 100)
    value, _ = worst(conflict(tmp_path, "second", "first"), "PET")
    assert value == pytest.approx(surrogate_safety.pet(tracks["second"], tracks["first"]), abs=0.04)
    assert surrogate_safety.pet(tracks["first"], tracks["second"]) == np.inf


def test_the_least_distance_of_many_pairs_is_that_of_every_pair():
    """Pairs that are too far apart are left out; some of these overlap, some are close, some far."""
    draw = np.random.default_rng(5)
    for spread in (5.0, 20.0, 80.0):
        tracks = [
            replace(
                track(draw.uniform(-spread, spread), 10.0, d=draw.uniform(-8, 8)), heading=draw.uniform(-0.5, 0.5, 2)
            )
            for _ in range(6)
        ]
        pairs = [(one, other) for one in tracks for other in tracks if one is not other]
        least = min(float(surrogate_safety.box_distance(*pair).min()) for pair in pairs)
        assert surrogate_safety._least_distance(pairs) == least
    assert surrogate_safety._least_distance([]) == np.inf


def test_comfort_without_an_instant_is_unknown():
    nothing = track(0.0, 1.0, time=[])
    assert all(np.isnan(value) for value in surrogate_safety.comfort((nothing, nothing)).values())
    one = surrogate_safety.comfort((nothing, track(0.0, 1.0, time=[0.0], a=-5.0)))
    assert (one["min_acceleration"], one["hard_brakings"]) == (-5.0, 1.0)
    assert one.keys() == surrogate_safety.comfort((nothing,)).keys()
