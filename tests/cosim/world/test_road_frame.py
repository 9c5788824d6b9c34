"""Angles, road coordinates and the model's frame."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.world.road_frame import (
    EXTENSION,
    NOMINAL_LENGTH,
    LaneLine,
    LanePlace,
    RoadFrame,
    heading_of,
    model_offsets,
    sumo_angle_of,
)

CURVE = RoadFrame(np.array([[0.0, 0.0], [100.0, 0.0], [180.0, 60.0], [180.0, 200.0]]), origin=100.0)

RADIUS, TURN, PIECES = 50.0, 0.05, 20  # a bend to the left around (0, 50) from the origin on, 1 rad in pieces of 0.05
ANGLES = TURN * np.arange(PIECES + 1)
OUTWARD = np.stack([np.sin(ANGLES), -np.cos(ANGLES)], axis=1)
PIECE = 2 * RADIUS * np.sin(TURN / 2)  # [m], the length of each of them
BEND = RoadFrame(np.array([0.0, RADIUS]) + RADIUS * OUTWARD, normals=-OUTWARD)
SHORT = RoadFrame(np.array([0.0, 5.0]) + 5 * OUTWARD, normals=-OUTWARD)  # the same with 5 m of radius: pieces of 0.25 m
TWISTED = RoadFrame(  # a road that widens and narrows: the normals turn and are not of the same length
    np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 5.0], [60.0, 5.0]]),
    normals=np.array([[0.0, 1.0], [-0.3, 1.2], [-0.1, 0.8], [0.0, 1.0]]),
)
STRAIGHT = RoadFrame(np.array([[10.0, 20.0], [40.0, 60.0]]), origin=20.0)  # 50 m to (0.6, 0.8)
FLAT = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 3.5], [200.0, 3.5]])
ASIDE = RoadFrame(FLAT, normals=np.tile([0.0, 1.0], (4, 1)), jumps=(1,))  # goes on 3.5 m to the left of its end


def mirrored(road: RoadFrame) -> RoadFrame:
    """The same road in a world with traffic on the left: y the other way round."""
    normals = None if road.normals is None else road.normals * [1, -1]
    return RoadFrame(road.points * [1, -1], road.origin, normals, road.jumps, mirrored=True)


def test_headings_by_hand():
    # East is 90 degrees for a navigator and 0 for a mathematician, north is 0 and pi/2.
    angles = np.array([90.0, 0.0, 270.0, 180.0, 45.0])
    np.testing.assert_allclose(heading_of(angles), [0, np.pi / 2, np.pi, -np.pi / 2, np.pi / 4], atol=1e-12)


def test_angles_are_from_0_to_360_and_headings_above_minus_pi():
    assert [sumo_angle_of(x) for x in (0.0, np.pi / 2, np.pi, -np.pi / 2)] == pytest.approx([90.0, 0.0, 270.0, 180.0])
    assert heading_of(np.array([270.0, 630.0, -90.0])) == pytest.approx([np.pi] * 3)


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


def test_a_straight_road_by_hand():
    """5 m along and 2 m to the left of the start: (10, 20) + 5·(0.6, 0.8) + 2·(−0.8, 0.6); s = 0 is after 20 m."""
    xy, heading = STRAIGHT.to_world(np.array([-15.0, 30.0]), np.array([2.0, 0.0]))
    np.testing.assert_allclose(xy, [[11.4, 25.2], [40.0, 60.0]])
    np.testing.assert_allclose(heading, np.arctan2(4, 3))
    np.testing.assert_allclose(STRAIGHT.to_road(xy), [[-15.0, 30.0], [2.0, 0.0]], atol=1e-12)
    assert STRAIGHT.end == 30.0
    assert STRAIGHT.straight_line == pytest.approx((10, 20, 0.6, 0.8, -0.8, 0.6, 20, 0, np.arctan2(4, 3)))
    assert STRAIGHT.line_at(3.5) is None
    s, d = np.array([-5.0, 5.0]), np.array([3.0, -3.0])
    assert STRAIGHT.stretch_at(s, d).tolist() == [1.0, 1.0]
    assert STRAIGHT.curvature_at(s, d).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("road", [BEND, ASIDE, CURVE, mirrored(STRAIGHT)])
def test_only_a_straight_road_that_is_not_mirrored_has_a_straight_line(road: RoadFrame):
    assert road.straight_line is None
    assert road.is_straight == (len(road.points) == 2)


def test_a_bend_by_hand():
    """Between two vertices the road is their chord; its normals point to the centre at the vertices."""
    xy, heading = BEND.to_world(np.array([0.0, PIECE, 1.5 * PIECE]), np.array([10.0, 10.0, 0.0]))
    np.testing.assert_allclose(xy[0], [0.0, 10.0], atol=1e-12)
    np.testing.assert_allclose(xy[1], [40 * np.sin(TURN), 50 - 40 * np.cos(TURN)])
    chord = RADIUS * np.cos(TURN / 2)  # how far its middle is from the centre
    np.testing.assert_allclose(xy[2], [chord * np.sin(1.5 * TURN), RADIUS - chord * np.cos(1.5 * TURN)])
    np.testing.assert_allclose(heading, [0.0, TURN, 1.5 * TURN], atol=1e-12)
    assert BEND.end == pytest.approx(PIECES * PIECE)


ROADS = [BEND, RoadFrame(BEND.points, 20.0, BEND.normals), mirrored(BEND), SHORT, TWISTED]


@pytest.mark.parametrize("road", ROADS)
@given(share=st.floats(-0.5, 1.5), d=st.floats(-0.4, 0.4))
def test_road_round_trip_in_a_bend(road: RoadFrame, share: float, d: float):
    """Up to 0.4 of 50 m (5 m in the short bend) to either side, and beyond the ends."""
    s = np.array([share * (road.end + road.origin) - road.origin])
    d *= 5.0 if road is SHORT else 10.0 if road is TWISTED else 50.0
    xy, _ = road.to_world(s, np.array([d]))
    np.testing.assert_allclose(road.to_road(xy), [s, [d]], atol=1e-7)


def test_a_bend_goes_on_straight_beyond_its_ends():
    """The last piece of the bend leads to 0.975 rad; 30 m farther on its normal is still that of the last vertex."""
    xy, heading = BEND.to_world(np.array([-30.0, BEND.end + 30.0]), np.zeros(2))
    step = np.array([np.cos(TURN / 2), np.sin(TURN / 2)])
    np.testing.assert_allclose(xy[0], -30 * step, atol=1e-9)
    last = np.array([np.cos(1 - TURN / 2), np.sin(1 - TURN / 2)])
    np.testing.assert_allclose(xy[1], BEND.points[-1] + 30 * last)
    np.testing.assert_allclose(heading, [0.0, 1.0], atol=1e-9)
    far = BEND.to_world(np.array([-EXTENSION - 50, BEND.end + EXTENSION + 50]), np.zeros(2))[0]
    np.testing.assert_allclose(BEND.to_road(far)[0], [-EXTENSION - 50, BEND.end + EXTENSION + 50])


def test_mirrored_roads_have_the_same_coordinates_in_a_mirrored_world():
    for road in (STRAIGHT, BEND, ASIDE, CURVE):
        other = mirrored(road)
        assert (road.side, other.side) == (1, -1)
        s, d = np.array([-5.0, 12.0, 25.0]), np.array([1.0, 0.5, -2.0])
        (xy, heading), (there, turned) = road.to_world(s, d), other.to_world(s, d)
        np.testing.assert_allclose(there, xy * [1, -1], atol=1e-9)
        np.testing.assert_allclose(turned, -heading, atol=1e-12)
        np.testing.assert_allclose(other.to_road(there), [s, d], atol=1e-9)
        np.testing.assert_allclose(other.curvature_at(s, d), road.curvature_at(s, d), atol=1e-12)
        np.testing.assert_allclose(other.stretch_at(s, d), road.stretch_at(s, d), atol=1e-12)


def test_a_road_may_go_on_beside_its_end():
    """Up to x = 100 along y = 0, and from there on along y = 3.5: no metre is lost or driven twice."""
    world = np.array([[50.0, 1.0], [99.9, 0.0], [100.1, 3.5], [150.0, 4.5], [150.0, 0.0], [101.0, 0.2], [99.0, 3.4]])
    s, d = ASIDE.to_road(world)
    np.testing.assert_allclose(s, world[:, 0], atol=1e-9)
    np.testing.assert_allclose(d, [1.0, 0.0, 0.0, 1.0, -3.5, -3.3, 3.4], atol=1e-9)
    np.testing.assert_allclose(ASIDE.to_world(s, d)[0], world, atol=1e-9)
    assert ASIDE.end == 200.0
    line = ASIDE.line_at(2.0)
    assert line is not None
    np.testing.assert_allclose(line.driven(s), s, atol=1e-9)
    assert ASIDE.stretch_at(s, d).tolist() == [1.0] * 7
    assert ASIDE.heading_at(np.array([99.0, 100.0, 101.0])).tolist() == [0.0] * 3


def test_a_road_that_passes_itself_is_told_by_what_is_known_of_s():
    """A hairpin: out along y = 0 and back along y = 10. A point at y = 4 is nearer to the way out."""
    hairpin = RoadFrame(np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 10.0], [0.0, 10.0]]), origin=10.0)
    xy = np.array([[50.0, 4.0]])
    np.testing.assert_allclose(hairpin.to_road(xy), [[40.0], [4.0]])
    for low, high, wanted in ((0.0, 80.0, (40.0, 4.0)), (140.0, 180.0, (150.0, 6.0)), (-900.0, 900.0, (40.0, 4.0))):
        found = hairpin.to_road(xy, within=(np.array([low]), np.array([high])))
        np.testing.assert_allclose(np.ravel(found), wanted)
    nearer_back = np.array([[50.0, 6.0]])
    for low, high, wanted in ((0.0, 80.0, (40.0, 6.0)), (140.0, 180.0, (150.0, 4.0)), (2000.0, 2100.0, (150.0, 4.0))):
        found = hairpin.to_road(nearer_back, within=(np.array([low]), np.array([high])))
        np.testing.assert_allclose(np.ravel(found), wanted)


def test_the_curvature_of_a_bend_is_that_of_the_lane():
    """1/50 m on the line, counted over 20 m of arc; a lane 10 m to the inside has a radius of 40 m."""
    middle = np.full(3, 0.5 * BEND.end)
    on_line = 20 / PIECE * TURN / 20
    np.testing.assert_allclose(
        BEND.curvature_at(middle, np.array([0.0, 10.0, -50.0])),
        [on_line, on_line / (1 - 10 * on_line), on_line / (1 + 50 * on_line)],
        rtol=1e-3,
    )
    assert BEND.curvature_at(middle[:1], np.array([49.0]))[0] == pytest.approx(10 * on_line, rel=1e-3), "not endless"
    half = BEND.curvature_at(np.array([0.0, BEND.end]), np.zeros(2))  # only 10 m of the 20 are in the bend
    np.testing.assert_allclose(half, 0.5 * on_line, rtol=0.03)
    cos, sin = np.cos(np.pi - 0.5), np.sin(np.pi - 0.5)
    turned = np.array([[cos, sin], [-sin, cos]])  # headings from π − 0.5 to π + 0.5, which is −π + 0.5
    back = RoadFrame(BEND.points @ turned, normals=-OUTWARD @ turned)
    assert back.heading_at(np.array([0.0, BEND.end])) == pytest.approx([np.pi - 0.5, 0.5 - np.pi])
    np.testing.assert_allclose(back.curvature_at(middle, np.zeros(3)), on_line, rtol=1e-3)
    u_turn = RoadFrame(np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 5.0], [0.0, 5.0]]))
    assert u_turn.curvature_at(np.array([52.5]), np.zeros(1))[0] > 0, "a turn of nearly 180° keeps its side"


def test_lanes_beside_the_line_are_shorter_on_the_inside():
    """10 m to the left the radius is 40 m: 0.8 m per metre of the line."""
    inner, outer = BEND.line_at(10.0), BEND.line_at(-10.0)
    assert inner is not None
    assert outer is not None
    s = np.array([-30.0, 0.0, 5 * PIECE, BEND.end, BEND.end + 30.0])
    on_line = np.array([0.0, 0.0, 5 * PIECE, BEND.end, BEND.end])
    np.testing.assert_allclose(inner.driven(s), 0.8 * on_line + [-30, 0, 0, 0, 30], atol=1e-9)
    np.testing.assert_allclose(outer.driven(s), 1.2 * on_line + [-30, 0, 0, 0, 30], atol=1e-9)
    np.testing.assert_allclose(inner.s_at(inner.driven(s)), s, atol=1e-9)
    late = RoadFrame(BEND.points, 5 * PIECE, BEND.normals).line_at(10.0)  # s = 0 is in the bend
    assert late is not None
    np.testing.assert_allclose(late.driven(s - 5 * PIECE), inner.driven(s) - 4 * PIECE, atol=1e-9)
    middle = np.full(3, 5.5 * PIECE)
    stretch = BEND.stretch_at(middle, np.array([0.0, 10.0, -10.0]))
    np.testing.assert_allclose(stretch, [1.0, 0.8, 1.2])
    assert BEND.stretch_at(middle[:1], np.array([49.9])).tolist() == [0.1], "not less"


def test_a_lane_on_the_inside_of_a_sharp_corner_does_not_go_back():
    """The normals turn within 15 m of a right angle. 25 m to its left, a line would turn back on these 30 m."""
    corner = RoadFrame(np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 30.0]]))
    line = corner.line_at(25.0)
    assert line is not None
    assert (np.diff(line.distance) > 0).all()
    assert (np.diff(line.s) > 0).all()
    assert line.driven(np.array([0.0, 15.0, 60.0, 70.0])).tolist() == [0.0, 15.0, 30.0, 40.0]


def test_a_road_that_widens_has_longer_lines_by_as_much():
    """The normals of the first piece turn back by 0.3 and grow by 0.2: at d = 2 it is 0.6 m shorter and rises 0.4 m."""
    line = TWISTED.line_at(2.0)
    assert line is not None
    assert line.driven(np.array([0.0, 20.0])) == pytest.approx([0.0, np.hypot(19.4, 0.4)])
    assert TWISTED.stretch_at(np.array([5.0]), np.array([2.0]))[0] == pytest.approx(np.hypot(19.4, 0.4) / 20)
    short = SHORT.line_at(1.0)
    assert short is not None
    assert short.driven(np.array([SHORT.end]))[0] == pytest.approx(0.8 * SHORT.end)
    assert SHORT.stretch_at(np.array([0.5 * SHORT.end]), np.array([1.0]))[0] == pytest.approx(0.8)


def test_a_lane_line_goes_on_with_slope_1():
    line = LaneLine(np.array([0.0, 10.0, 20.0]), np.array([0.0, 8.0, 20.0]))
    np.testing.assert_allclose(line.driven(np.array([-3.0, 5.0, 15.0, 26.0])), [-3.0, 4.0, 14.0, 26.0])
    np.testing.assert_allclose(line.s_at(np.array([-3.0, 4.0, 14.0, 26.0])), [-3.0, 5.0, 15.0, 26.0])


def test_a_place_is_whole_without_a_first_and_a_last_position():
    places = (LanePlace(0.0, 9.0), LanePlace(0.0, 9.0, first=2.0), LanePlace(0.0, 9.0, last=7.0))
    assert [place.is_whole for place in places] == [True, False, False]


def test_a_repeated_point_has_no_direction():
    points = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 0.0], [20.0, 0.0]])
    road = RoadFrame(points, normals=np.tile([0.0, 1.0], (4, 1)))
    with np.errstate(invalid="ignore"), pytest.raises(AssertionError, match="repeated point"):
        road.to_road(np.zeros((1, 2)))


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
