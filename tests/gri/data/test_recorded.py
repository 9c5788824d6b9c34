"""Scenes of SUMO, and of several files, in the layout of the models."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gri.core.edges import EdgeType
from gri.data.ngsim.sampled_lateral_motion import SOURCE_SUFFIX
from gri.data.ranges.recorded import NGSIM_CAR_FOLLOWING, SUMO_CAR_FOLLOWING, SUMO_MERGE
from gri.data.recorded import recorded_scenes, scenes_to_test
from gri.data.scene_file.schema import Header, SceneBlock, names_of, writing
from gri.data.store import DataConfig, scenes_of
from gri.errors import InputError


def block(kind: str = "car_following", steps: int = 30, split: str = "train") -> SceneBlock:
    """One scene: 0, 10 and 20 m ahead at the start, at 10 m/s, the vehicles 4, 5 and 8 m long."""
    x = np.array([0.0, 10.0, 20.0])[None, :, None] + 2.0 * np.arange(steps)
    zero = np.zeros_like(x)
    features = {"x": x, "y": zero + 3.0, "v": zero + 10.0, "a": zero, "heading": zero, "yaw_rate": zero}
    edges = names_of({(1, 0): EdgeType.FOLLOW})[None]
    return SceneBlock(
        kind=kind,
        source=np.array(["us101_merge"], object),
        recording=np.array(["seed 1"], object),
        split=np.array([split], object),
        start=np.zeros(1),
        vehicle=np.array([[1, 2, 3]]),
        features=features,
        edges=edges,
        size={"length": np.array([[4.0, 5.0, 8.0]])},
        hypothesis=names_of({(1, 0): EdgeType.FOLLOW, (2, 1): EdgeType.FOLLOW})[None],
        unambiguous=np.array([True]),
    )


def written(path: Path, *blocks: SceneBlock) -> Path:
    with writing(path, Header(dt=0.2)) as write:
        for each in blocks:
            write(each)
    return path


def test_vehicles_ahead_count_as_five_metres_long(tmp_path: Path):
    scenes, found = recorded_scenes(written(tmp_path / "a.parquet", block()), SUMO_CAR_FOLLOWING, "train")
    assert scenes.state[0, :, 0, 0].tolist() == [0.0, 10.0, 17.0]  # 8 m long: 3 m more of a gap than it seems
    torch.testing.assert_close(scenes.state[0, :, -1, 0] - scenes.state[0, :, 0, 0], torch.full((3,), 58.0))
    assert found.hypothesis is not None
    assert found.hypothesis.tolist() == [[0, 0, 1, 0, 0, 1]]
    assert found.graph.tolist() == [[0, 0, 1, 0, 0, 0]]
    assert found.unambiguous is not None
    assert found.unambiguous.tolist() == [True]
    as_recorded, _ = recorded_scenes(tmp_path / "a.parquet", NGSIM_CAR_FOLLOWING, None)
    assert as_recorded.state[0, :, 0, 0].tolist() == [0.0, 10.0, 20.0]


def test_scenes_with_drawn_motion_are_never_tested_on(tmp_path: Path):
    drawn = replace(block(), source=np.array([f"us-101{SOURCE_SUFFIX}"], object), vehicle=np.array([[7, 8, 9]]))
    both = written(tmp_path / "a.parquet", drawn, block())
    tested, found, left_out = scenes_to_test(both, SUMO_CAR_FOLLOWING, None)
    assert (len(tested), len(found), left_out) == (1, 1, 1)
    assert found.vehicle.tolist() == [[1, 2, 3]]
    assert (len(found.trajectory.state), len(found.length)) == (1, 1)
    with pytest.raises(InputError, match=r"b\.parquet: got 1 scenes .* all with drawn lateral motion"):
        scenes_to_test(written(tmp_path / "b.parquet", drawn), SUMO_CAR_FOLLOWING, None)


def test_the_order_at_the_start_says_who_is_ahead(tmp_path: Path):
    merge = block("merge", steps=40)
    swapped = replace(merge, features={**merge.features, "x": merge.features["x"][:, [1, 0, 2]]})
    scenes, _ = recorded_scenes(written(tmp_path / "a.parquet", swapped), SUMO_MERGE, None)
    assert scenes.state[0, :, 0, 0].tolist() == [0.0, -11.0, 7.0]  # 1 behind 0 (4 m) behind 2 (8 m)
    assert scenes.state[0, :, 0, 1].tolist() == [0.0, 0.0, 0.0]


def test_files_are_mixed_and_files_without_a_hypothesis_leave_none(tmp_path: Path):
    plain = replace(block(), hypothesis=None, unambiguous=None)
    paths = [written(tmp_path / "a.parquet", block()), written(tmp_path / "b.parquet", plain)]
    scenes, found = recorded_scenes(paths, SUMO_CAR_FOLLOWING, None)
    assert len(scenes) == 2
    assert found.hypothesis is None
    assert found.unambiguous is None


def test_a_configuration_names_its_files(tmp_path: Path):
    splits = [block(split=split) for split in ("train", "validation", "test")]
    path = written(tmp_path / "mine.parquet", *splits)
    config = DataConfig(range="sumo_car_following", graphs="one", files=(str(path), str(path)))
    assert len(scenes_of(config, tmp_path).test) == 2
    with pytest.raises(InputError, match=r"sumo\.parquet: no such scene file; make one with `cosim scenes"):
        scenes_of(DataConfig(range="sumo_merge", graphs="one"), tmp_path)
