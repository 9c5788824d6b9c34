"""The shipped configuration that learns from synthetic merges and SUMO's together."""

from pathlib import Path

import msgspec
import torch

from gri import checkpoint, resources
from gri.core.graph import InteractionGraph
from gri.core.scenes import Scenes
from gri.data.export import write_synthetic
from gri.data.store import Splits, scenes_of, scenes_path, write_scenes
from gri.networks.model import MERGE
from gri.training.grounded.labelled_encoder import LabelledEncoderSettings
from gri.training.train import read_train_config, train


def merges(count: int, steps: int = 41, history: int = 25) -> Scenes:
    """Three vehicles at constant speed, 0 in the lane beside the gap between 1 and 2."""
    start = torch.zeros(count, 3, 6)
    start[:, 0, 1], start[:, 1, 0], start[:, 2, 0], start[..., 2] = -3.75, -15.0, 15.0, 8.0
    time = 0.2 * torch.arange(1 - history, steps)
    state = start[:, :, None].repeat(1, 1, len(time), 1)
    state[..., 0] += 8.0 * time
    edges = {(e.sender, e.receiver): e.type for e in MERGE}
    graph = InteractionGraph.of_edges(edges, read_train_config(SHIPPED).data.scene_range.vocabulary).map
    driven = state[:, :, history - 1 :]
    return Scenes(driven, torch.zeros(count, 2, steps - 1, 2), graph.expand(count, -1), state[:, :, :history])


SHIPPED = resources.shipped("scenarios", "train", "mixed_merge.yaml")


def test_its_encoder_is_trained_for_the_released_policy(tmp_path: Path):
    shipped = read_train_config(SHIPPED)
    assert isinstance(shipped.objective, LabelledEncoderSettings)
    assert shipped.objective.start == "us101_merge"
    file, made = tmp_path / "sumo.parquet", merges(8)
    data = msgspec.structs.replace(shipped.data, train=4, validation=2, test=2, files=(str(file),) * 2)
    write_scenes(scenes_path(data, tmp_path), made)
    write_synthetic(file, data, Splits(made[:4], made[4:6], made[6:]))
    splits = scenes_of(data, tmp_path)
    assert len(splits.train) == 3 * 4
    grounded = msgspec.structs.replace(shipped.objective.grounded, encoder_lead=120, batch=4)
    objective = msgspec.structs.replace(shipped.objective, grounded=grounded)
    trained = train(msgspec.structs.replace(shipped, data=data, objective=objective), splits, seed=0)
    assert torch.equal(trained.model.infer(splits.test.observed).map, splits.test.graph)
    released = checkpoint.load("us101_merge").decoder.state_dict()
    assert all(torch.equal(tensor, released[name]) for name, tensor in trained.model.decoder.state_dict().items())
