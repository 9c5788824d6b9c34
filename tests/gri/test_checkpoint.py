import json
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file
from safetensors.torch import save as packed

from gri import checkpoint, resources
from gri.core.trajectory import Trajectory
from gri.errors import InputError
from gri.networks.model import ModelConfig, RelationalModel
from gri.rewards.structured import RewardConfig, StructuredReward


@pytest.fixture
def saved(tmp_path: Path) -> tuple[Path, RelationalModel]:
    torch.manual_seed(0)
    model = RelationalModel(ModelConfig(history_steps=8))
    reward = StructuredReward(RewardConfig(temperature=0.25))
    with torch.no_grad():
        reward.psi["follow"].copy_(torch.tensor([0.5, -1.0]))
    path = tmp_path / "model.safetensors"
    checkpoint.save(path, model, reward, {"seed": 7})
    return path, model


def header_of(path: Path) -> dict[str, Any]:
    with safe_open(path, "pt") as file:
        return json.loads(file.metadata()[checkpoint.FORMAT])


def rewritten(path: Path, header: object, tensors: dict[str, torch.Tensor]) -> Path:
    path.write_bytes(packed(tensors, {checkpoint.FORMAT: json.dumps(header)}))
    return path


def changed(path: Path, **fields: object) -> Path:
    return rewritten(path, header_of(path) | fields, load_file(path))


def test_the_file_alone_rebuilds_the_model(saved: tuple[Path, RelationalModel]):
    path, model = saved
    loaded = checkpoint.load(path)
    assert loaded.config == model.config
    seen = Trajectory.complete(torch.randn(2, 3, 8, 3), 0.2)
    before, after = model.begin(seen), loaded.begin(seen)
    assert before.graph is not None
    assert after.graph is not None
    assert torch.equal(before.graph.logits, after.graph.logits)
    assert torch.equal(model.act(before, seen.final)[0], loaded.act(after, seen.final)[0])


def test_reward_and_provenance_come_with_it(saved: tuple[Path, RelationalModel]):
    reward = checkpoint.load_reward(saved[0])
    assert reward is not None
    torch.testing.assert_close(reward.psi["follow"].data, torch.tensor([0.5, -1.0]))
    assert reward.config.temperature == 0.25
    assert checkpoint.provenance(saved[0]) == {"seed": 7}


def test_a_supervised_model_has_no_reward(tmp_path: Path):
    checkpoint.save(tmp_path / "s.safetensors", RelationalModel(ModelConfig(encoder=None)))
    assert checkpoint.load_reward(tmp_path / "s.safetensors") is None


def test_no_part_files_are_left(saved: tuple[Path, RelationalModel]):
    assert [p.name for p in saved[0].parent.iterdir()] == ["model.safetensors"]


@pytest.mark.parametrize("keep", [0, 100, 5000])
def test_a_file_cut_short_is_named(saved: tuple[Path, RelationalModel], keep: int):
    path = saved[0]
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"model\.safetensors: not a readable checkpoint") as error:
        checkpoint.load(path)
    assert "\n" not in str(error.value)


def test_other_files_are_named(tmp_path: Path):
    names = ("garbage", "tensors", "torch", "missing")
    garbage, tensors, old, missing = (tmp_path / f"{name}.safetensors" for name in names)
    garbage.write_bytes(b"name: not a checkpoint\n" * 50)
    tensors.write_bytes(packed({"weights": torch.zeros(3)}))
    torch.save({"format": checkpoint.FORMAT, "version": 1}, old)
    for path, message in (
        (garbage, "not a readable checkpoint"),
        (tensors, "not a gri-checkpoint"),
        (old, "a file of torch, such as version 0.1 wrote"),
        (missing, r"no checkpoint '.*missing.safetensors': .*us101_merge.*; make one with `gri train`"),
    ):
        with pytest.raises(InputError, match=message):
            checkpoint.load(path)


def test_equal_contents_give_equal_bytes(saved: tuple[Path, RelationalModel], tmp_path: Path):
    again = tmp_path / "again.safetensors"
    checkpoint.save(again, checkpoint.load(saved[0]), checkpoint.load_reward(saved[0]), checkpoint.provenance(saved[0]))
    assert again.read_bytes() == saved[0].read_bytes()


def test_another_format_version_is_named(saved: tuple[Path, RelationalModel]):
    with pytest.raises(InputError, match="got format version 99, this release reads 2"):
        checkpoint.load(changed(saved[0], version=99))


