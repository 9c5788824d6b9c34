"""Angles, road coordinates and the model's frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.world.road_frame import NOMINAL_LENGTH, RoadFrame, heading_of, model_offsets, sumo_angle_of

CURVE = RoadFrame(np.array([[0.0, 0.0], [100.0, 0.0], [180.0, 60.0], [180.0, 200.0]]), origin=100.0)


def test_headings_by_hand():
    # East is 90 degrees for a navigator and 0 for a mathematician, north is 0 and pi/2.
    angles = np.array([90.0, 0.0, 270.0, 180.0, 45.0])
    np.testing.assert_allclose(heading_of(angles), [0, np.pi / 2, np.pi, -np.pi / 2, np.pi / 4], atol=1e-12)


@given(st.floats(-3.14, 3.14))
def test_angle_round_trip(heading: float):
    assert heading_of(np.array([sumo_angle_of(heading)]))[0] == pytest.approx(heading, abs=1e-9)


def test_origin_is_where_s_is_zero():
    s, d = CURVE.to_road(np.array([[100.0, 0.0], [50.0, 2.0], [180.0, 60.0]]))
    np.testing.assert_allclose(s, [0.0, -50.0, 100.0])  # the oblique piece is 100 m long: 80, 60
    np.testing.assert_allclose(d, [0.0, 2.0, 0.0], atol=1e-12)


@given(st.floats(-150, 330), st.floats(-4, 4))
def test_road_round_trip_away_from_the_corners(s: float, d: float):
    corner_distance = min(abs(s - 0.0), abs(s - 100.0))
    if corner_distance < 5:
        return
    xy, _ = CURVE.to_world(np.array([s]), np.array([d]))
    back = CURVE.to_road(xy)
    np.testing.assert_allclose([back[0][0], back[1][0]], [s, d], atol=1e-9)


def test_road_heading_is_the_direction_of_the_piece():
    _, heading = CURVE.to_world(np.array([-50.0, 50.0, 200.0]), np.zeros(3))
    np.testing.assert_allclose(heading, [0.0, np.arctan2(60, 80), np.pi / 2])


def test_model_headway_is_net_gap_plus_nominal_length():
    # 0 stands 10 m behind the rear of 1 (a 12 m truck), which stands 20 m behind the rear of 2 (4 m long).
    s = np.array([[0.0, 22.0, 46.0]])
    length = np.array([[5.0, 12.0, 4.0]])
    x = s + model_offsets(length)
    np.testing.assert_allclose(np.diff(x), [[10 + NOMINAL_LENGTH, 20 + NOMINAL_LENGTH]])
    assert x[0, 0] == 0.0


def test_model_offsets_follow_the_order_of_the_road():
    offsets = model_offsets(np.array([[6.0, 5.0, 7.0]]), order=(1, 0, 2))
    np.testing.assert_allclose(offsets, [[-1.0, 0.0, -3.0]])
