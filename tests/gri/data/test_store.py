import os
from pathlib import Path

import msgspec
import pytest
import torch

from gri.core.scenes import Scenes
from gri.data.store import DataConfig, read_scenes, scenes_of, scenes_path, write_scenes
from gri.errors import InputError
from gri.storage.claims import claimed_place
from gri.storage.verification import DamagedError, digest_file

SMALL = DataConfig(range="paper", graphs="mixed", train=8, validation=3, test=2, expert_updates=2)


def test_scenes_are_made_once(tmp_path: Path):
    updates: list[int] = []
    first = scenes_of(SMALL, tmp_path, lambda what, done, total, value: updates.append(done))
    again = scenes_of(SMALL, tmp_path, lambda what, done, total, value: updates.append(done))
    assert updates == [1, 2]
    assert (len(first.train), len(first.validation), len(first.test)) == (8, 3, 2)
    assert torch.equal(first.test.state, again.test.state)
    assert torch.equal(first.test.graph, again.test.graph)
    name = scenes_path(SMALL, tmp_path).name
    assert sorted(path.name for path in tmp_path.iterdir()) == [name, f"{name}.sha256"]


@pytest.mark.parametrize("change", [{"seed": 1}, {"action_noise": 0.1}, {"graphs": "one"}, {"range": "us101"}])
def test_another_configuration_is_another_file(tmp_path: Path, change: dict):
    assert scenes_path(msgspec.structs.replace(SMALL, **change), tmp_path) != scenes_path(SMALL, tmp_path)


@pytest.mark.parametrize("keep", [0, 40, 2000])
def test_a_damaged_file_is_named(tmp_path: Path, keep: int):
    scenes_of(SMALL, tmp_path)
    path = scenes_path(SMALL, tmp_path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(DamagedError, match="is damaged"):
        scenes_of(SMALL, tmp_path)
    digest_file(path).unlink()  # as older versions left it
    with pytest.raises(InputError, match="not a file of scenes, or damaged"):
        read_scenes(path)


def test_no_flipped_bit_of_cached_scenes_is_used(tmp_path: Path):
    """Also where the archive would open: in the name `history` it would lose an array, in a date nothing."""
    path = tmp_path / "scenes.npz"
    state, action = torch.randn(2, 3, 4, 3), torch.randn(2, 3, 3, 1)
    write_scenes(path, Scenes(state, action, torch.zeros(2, 6, dtype=torch.int64), torch.randn(2, 3, 5, 3)))
    whole = path.read_bytes()
    for bit in range(0, 8 * len(whole), 41):
        changed = bytearray(whole)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        with pytest.raises(DamagedError, match="delete it, then it is made again"):
            read_scenes(path)
    path.write_bytes(whole)
    assert torch.equal(read_scenes(path).state, state)


def test_what_a_killed_command_left_is_removed(tmp_path: Path):
    """But nothing that a command which still runs is writing."""
    path, none = tmp_path / "scenes.npz", torch.zeros(2, 6, dtype=torch.int64)
    scenes = Scenes(torch.zeros(2, 3, 4, 3), torch.zeros(2, 3, 3, 1), none)
    left = tmp_path / ".scenes.npz.4711-abcdef.part"
    with claimed_place(path):
        left.touch()
        write_scenes(path, scenes)
    assert left.exists()
    write_scenes(path, scenes)
    assert sorted(os.listdir(tmp_path)) == ["scenes.npz", "scenes.npz.sha256"]


def test_histories_are_kept(tmp_path: Path):
    splits = scenes_of(DataConfig(range="highway_merge", graphs="one", train=2, validation=1, test=1), tmp_path)
    again = read_scenes(next(tmp_path.glob("*.npz")))
    assert splits.train.history is not None
    assert again.history is not None
    assert torch.equal(again[:2].observed, splits.train.history)
