import zipfile
from pathlib import Path

import pytest
import torch

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
    path = tmp_path / "model.pt"
    checkpoint.save(path, model, reward, {"seed": 7})
    return path, model


def changed(path: Path, **fields: object) -> Path:
    content = torch.load(path, weights_only=True) | fields
    torch.save(content, path)
    return path


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
    checkpoint.save(tmp_path / "s.pt", RelationalModel(ModelConfig(encoder=None)))
    assert checkpoint.load_reward(tmp_path / "s.pt") is None


def test_no_part_files_are_left(saved: tuple[Path, RelationalModel]):
    assert [p.name for p in saved[0].parent.iterdir()] == ["model.pt"]


@pytest.mark.parametrize("keep", [0, 100, 5000])
def test_a_file_cut_short_is_named(saved: tuple[Path, RelationalModel], keep: int):
    path = saved[0]
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"model\.pt: not a readable checkpoint") as error:
        checkpoint.load(path)
    assert "\n" not in str(error.value)


def test_other_files_are_named(tmp_path: Path):
    garbage, tensors = tmp_path / "garbage.pt", tmp_path / "tensors.pt"
    garbage.write_bytes(b"name: not a checkpoint\n" * 50)
    torch.save({"weights": torch.zeros(3)}, tensors)
    with pytest.raises(InputError, match="not a readable checkpoint"):
        checkpoint.load(garbage)
    with pytest.raises(InputError, match="not a gri-checkpoint"):
        checkpoint.load(tensors)
    with pytest.raises(InputError, match=r"no checkpoint '.*missing.pt': .*us101_merge.*; make one with `gri train`"):
        checkpoint.load(tmp_path / "missing.pt")


def test_another_format_version_is_named(saved: tuple[Path, RelationalModel]):
    with pytest.raises(InputError, match="got format version 99, this release reads 1"):
        checkpoint.load(changed(saved[0], version=99))


@pytest.mark.parametrize(
    ("field", "value"),
    [("vocabulary", ["none", "yield"]), ("state", ["x", "a", "v"]), ("dt", 0.1), ("history_steps", 30)],
)
def test_another_layout_is_named(saved: tuple[Path, RelationalModel], field: str, value: object):
    with pytest.raises(InputError, match=f"got {field} "):
        checkpoint.load(changed(saved[0], **{field: value}))


def test_an_unknown_edge_type_is_named(saved: tuple[Path, RelationalModel]):
    config = torch.load(saved[0], weights_only=True)["config"].replace('"follow"]', '"overtake"]', 1)
    with pytest.raises(InputError, match="overtake"):
        checkpoint.load(changed(saved[0], config=config))


def test_tensors_of_another_size_are_named(saved: tuple[Path, RelationalModel]):
    tensors = torch.load(saved[0], weights_only=True)["tensors"]
    tensors["decoder.log_sigma"] = torch.zeros(2)
    with pytest.raises(InputError, match="tensors do not fit"):
        checkpoint.load(changed(saved[0], tensors=tensors))


@pytest.mark.parametrize(
    ("name", "history_steps"),
    [
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
    assert path.stat().st_size < 500_000


@pytest.mark.parametrize(
    ("config", "wanted"),
    [({"type": "nri"}, "nri"), ({"type": "gri_recorded"}, "gri"), ({"type": "gri_told"}, "gri"), (None, "gri")],
)
def test_the_objective_is_what_the_model_was_trained_for(tmp_path: Path, config: dict[str, str] | None, wanted: str):
    made = {"config": {"objective": config}} if config else {}
    checkpoint.save(tmp_path / "model.pt", RelationalModel(ModelConfig(history_steps=8)), provenance=made)
    assert checkpoint.objective(tmp_path / "model.pt") == wanted


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            lambda content: content["tensors"].update({next(iter(content["tensors"])): torch.tensor(float("nan"))}),
            "finite",
        ),
        (lambda content: content["tensors"].update(more=torch.zeros(1).expand(10**9)), "finite numbers"),
        (lambda content: content["tensors"].update(more=torch.zeros(2)), "more has the shape"),
        (lambda content: content.pop("tensors"), "field tensors is missing"),
        (lambda content: content.update(config=7), "field config is missing or no str"),
        (lambda content: content.update(config=content["config"].replace('"dt":0.2', '"dt":-1')), "got dt"),
    ],
)
def test_a_checkpoint_that_was_tampered_with_is_refused_in_one_line(tmp_path, spoil, message):
    content = torch.load(resources.find_checkpoint("us101_car_following"), weights_only=True)
    spoil(content)
    torch.save(content, tmp_path / "bad.pt")
    with pytest.raises(InputError, match=message) as error:
        checkpoint.load(str(tmp_path / "bad.pt"))
    assert "\n" not in str(error.value)


def test_a_flipped_bit_and_a_compressed_archive_are_refused(tmp_path):
    whole = bytearray(resources.find_checkpoint("us101_car_following").read_bytes())
    whole[len(whole) // 2] ^= 1
    (tmp_path / "flipped.pt").write_bytes(whole)
    with zipfile.ZipFile(tmp_path / "bomb.pt", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", bytes(10**7))
    for name, message in (("flipped", "damaged"), ("bomb", "compressed, which a checkpoint never is")):
        with pytest.raises(InputError, match=message):
            checkpoint.load(str(tmp_path / f"{name}.pt"))
