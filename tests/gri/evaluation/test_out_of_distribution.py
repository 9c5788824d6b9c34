import pytest
import torch

from gri.core.dynamics import DUBINS
from gri.core.graph import FOLLOWING, LANE_CHANGING
from gri.data.ranges.car_following import PAPER
from gri.data.synthetic.expert import model_config
from gri.evaluation.out_of_distribution import (
    Front,
    Protocol,
    area,
    at_headway,
    curve,
    drive_by_policy,
    follow_edge,
    mean_height,
    modal_edges,
    remaining_pair,
    score,
)
from gri.networks.decoder import DecoderConfig
from gri.networks.model import RelationalModel


def test_starts_keep_the_two_vehicles_and_get_the_headway():
    start = torch.tensor([[[0.0, 5.0, 0.0], [6.0, 4.0, 0.0], [13.0, 5.0, 0.0]]])
    pair = at_headway(remaining_pair(start, (0, 2)), -3.0)
    assert pair[0, :, 0].tolist() == [16.0, 13.0]
    assert pair[0, :, 1].tolist() == [5.0, 5.0]


def test_score_by_hand():
    state = torch.zeros(2, 2, 3, 6)
    state[:, 0, :, 0] = torch.tensor([[0.0, 1.0, 2.0], [0.0, 3.0, 6.0]])
    state[:, 1, :, 0] = torch.tensor([4.0, 5.0, 6.0])
    state[:, 0, :, 1] = torch.tensor([3.5, 3.5, 0.5])
    point = score(state, 4.0, Front.POLICY, Protocol(), DUBINS)
    assert point.success.mean == 0.5  # final headways 4 and 0
    assert point.collision.mean == 0.5  # least distances 4.03 and 0.5
    assert point.lateral.mean == pytest.approx(-3.0)


def test_forced_graphs():
    assert follow_edge(FOLLOWING).tolist() == [0, 1]
    assert follow_edge(LANE_CHANGING).tolist() == [0, 1]
    inferred = torch.tensor([[1, 0, 0, 0, 2, 3], [1, 0, 0, 0, 2, 3], [0, 0, 1, 0, 0, 0]])
    assert modal_edges(inferred, (0, 1), 3).tolist() == [1, 0]  # 0->1, 1->0
    assert modal_edges(inferred, (0, 2), 3).tolist() == [0, 2]  # 0->2, 2->0


def test_area_is_a_share_of_the_range():
    assert mean_height([(4.0, 1.0), (-8.0, 0.0)]) == pytest.approx(0.5)
    assert mean_height([(0.0, 1.0), (4.0, 1.0), (-4.0, 0.0)]) == pytest.approx(0.75)


def test_both_ways_to_drive_vehicle_1_are_run_with_two_vehicles():
    torch.manual_seed(0)
    model = RelationalModel(model_config(PAPER, DecoderConfig(hidden=8), None)).requires_grad_(False)
    start = torch.tensor([[[0.0, 5.0, 0.0], [6.0, 4.0, 0.0]]] * 3)
    drive = drive_by_policy(model, follow_edge(FOLLOWING), steps=5)
    given, free = drive(start, Front.CONSTANT_SPEED), drive(start, Front.POLICY)
    assert given.shape == free.shape == (3, 2, 6, 3)
    torch.testing.assert_close(given[0, 1, :, 1], torch.full((6,), 4.0))
    assert not torch.allclose(free[0, 1, :, 1], torch.full((6,), 4.0))
    points = curve(drive, start, Protocol(headways=(4.0, 0.0)), model.dynamics)
    assert [(p.front, p.headway) for p in points] == [(f, h) for f in Front for h in (4.0, 0.0)]
    assert 0 <= area(points, Front.POLICY) <= 1
