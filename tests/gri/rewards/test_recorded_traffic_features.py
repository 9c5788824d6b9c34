import math

import pytest
import torch

from gri.core.dynamics import POINT_MASS_2D
from gri.core.graph import FOLLOWING, YIELDING, EdgeType
from gri.rewards.recorded_traffic_features import ReferenceNetworks, References, collision_point, g_spatial, g_time
from gri.rewards.structured import NaturalisticConfig, StructuredReward


def vehicle(*values: float) -> torch.Tensor:
    return torch.tensor([values], dtype=torch.float)


def test_references_begin_where_they_are_told_and_stay_positive():
    torch.manual_seed(0)
    h = ReferenceNetworks(References(speed=9.0, headway=6.0, time_headway=1.0, distance=20.0, time=2.0), yielding=True)
    speeds = torch.linspace(0, 30, 50)
    assert float(h.own_speed().detach()) == pytest.approx(9.0, rel=1e-4)
    with torch.no_grad():  # softplus adds to small values: 15 m ln(1 + e^x) of x = (6 + v) / 15
        expected = 15 * torch.log1p(((6 + speeds) / 15).exp())
        torch.testing.assert_close(h.headway(speeds, speeds), expected, rtol=0.15, atol=0.5)
        assert float(h.distance(speeds, speeds).mean()) == pytest.approx(20.0, rel=0.2)
        assert float(h.time(speeds, speeds).mean()) == pytest.approx(2.0, rel=0.2)
    for values in (h.speed(speeds * 3 - 40, speeds), h.headway(speeds, 30 - speeds), h.time(speeds, speeds)):
        assert (values > 0).all()


