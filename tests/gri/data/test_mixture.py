"""Synthetic scenes and those of files in one set."""

from pathlib import Path

import pytest
import torch

from gri.core.scenes import Scenes
from gri.data.export import write_synthetic
from gri.data.mixture import mix_scenes
from gri.data.store import DataConfig, Splits, scenes_of, scenes_path, write_scenes
from gri.errors import InputError


def scenes(count: int, steps: int, history: int | None, value: float) -> Scenes:
    state = torch.full((count, 3, steps, 6), value)
    state[..., 0] += torch.arange(steps)
    seen = None if history is None else torch.full((count, 3, history, 6), -value)
    return Scenes(state, torch.full((count, 2, steps - 1, 2), value), torch.full((count, 6), int(value)), seen)


def test_they_become_as_long_as_the_shorter_and_are_seen_for_as_long():
    both = mix_scenes(scenes(2, 41, 25, 1.0), scenes(3, 40, None, 2.0))
    assert both.state.shape == (5, 3, 40, 6)
    assert both.action.shape == (5, 2, 39, 2)
    assert both.graph[:, 0].tolist() == [1, 1, 2, 2, 2]
    assert both.history is not None
    assert torch.equal(both.history[:2], torch.full((2, 3, 25, 6), -1.0))
    assert torch.equal(both.history[2:], both.state[2:, :, :25])


def test_without_histories_the_scene_is_what_is_seen():
    both = mix_scenes(scenes(2, 45, None, 1.0), scenes(3, 30, None, 2.0))
    assert both.history is None
    assert both.observed.shape == (5, 3, 30, 6)


def test_files_named_beside_a_synthetic_range_are_mixed_in(tmp_path: Path):
    alone = DataConfig(range="highway_merge", graphs="one", train=2, validation=1, test=1)
    made, file = scenes(4, 41, 25, 1.0), tmp_path / "scenes.parquet"
    write_scenes(scenes_path(alone, tmp_path), made)
    write_synthetic(file, alone, Splits(made[:2], made[2:3], made[3:]))
    config = DataConfig(range="highway_merge", graphs="one", train=2, validation=1, test=1, files=(str(file),))
    assert scenes_path(config, tmp_path) == scenes_path(alone, tmp_path)
    both = scenes_of(config, tmp_path)
    assert [len(part.state) for part in vars(both).values()] == [4, 2, 2]
    assert torch.equal(both.train[:2].observed, made[:2].observed)
    assert both.train.state.shape[2] == 40


def test_ranges_like_no_file_take_none(tmp_path: Path):
    config = DataConfig(range="paper", graphs="one", files=("x.parquet",))
    with pytest.raises(InputError, match=r"field data\.files: got files beside range paper"):
        scenes_of(config, tmp_path)


def test_a_missing_file_is_named_before_scenes_are_made(tmp_path: Path):
    config = DataConfig(range="highway_merge", graphs="one", files=(str(tmp_path / "x.parquet"),))
    with pytest.raises(InputError, match=r"x\.parquet: no such scene file; make one with `cosim scenes"):
        scenes_of(config, tmp_path)
