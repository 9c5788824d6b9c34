"""Who is near the groups of a round."""

import numpy as np

from cosim.loop.nearby_vehicles import Around, nearby_vehicles
from cosim.loop.state_layouts import Pose
from tests.cosim.world.traffic import snapshot


def test_everybody_in_reach_but_the_group_itself():
    now = snapshot(0.0, a=(0.0, 0.0), b=(20.0, 0.0), c=(40.0, 0.0), x=(25.0, 3.5, 12.0), y=(300.0, 0.0), z=(-60.0, 0.0))
    zero = np.zeros((2, 2))
    pose = Pose(np.array([[0.0, 20.0], [40.0, 40.0]]), zero, zero, zero, zero)
    near = nearby_vehicles(Around(now, [("a", "b"), ("c",)]), pose)
    assert near.present.tolist() == [[True, True, True, False], [True, True, True, True]]
    assert near.ahead[0, :, :3].tolist() == [[40.0, 25.0, -60.0], [20.0, 5.0, -80.0]]  # c, x, z
    assert near.across[0, 0, :3].tolist() == [0.0, 3.5, 0.0]
    assert near.v[0, :3].tolist() == [10.0, 12.0, 10.0]
    assert near.next_ahead()[0].tolist()[0] == [35.0, 15.0]


def test_where_the_lane_ends_and_the_mirror_image():
    """A merge to the right: what is on the right is on the left of the states."""
    now = snapshot(0.0, a=(0.0, 0.0), x=(25.0, 3.5, 12.0))
    pose = Pose(np.array([[0.0]]), *[np.zeros((1, 1))] * 4)
    near = nearby_vehicles(Around(now, [("a",)], lane_end=80.0, side=-1), pose)
    assert near.across.tolist() == [[[-3.5]]]
    assert near.lane_left is not None
    assert near.repeated(2).lane_left.tolist() == [[80.0], [80.0]]
    assert nearby_vehicles(Around(now, [("a",)]), pose).lane_left is None


def test_an_empty_road():
    now = snapshot(0.0, a=(0.0, 0.0), b=(20.0, 0.0))
    pose = Pose(np.array([[0.0, 20.0]]), *[np.zeros((1, 2))] * 4)
    assert nearby_vehicles(Around(now, [("a", "b")]), pose).next_ahead()[0].isinf().all()