def test_who_follows_wants_to_close_a_surplus_and_the_network_corrects_it_by_little():
    # 20 m behind a vehicle at 10 m/s: 20 − 6 − 0.8·10 = 6 m too many, so 10 + 0.2·6 = 11.2 m/s, ± 0.5 m/s.
    h = ReferenceNetworks(References(headway=6.0, time_headway=0.8, closing=0.2, correction=0.5))
    last = h.h2[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        for extreme in (-1e3, 1e3):
            last.bias.fill_(extreme)
            wanted = 11.2 + 0.5 * (1 if extreme > 0 else -1)
            expected = 5 * math.log1p(math.exp(wanted / 5))  # softplus, which adds little at these speeds
            assert float(h.speed(torch.tensor(20.0), torch.tensor(10.0))) == pytest.approx(expected, rel=1e-4)


def test_a_surplus_headway_pulls_by_no_more_than_it_may():
    # 40 m behind a vehicle at 10 m/s: 40 − 6 − 0.8·10 = 26 m too many, 5.2 m/s faster, of which 1 is allowed.
    # 7 m behind it: 7 m too few, 1.4 m/s slower.
    h = ReferenceNetworks(References(headway=6.0, time_headway=0.8, closing=0.2, correction=0.0, catch_up=1.0))
    for headway, wanted in ((40.0, 11.0), (7.0, 8.6)):
        expected = 5 * math.log1p(math.exp(wanted / 5))
        assert h.speed(torch.tensor(headway), torch.tensor(10.0)).item() == pytest.approx(expected, rel=1e-4)


def test_collision_point_of_two_crossing_lines():
    # j goes along y = 0 at 10 m/s; i comes from 30 m ahead and 4 m to the left, 1 m/s to the right at 5 m/s ahead:
    # it meets y = 0 after 4 s at x = 50.
    point, counts = collision_point(vehicle(30, 4, 5, -1), vehicle(0, 0, 10, 0), farthest=100.0, overlap=2.0)
    assert point.tolist() == pytest.approx([50.0])
    assert counts.tolist() == [1.0]
    swapped, _ = collision_point(vehicle(0, 0, 10, 0), vehicle(30, 4, 5, -1), farthest=100.0, overlap=2.0)
    assert swapped.tolist() == pytest.approx([50.0])


@pytest.mark.parametrize(
    ("sender", "farthest"),
    [
        ((30, 4, 5, 0), 100.0),  # parallel
        ((30, 4, 5, 1), 100.0),  # they have met behind
        ((30, 4, 5, -1), 40.0),  # farther than counts
    ],
)
def test_points_out_of_range_do_not_count(sender: tuple, farthest: float):
    point, counts = collision_point(vehicle(*sender), vehicle(0, 0, 10, 0), farthest, overlap=2.0)
    assert counts.tolist() == [0.0]
    assert torch.isfinite(point).all()


@pytest.mark.parametrize(
    ("sender", "place"),
    [
        ((30, 1.5, 5, 0), 30.0),  # where the one ahead is
        ((30, -1.5, 5, 1), 30.0),  # lines that meet elsewhere do not matter
        ((-30, 1.5, 5, 0), None),  # whoever is ahead has nobody to keep away from
        ((120, 1.5, 5, 0), None),  # farther than counts
        ((30, 2.5, 5, 0), None),  # in the lane beside
    ],
)
def test_vehicles_of_one_lane_meet_where_the_one_ahead_is(sender: tuple, place: float | None):
    point, counts = collision_point(vehicle(*sender), vehicle(0, 0, 10, 0), farthest=100.0, overlap=2.0)
    assert counts.tolist() == [float(place is not None)]
    assert point.tolist() == [place or 0.0]
    assert collision_point(vehicle(30, 1.5, 5, 0), vehicle(0, 0, 10, 0), 100.0, overlap=0.0)[1].tolist() == [0.0]


def test_whoever_has_merged_keeps_the_headway_that_yielding_asks_for():
    # 12 m behind a vehicle at 10 m/s, 1.2 s: yielding to it wants 20 m and 2 s.
    sender, receiver = vehicle(12, 0.5, 10, 0), vehicle(0, 0, 10, 0)
    point, counts = collision_point(sender, receiver, 100.0, overlap=2.0)
    assert g_spatial(point, counts, receiver, torch.tensor([20.0]), printed=False).tolist() == pytest.approx([64.0])
    later = g_time(point, counts, sender, receiver, torch.tensor([2.0]), References())
    assert later.tolist() == pytest.approx([0.64])


def test_yielding_asks_for_distance_and_for_arriving_later():
    sender, receiver = vehicle(30, 4, 5, -1), vehicle(0, 0, 10, 0)
    point, counts = collision_point(sender, receiver, 100.0, overlap=2.0)
    wanted = torch.tensor([60.0])
    assert g_spatial(point, counts, receiver, wanted, printed=False).tolist() == pytest.approx([100.0])  # 60 - 50 m
    assert g_spatial(point, counts, receiver, wanted, printed=True).tolist() == [0.0]
    # Sender: 20 m at 5 m/s, 4 s; receiver: 50 m at 10 m/s, 5 s; it is to be 3 s later and is 1 s later.
    later = torch.tensor([3.0])
    assert g_time(point, counts, sender, receiver, later, References()).tolist() == pytest.approx([4.0])
    printed = g_time(point, counts, sender, receiver, later, References(printed_yield=True))
    assert printed.tolist() == pytest.approx([16.0])


def test_following_costs_what_the_formulas_say():
    reward = StructuredReward(NaturalisticConfig())
    assert reward.vocabulary == FOLLOWING
    h = reward.references
    assert h is not None
    sender, receiver = torch.tensor([[20.0, 8.0, 0.0]]), torch.tensor([[12.0, 10.0, 1.0]])
    wanted_speed, wanted_headway = (
        h.speed(torch.tensor([8.0]), torch.tensor([8.0])),
        h.headway(*torch.tensor([[8.0], [10.0]])),
    )
    features = reward.edge_features(EdgeType.FOLLOW, sender, receiver)
    expected = torch.stack([((10 - wanted_speed) / 2) ** 2, ((wanted_headway - 8).clamp(min=0) / 5) ** 2], -1)
    torch.testing.assert_close(features, expected)
    far = reward.edge_features(EdgeType.FOLLOW, sender + torch.tensor([200.0, 0, 0]), receiver)
    assert float(far[0, 1].detach()) == 0.0  # only being too close costs


def test_lane_changing_has_the_papers_terms():
    reward = StructuredReward(NaturalisticConfig(lanes=True))
    assert reward.vocabulary == YIELDING
    assert reward.names("yield") == ("spatial", "time")
    state = torch.tensor([[0.0, -3.5, 10.0, 0.5, 1.0, 0.2]])
    features = dict(zip(reward.names("node"), reward.node_features(state, torch.tensor([[2.0, 0.5]]))[0], strict=True))
    assert float(features["lane"].detach()) == pytest.approx(3.5**2)
    assert float(features["lateral_speed"].detach()) == pytest.approx(1.0)
    assert float(features["jerk"].detach()) == pytest.approx(4.0)
    assert POINT_MASS_2D.state[3] == "vy"
