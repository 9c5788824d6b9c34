"""World and model states say the same."""

import numpy as np

from cosim.loop.state_layouts import PlanarLayout, layout_of
from cosim.spec.scenario import CarFollowing, Merge
from cosim.world.episode import COLUMNS
from cosim.world.road_frame import RoadFrame
from gri.core.dynamics import DUBINS

ROAD = RoadFrame(np.array([[0.0, 0.0], [100.0, 0.0], [180.0, 60.0]]))  # turns left by atan(3/4)
LENGTH = np.array([[4.0, 5.0, 7.0]])


def observed(heading: float = 0.0) -> np.ndarray:
    values = {"s": (30.0, 20.0, 50.0), "d": (-8.0, -4.2, -4.2), "heading": (heading,) * 3, "v": (9.0, 8.0, 7.0)}
    return np.stack([np.array([values.get(name, (0.5, 0.0, -1.0))]) for name in COLUMNS], -1)


def test_dubins_states_count_from_the_target_lane_and_the_road():
    layout = layout_of(Merge(lane="a_0", zone=(0, 1)), ROAD, observed(), LENGTH)
    state = layout.states(observed(heading=0.1))
    # From the rear: 1 at 20, 0 at 30 (4 m long, counts 1 m further on), 2 at 50 (7 m long: 1 − 2 m).
    np.testing.assert_allclose(state[0, :, 0], [31.0, 20.0, 49.0], rtol=1e-12)
    np.testing.assert_allclose(state[0, :, 1], [-3.8, 0.0, 0.0], rtol=1e-12)
    np.testing.assert_allclose(state[0, 0, 2:], [9.0, 0.1, 0.5, 0.0], rtol=1e-12)
    assert layout.dynamics is DUBINS


def test_heading_counts_from_the_road_where_the_vehicle_is():
    layout = layout_of(Merge(lane="a_0", zone=(0, 1)), ROAD, observed(), LENGTH)
    assert isinstance(layout, PlanarLayout)
    beyond = observed(heading=float(np.arctan2(3, 4)) - 2 * np.pi)
    beyond[..., COLUMNS.index("s")] += 100.0
    np.testing.assert_allclose(layout.states(beyond)[..., 3], 0.0, atol=1e-12)


def test_a_pose_is_where_the_state_was_seen():
    for rule in (Merge(lane="a_0", zone=(0, 1)), CarFollowing()):
        layout = layout_of(rule, ROAD, observed(), LENGTH)
        pose = layout.pose(layout.states(observed()))
        for name in ("s", "d", "v", "a"):
            np.testing.assert_allclose(getattr(pose, name), observed()[..., COLUMNS.index(name)], atol=1e-12)
        assert pose.of(0, 2) == (50.0, -4.2, 0.0, 7.0)
