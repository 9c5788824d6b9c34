"""A merge model that was taught the posterior drives as before, and learns from windows that say nothing later."""

from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from gri import checkpoint
from gri.commands.cli import app
from gri.core.edges import LANE_CHANGING, pairs
from gri.data.ranges.recorded import SUMO_MERGE
from gri.data.scene_file.schema import Header, SceneBlock, writing
from gri.errors import InputError
from gri.networks.encoder import Encoder, EncoderConfig
from gri.networks.rollout import rollout
from gri.relations.broken_merges import LAG, MERGER, Merges, kept_in_lane, with_constant_speed, with_stranger
from gri.relations.merge_explanations import CONSTANTS
from gri.relations.merge_motion import motion_of
from gri.relations.merge_posterior import relations
from gri.training.relations.teach_merges import (
    MergeTeachingSettings,
    merge_teaching_identity,
    merges_with_posterior,
    scenes_with_posterior,
    teach_merge_model,
    teach_posterior,
)
from gri.training.training_state import TrainingState

DT, WIDTH, STEPS, SCENES = 0.2, 3.5, 40, 8
TINY = MergeTeachingSettings(
    encoder=EncoderConfig(hidden=16, reads=(0, 1, 2, 3), skip=True, pair_series=True), updates=6, batch=16
)
NONE, FOLLOW, CUT_IN = 0, 1, 3


