import pytest
import torch

from gri.core.dynamics import POINT_MASS_1D, POINT_MASS_2D
from gri.core.graph import FOLLOWING, YIELDING, EdgeType
from gri.core.scenes import Scenes
from gri.data.ranges.recorded import NGSIM_CAR_FOLLOWING
from gri.data.synthetic.expert import model_config
from gri.evaluation import recorded_scores as scores
from gri.networks.decoder import DecoderConfig
from gri.networks.encoder import EncoderConfig
from gri.networks.model import RelationalModel


def row(*vehicles: tuple[float, float], steps: int = 4, dt: float = 0.2) -> torch.Tensor:
    """[1, N, T, 3] of vehicles (x, v) at constant speed."""
    time = dt * torch.arange(steps)
    parts = [torch.stack([x + v * time, torch.full_like(time, v), torch.zeros_like(time)], -1) for x, v in vehicles]
    return torch.stack(parts)[None]


def test_errors_by_hand():
    recorded = row((0.0, 10.0), (20.0, 10.0), (40.0, 10.0))
    state = recorded.clone()
    state[0, 0, :, 0] += torch.tensor([0.0, 1.0, 2.0, 3.0])
    state[0, 1, :, 1] += 2.0
    found = scores.trajectory_errors(state, recorded, POINT_MASS_1D)
    assert float(found["rmse_x"]) == pytest.approx((14 / 8) ** 0.5)  # two driven vehicles, four instants
    assert float(found["rmse_v"]) == pytest.approx((4 * 4 / 8) ** 0.5)
    assert float(found["ade"]) == pytest.approx(6 / 8)
    assert float(found["fde"]) == pytest.approx(3 / 2)


def test_displacement_in_two_dimensions_is_euclidean():
    recorded = torch.zeros(1, 3, 2, 6)
    state = recorded.clone()
    state[0, 0, 1, :2] = torch.tensor([3.0, 4.0])
    torch.testing.assert_close(
        scores.displacement(state, recorded, POINT_MASS_2D), torch.tensor([[[0.0, 5.0], [0.0, 0.0]]])
    )


def test_gaps_subtract_the_length_of_the_vehicle_ahead():
    state = row((0.0, 10.0), (20.0, 10.0), (40.0, 10.0), steps=1)
    found = scores.net_gaps(state, torch.tensor([[9.0, 6.0, 0.0]]))  # 0: not recorded
    torch.testing.assert_close(found, torch.tensor([[[14.0], [20.0 - scores.DEFAULT_LENGTH]]]))


def test_contacts_and_time_headways():
    apart = row((0.0, 10.0), (20.0, 10.0), (40.0, 10.0))
    touching = row((0.0, 10.0), (20.0, 10.0), (24.0, 10.0))
    standing = row((0.0, 0.5), (20.0, 0.5), (40.0, 0.5))
    length = torch.full((3, 3), 5.0)
    found = scores.interaction_samples(torch.cat([apart, touching, standing]), length, POINT_MASS_1D)
    assert found["collision"].tolist() == [False, True, False]
    assert found["least_gap"].tolist() == pytest.approx([15.0, -1.0, 15.0])
    # Who drives slower than 1 m/s has no time headway; where vehicles overlap it is 0.
    assert sorted(set(found["time_headway"].tolist())) == pytest.approx([0.0, 1.5])
    same = scores.compare_interaction(apart, apart, length[:1], POINT_MASS_1D)
    assert same["wasserstein_speed"] == same["wasserstein_time_headway"] == 0.0
    faster = scores.compare_interaction(apart + torch.tensor([0.0, 2.0, 0.0]), apart, length[:1], POINT_MASS_1D)
    assert faster["wasserstein_speed"] == pytest.approx(2.0)
    assert faster["time_headway"] == pytest.approx(15 / 12)


def test_headways_are_shrunk_by_the_ratio_and_the_vehicle_ahead_drives_as_recorded():
    state = row((0.0, 10.0), (20.0, 10.0), (40.0, 10.0))
    scenes = Scenes(state, torch.zeros(1, 2, 3, 1), torch.zeros(1, 6, dtype=torch.int64))
    starts: list[torch.Tensor] = []
    points = scores.success_by_ratio(
        lambda start, ahead: _standing(start, ahead, starts), scenes, (0, 1), POINT_MASS_1D
    )
    assert [float(start[0, 0, 0]) for start in starts] == [20.0 * ratio for ratio in scores.RATIOS]
    assert all(float(start[0, 1, 0]) == 20.0 for start in starts)
    # Vehicle 1 ends at 26 m, so that whoever stands has to begin at 24 m or less: δ up to 1.
    assert [point["success"] for point in points] == [float(ratio <= 1.0) for ratio in scores.RATIOS]
    assert [point["scenes"] for point in points] == [1] * len(scores.RATIOS)


def _standing(start: torch.Tensor, ahead: torch.Tensor, starts: list[torch.Tensor]) -> torch.Tensor:
    starts.append(start)
    return torch.stack([start[:, 0, None].expand(-1, ahead.shape[1], -1), ahead], 1)


def test_only_the_edge_into_the_follower_is_left():
    assert scores.forced_edge(FOLLOWING, EdgeType.FOLLOW).tolist() == [0, 1]
    assert scores.forced_edge(YIELDING, EdgeType.YIELD).tolist() == [0, 2]


def test_rates_are_pooled_as_counts():
    found = scores.pooled_rate(0.5, 100)
    assert (found.mean, found.scenes) == (0.5, 100)
    assert found.half_width == pytest.approx(0.0961, abs=1e-3)  # Wilson


def test_scenes_of_one_cluster_count_as_one():
    # Deviations −1, −1, 1, 1: alone Σ = 4·1, times 4 / 3; in two clusters (−2)² + 2² = 8, times 2.
    values = torch.tensor([1.0, 1.0, 3.0, 3.0])
    assert scores.clustered_half_width(values, [0, 1, 2, 3]) == pytest.approx(1.96 * (16 / 3) ** 0.5 / 4)
    assert scores.clustered_half_width(values, [5, 5, 7, 7]) == pytest.approx(1.96 * 16**0.5 / 4)


def test_a_model_is_scored_whole():
    torch.manual_seed(0)
    config = model_config(NGSIM_CAR_FOLLOWING, DecoderConfig(kind="recurrent", hidden=8), EncoderConfig(hidden=8))
    model = RelationalModel(config)
    state = torch.cat([row((0.0, 9.0), (15.0, 9.0), (30.0, 9.0), steps=12) for _ in range(3)])
    graph = torch.tensor([[0, 0, 1, 0, 0, 1]]).expand(3, -1)
    scenes = Scenes(state, torch.zeros(3, 2, 11, 1), graph)
    with torch.no_grad():
        best, found = scores.best_of_samples(model, scenes, scenes), scores.graph_metrics(model, scenes)
        driven = scores.drive_by_policy(model, scores.forced_edge(FOLLOWING, EdgeType.FOLLOW))(
            state[:, :2, 0], state[:, 1]
        )
    assert best["min_ade"].shape == best["min_fde"].shape == (3,)
    assert found["frequency"].sum(0).fill_diagonal_(1.0).tolist() == [[1.0] * 3] * 3
    assert found["shuffle_agreement"] == 1.0
    assert driven.shape == (3, 2, 12, 3)
    torch.testing.assert_close(driven[:, 1], state[:, 1])
