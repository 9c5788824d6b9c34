"""The collision test of oriented boxes, against numbers worked by hand and against a brute-force test."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cosim.measures.collision_detection import Boxes, box_centre, boxes_overlap, overlapping_pairs
from cosim.measures.surrogate_safety import net_gap, time_to_collision


def _boxes(*poses: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    pose = np.array(poses, dtype=float)
    n = len(poses)
    return pose[:, :2], pose[:, 2], np.full(n, 4.0), np.full(n, 2.0)


def test_front_bumper_is_the_reference_point():
    # Boxes are 4 m long: fronts at 0 and 3.9 m overlap, at 0 and 4.0 m they touch, which is no overlap.
    assert overlapping_pairs(*_boxes((0, 0, 0), (3.9, 0, 0)), np.array([0])).size
    assert not overlapping_pairs(*_boxes((0, 0, 0), (4.0, 0, 0)), np.array([0])).size


def test_the_centre_is_half_a_length_behind_the_front_bumper():
    centres = box_centre(np.array([[10.0, 2.0], [0.0, 0.0]]), np.array([np.pi / 2, np.pi]), np.array([4.0, 6.0]))
    np.testing.assert_allclose(centres, [[10.0, 0.0], [3.0, 0.0]], atol=1e-12)


def test_neighbours_in_the_next_lane_do_not_touch():
    assert not overlapping_pairs(*_boxes((0, 0, 0), (0, 2.0, 0)), np.array([0])).size
    assert overlapping_pairs(*_boxes((0, 0, 0), (0, 1.9, 0)), np.array([0])).size


def test_rotated_box_needs_its_own_axes():
    # The first box has its corner at (0, 1). A box heading -45 degrees, front at (2.5, 0.5), passes it: seen from that
    # box the corner lies at w = (-2.5 + 0.5) / sqrt(2) = -1.41, beyond its side, though their bounding boxes overlap.
    # With the front at (1.8, 0.5) the corner lies at w = -0.92, inside.
    far, near = (2.5, 0.5, -np.pi / 4), (1.8, 0.5, -np.pi / 4)
    assert not overlapping_pairs(*_boxes((0, 0, 0), far), np.array([0])).size
    assert overlapping_pairs(*_boxes((0, 0, 0), near), np.array([0])).size


def test_the_exact_test_alone_knows_touching_from_overlapping():
    """4 m long and 2 m wide: 4 m along and 2 m across touch; a right angle needs (4 + 2)/2 = 3 m between centres."""
    one = Boxes(*_boxes(*[(0, 0, 0)] * 6))
    other = Boxes(*_boxes((3.5, 0, 0), (4, 0, 0), (5, 0, 0), (0, 1.5, 0), (0, -2, 0), (0, -3, 0)))
    assert boxes_overlap(one, other).tolist() == [True, False, False, True, False, False]
    crossing = Boxes(
        *_boxes(*[(x, 2, np.pi / 2) for x in (0.875, 1.125, -4.875, -5.125)])
    )  # their centres are at (x, 0)
    assert boxes_overlap(one[np.arange(4)], crossing).tolist() == [True, False, True, False]
    assert boxes_overlap(crossing, one[np.arange(4)]).tolist() == [True, False, True, False]


def test_a_box_at_45_degrees_is_apart_along_the_axis_of_the_other_alone():
    """Half of its extent along x is (4 + 2)/2 · cos 45° = 2.12 m; with 2 m of the other box 4.12 m between centres."""
    turned = [(-2 + apart + 2 * np.cos(np.pi / 4), 2 * np.sin(np.pi / 4), np.pi / 4) for apart in (4.1, 4.15)]
    one, other = Boxes(*_boxes((0, 0, 0), (0, 0, 0))), Boxes(*_boxes(*turned))
    assert boxes_overlap(one, other).tolist() == boxes_overlap(other, one).tolist() == [True, False]


def test_a_box_does_not_hit_itself_and_rows_select_the_tested_vehicles():
    hits = overlapping_pairs(*_boxes((0, 0, 0), (1, 0, 0), (50, 0, 0)), np.array([1, 2]))
    assert hits.tolist() == [[1, 0]]


pose = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-3.1, 3.1))


@given(pose, pose)
def test_overlap_is_symmetric_and_agrees_with_sampling(a, b):
    boxes = _boxes(a, b)
    hits = overlapping_pairs(*boxes, np.array([0, 1])).tolist()
    assert hits in ([], [[0, 1], [1, 0]])
    if _sampled_overlap(a, b):
        assert hits


def _sampled_overlap(a, b) -> bool:
    """Whether any of many points of box a lies inside box b (a lower bound of the truth)."""
    along, across = np.meshgrid(np.linspace(-4, 0, 25), np.linspace(-1, 1, 13))
    x = a[0] + along * np.cos(a[2]) - across * np.sin(a[2])
    y = a[1] + along * np.sin(a[2]) + across * np.cos(a[2])
    dx, dy = x - b[0], y - b[1]
    u = dx * np.cos(b[2]) + dy * np.sin(b[2])
    w = -dx * np.sin(b[2]) + dy * np.cos(b[2])
    return bool(((u > -4 + 1e-6) & (u < -1e-6) & (np.abs(w) < 1 - 1e-6)).any())


def test_gap_and_time_to_collision_by_hand():
    # 30 m between fronts, 5 m of vehicle ahead: 25 m net. Closing at 15 - 10 = 5 m/s: 5 s.
    assert net_gap(np.array([0.0]), np.array([30.0]), np.array([5.0])).tolist() == [25.0]
    gap, behind, ahead = np.array([25.0, 25.0, -1.0]), np.array([15.0, 10.0, 11.0]), np.array([10.0, 10.0, 10.0])
    assert time_to_collision(gap, behind, ahead).tolist() == [5.0, np.inf, 0.0]