def write_file(path: Path, steps: int = STEPS, kind: str = "merge") -> Path:
    """Vehicle 0 changes lanes in the middle; vehicle 1 brakes from then on. All relations of the file are nonsense."""
    rng = np.random.default_rng(0)
    v = 9 + rng.random((SCENES, 3, 1)) + np.zeros(steps)
    v[:, 1] -= 0.3 * np.clip(np.arange(steps) - steps // 2, 0, 10)
    x = np.array([0.0, -15.0, 20.0])[:, None] + 300 + np.cumsum(v, -1) * DT
    u = np.clip((np.arange(steps) - steps // 2) / 12, 0, 1)
    y = np.full((SCENES, 3, steps), 5.0)
    y[:, 0] += WIDTH * (u**3 * (10 - 15 * u + 6 * u**2) - 1)
    edges = np.full((SCENES, 6, steps), "yield", object)
    block = SceneBlock(
        kind=kind,
        source=np.full(SCENES, "us101_merge", object),
        recording=np.full(SCENES, "seed 1", object),
        split=np.full(SCENES, "train", object),
        start=np.zeros(SCENES),
        vehicle=np.arange(3 * SCENES).reshape(SCENES, 3),
        features={"x": x, "y": y, "v": v, "heading": 0 * x, "a": 0 * x, "yaw_rate": 0 * x},
        edges=edges[..., -1],
        size={"length": np.full((SCENES, 3), 4.5)},
        step_edges=edges,
    )
    with writing(path, Header(dt=DT)) as write_block:
        write_block(block)
    return path


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_file(tmp_path_factory.mktemp("merges") / "scenes.parquet")


def merges() -> Merges:
    x = 300 + torch.tensor([0.0, -15.0, 20.0])[:, None] + 2.0 * torch.arange(STEPS)
    v = torch.full((3, STEPS), 10.0)
    v[LAG] += 0.2 * torch.sin(torch.arange(STEPS) / 3)
    y = torch.zeros(3, STEPS)
    y[MERGER] = -WIDTH + WIDTH * ((torch.arange(STEPS) - 20) / 12).clamp(0, 1)
    state = torch.stack([x, y, v, torch.zeros_like(v)], -1).double().repeat(3, 1, 1, 1)
    state[1, LAG, :, 2] += 0.01
    return Merges(state, torch.full((3, 3), 5.0).double(), WIDTH, DT)


def test_what_is_broken_is_only_what_the_name_says():
    whole = merges()
    others = [MERGER, 2]
    related = torch.eye(3, dtype=torch.bool)
    for broken in (with_stranger(whole, related), with_constant_speed(whole)):
        assert torch.equal(broken.state[:, others], whole.state[:, others])
        assert torch.equal(broken.state[:, LAG, 0, :2], whole.state[:, LAG, 0, :2])
        assert not torch.equal(broken.state[:, LAG], whole.state[:, LAG])
    assert torch.equal(with_stranger(whole, related).state[0, LAG, :, 2], whole.state[2, LAG, :, 2])  # the nearest one
    assert with_constant_speed(whole).state[:, LAG, :, 2].std(-1).max() == 0
    kept = kept_in_lane(whole)
    assert kept.state[:, MERGER, :, 1].std(-1).max() == 0
    assert torch.equal(kept.state[..., 2], whole.state[..., 2])


def test_the_encoder_learns_the_posterior_and_no_label(file: Path):
    known = scenes_with_posterior(file, SUMO_MERGE, CONSTANTS, TINY, DT)
    wanted = relations(motion_of(known.state[:SCENES], WIDTH, DT, torch.full((SCENES, 3), 5.0)), CONSTANTS).float()
    assert (known.target[:SCENES] - wanted).abs().max() < 0.01  # unbroken: the posterior as it is, but for rounding
    torch.testing.assert_close(known.target.sum(-1), torch.ones_like(known.target[..., 0]))
    lag, cut = known.target[SCENES:, :, pairs(3).index((0, 1))], known.target[SCENES:, :, pairs(3).index((1, 0))]
    assert lag[..., FOLLOW].max() == 0  # in all broken scenes
    assert cut[..., CUT_IN].max() == 0
    assert known.target[:SCENES, :, pairs(3).index((0, 1)), FOLLOW].max() > 0.02  # unbroken, it may follow
    share = known.weight[:SCENES].sum() / known.weight.sum()
    assert float(share) == pytest.approx(TINY.as_they_are / 1.0, abs=0.15)  # scenes that overlap are left out


def test_it_learns(file: Path):
    settings = MergeTeachingSettings(encoder=TINY.encoder, updates=60, batch=32)
    known = scenes_with_posterior(file, SUMO_MERGE, CONSTANTS, settings, DT)
    losses: list[float] = []
    torch.manual_seed(0)
    encoder = Encoder(settings.encoder, SUMO_MERGE.scale, len(LANE_CHANGING), DT)
    teach_posterior(encoder, known, settings, 0, lambda _, done, total, loss: losses.append(loss))
    assert np.mean(losses[-10:]) < 0.6 * np.mean(losses[:5])


def test_reward_and_policy_stay_and_the_file_holds_all(file: Path, tmp_path: Path):
    model = checkpoint.load("us101_merge")
    known = merges_with_posterior(model, SUMO_MERGE, [file], CONSTANTS, TINY)
    taught, made = teach_merge_model(model, known, TINY, 3)
    assert made["seed"] == 3
    checkpoint.save(tmp_path / "taught.safetensors", taught, None, {"teaching": made})
    loaded = checkpoint.load(tmp_path / "taught.safetensors")
    state = torch.randn(4, 3, 25, 6) + torch.tensor([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])
    assert torch.equal(loaded.infer(state).logits, taught.infer(state).logits)
    assert not torch.allclose(loaded.infer(state).logits, model.infer(state).logits)
    edges, start, leader = model.infer(state).one_hot, state[:, :, -1], state[:, -1, :10]
    first, second = (rollout(m, start, edges, leader).state for m in (model, loaded))
    assert torch.equal(first, second)


def test_a_teaching_that_was_stopped_goes_on_to_the_same_weights(file: Path, tmp_path: Path):
    model = checkpoint.load("us101_merge")
    known = merges_with_posterior(model, SUMO_MERGE, [file], CONSTANTS, TINY)
    whole, _ = teach_merge_model(model, known, TINY, 1)
    path, identity = tmp_path / "taught.state", merge_teaching_identity(model, known, TINY, 1)

    def stop(stage: str, done: int, total: int, loss: float) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), (state := TrainingState(path, identity)).stoppable():
        teach_merge_model(model, known, TINY, 1, stop, state)
    resumed, _ = teach_merge_model(model, known, TINY, 1, state=TrainingState(path, identity))
    for name, tensor in whole.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name


@pytest.mark.parametrize(("steps", "kind", "match"), [(12, "merge", "12 steps"), (40, "other", "no scenes of kind")])
def test_files_without_long_merges_are_refused(tmp_path: Path, steps: int, kind: str, match: str):
    path = write_file(tmp_path / "scenes.parquet", steps, kind)
    with pytest.raises(InputError, match=match):
        scenes_with_posterior(path, SUMO_MERGE, CONSTANTS, TINY, DT)


def test_models_of_car_following_are_refused(file: Path):
    with pytest.raises(InputError, match="teach a merge model"):
        merges_with_posterior(checkpoint.load("us101_car_following"), SUMO_MERGE, [file], CONSTANTS, TINY)


def test_the_command_writes_a_checkpoint_and_refuses_both_kinds(file: Path, tmp_path: Path):
    out = tmp_path / "taught.safetensors"
    arguments = ["teach", "us101_merge", "--merges", str(file), "--out", str(out), "--updates", "2"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert checkpoint.provenance(out)["teaching"]["settings"]["updates"] == 2
    assert checkpoint.load_reward(out) is not None
    both = CliRunner().invoke(app, [*arguments, "--recordings", str(file)])
    assert isinstance(both.exception, InputError)
    assert "--recordings" in str(both.exception)