@pytest.mark.parametrize(
    ("field", "value"),
    [("vocabulary", ["none", "yield"]), ("state", ["x", "a", "v"]), ("dt", 0.1), ("history_steps", 30)],
)
def test_another_layout_is_named(saved: tuple[Path, RelationalModel], field: str, value: object):
    with pytest.raises(InputError, match=f"got {field} "):
        checkpoint.load(changed(saved[0], **{field: value}))


def test_an_unknown_edge_type_is_named(saved: tuple[Path, RelationalModel]):
    config = header_of(saved[0])["config"]
    with pytest.raises(InputError, match="overtake"):
        checkpoint.load(changed(saved[0], config=config | {"vocabulary": ["none", "overtake"]}))


def test_tensors_of_another_size_are_named(saved: tuple[Path, RelationalModel]):
    tensors = load_file(saved[0]) | {"model.decoder.log_sigma": torch.zeros(2)}
    header = header_of(saved[0]) | {"sha256": checkpoint.tensor_digest(tensors)}
    with pytest.raises(InputError, match="tensors do not fit"):
        checkpoint.load(rewritten(saved[0], header, tensors))


@pytest.mark.parametrize(
    ("name", "history_steps"),
    [
        ("merge_relations", 25),
        ("mixed_merge", 25),
        ("ngsim_car_following", 30),
        ("ngsim_lane_changing", 40),
        ("ngsim_relations", 30),
        ("sumo_car_following", 25),
        ("us101_car_following", 25),
        ("us101_car_following_supervised", 25),
        ("us101_merge", 25),
        ("us101_merge_nri", 25),
        ("us101_merge_supervised", 25),
    ],
)
def test_released_checkpoints_load_and_are_small(name: str, history_steps: int):
    path = resources.find_checkpoint(name)
    model = checkpoint.load(path)
    assert model.history_steps == history_steps
    assert path.stat().st_size < 700_000


@pytest.mark.parametrize(
    ("config", "wanted"),
    [({"type": "nri"}, "nri"), ({"type": "gri_recorded"}, "gri"), ({"type": "gri_told"}, "gri"), (None, "gri")],
)
def test_the_objective_is_what_the_model_was_trained_for(tmp_path: Path, config: dict[str, str] | None, wanted: str):
    made = {"config": {"objective": config}} if config else {}
    checkpoint.save(tmp_path / "model.safetensors", RelationalModel(ModelConfig(history_steps=8)), provenance=made)
    assert checkpoint.objective(tmp_path / "model.safetensors") == wanted


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda _, tensors: tensors.update({next(iter(tensors)): torch.tensor(float("nan"))}), "finite"),
        (
            lambda _, tensors: tensors.update({"model.more": torch.zeros(2)}),
            r"more is float32 of the shape \(2,\), wanted missing",
        ),
        (lambda _, tensors: tensors.update({n: t.to(torch.complex64) for n, t in tensors.items()}), "is complex64"),
        (lambda _, tensors: tensors.update(more=torch.zeros(2)), "more is unknown"),
        (lambda _, tensors: tensors.clear(), "tensors do not fit"),
        (lambda header, _: header.pop("config"), "missing required field `config`"),
        (lambda header, _: header.update(config=7), "Expected `object`"),
        (lambda header, _: header.update(more=7), "unknown field `more`"),
        (lambda header, _: header["config"].update(dt=-1), "got dt"),
        (lambda header, _: header.update(provenance=float("nan")), "not a readable checkpoint"),
    ],
)
def test_a_checkpoint_that_was_tampered_with_is_refused_in_one_line(tmp_path, spoil, message):
    released = resources.find_checkpoint("us101_car_following")
    header, tensors = header_of(released), load_file(released)
    spoil(header, tensors)
    header |= {"sha256": checkpoint.tensor_digest(tensors)}
    with pytest.raises(InputError, match=message) as error:
        checkpoint.load(rewritten(tmp_path / "bad.safetensors", header, tensors))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("part", [0.5, 0.9])
def test_a_flipped_bit_is_refused(tmp_path: Path, part: float):
    whole = bytearray(resources.find_checkpoint("us101_car_following").read_bytes())
    whole[int(part * len(whole))] ^= 1
    path = tmp_path / "flipped.safetensors"
    path.write_bytes(whole)
    with pytest.raises(InputError, match="damaged"):
        checkpoint.load(path)
