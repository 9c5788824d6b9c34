"""Synthetic scenes beside those of simulated and recorded traffic."""

from pathlib import Path

import pytest
import torch

from gri.core.dynamics import DUBINS, POINT_MASS_1D, Dynamics
from gri.core.scenes import Scenes
from gri.data.export import write_synthetic
from gri.data.ranges.recorded import NGSIM_CAR_FOLLOWING, SUMO_CAR_FOLLOWING, SUMO_MERGE
from gri.data.recorded import recorded_scenes
from gri.data.store import DataConfig, Splits
from gri.data.synthetic.expert import sample_graphs
from gri.errors import InputError


def driven(dynamics: Dynamics, start: list[float], steps: int, count: int, config: DataConfig) -> Scenes:
    """Three vehicles 15 m apart with random actions and graphs."""
    generator = torch.Generator().manual_seed(0)
    state = [torch.tensor(start).repeat(count, 3, 1)]
    state[0][..., 0] = torch.tensor([0.0, 15.0, 30.0])
    action = 0.3 * torch.randn(count, 3, steps - 1, len(dynamics.action), generator=generator)
    for t in range(steps - 1):
        state.append(dynamics.step(state[-1], action[:, :, t], 0.2))
    graph = sample_graphs(config.shares, count, generator, config.scene_range.vocabulary)
    return Scenes(torch.stack(state, 2), action[:, :2], graph)


@pytest.mark.parametrize(
    ("config", "dynamics", "start", "steps", "like"),
    [
        (DataConfig(range="us101", graphs="mixed"), POINT_MASS_1D, [0.0, 9.0, 0.0], 45, SUMO_CAR_FOLLOWING),
        (DataConfig(range="highway_merge", graphs="mixed"), DUBINS, [0.0, 0.0, 9.0, 0.0, 0.0, 0.0], 41, SUMO_MERGE),
    ],
)
def test_they_are_read_as_scenes_of_sumo(config, dynamics, start, steps, like, tmp_path: Path):
    made = driven(dynamics, start, steps, 9, config)
    path = tmp_path / "synthetic.parquet"
    write_synthetic(path, config, Splits(made[:5], made[5:7], made[7:]))
    for split, part in (("train", made[:5]), ("validation", made[5:7]), ("test", made[7:])):
        read, found = recorded_scenes(path, like, split)
        assert read.state.shape[2] == like.steps
        assert torch.equal(read.graph, part.graph)
        torch.testing.assert_close(
            read.action, part.action[:, :, : like.steps - 1], rtol=0, atol=0.02
        )  # from float32 states
        assert set(found.split) == {split}
    _, everything = recorded_scenes(path, like, None)
    assert len(set(everything.vehicle.ravel().tolist())) == 27


def test_they_mix_with_recorded_ones(tmp_path: Path):
    config = DataConfig(range="us101", graphs="one")
    made = driven(POINT_MASS_1D, [0.0, 9.0, 0.0], 45, 6, config)
    paths = [tmp_path / name for name in ("a.parquet", "b.parquet")]
    for path in paths:
        write_synthetic(path, config, Splits(made[:4], made[4:5], made[5:]))
    assert len(recorded_scenes(paths, NGSIM_CAR_FOLLOWING, "train")[0]) == 8


def test_the_papers_scenes_are_like_no_recorded_ones(tmp_path: Path):
    config = DataConfig(range="paper", graphs="one")
    made = driven(POINT_MASS_1D, [0.0, 5.0, 0.0], 20, 3, config)
    with pytest.raises(InputError, match="got scenes of range paper, wanted us101 or highway_merge"):
        write_synthetic(tmp_path / "p.parquet", config, Splits(made[:1], made[1:2], made[2:]))
