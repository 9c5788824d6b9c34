"""Relations of a user's scenes: the same as from the model itself, from nothing later than told, and honest scores."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from typer.testing import CliRunner

from gri import checkpoint
from gri.commands.cli import app
from gri.core.edges import LANE_CHANGING, pairs
from gri.data.ranges.recorded import SUMO_CAR_FOLLOWING
from gri.data.scene_file.schema import Header, SceneBlock, writing
from gri.errors import InputError
from gri.inference.relation_tables import frame_of, scores, shares, write
from gri.inference.step_relations import StepRelations, by_merge_posterior, by_model
from gri.relations.merge_explanations import CONSTANTS
from gri.relations.merge_posterior import relations_per_step

WIDTH, DT, STEPS, SCENES = 3.5, 0.2, 30, 4
LENGTH = (4.0, 5.0, 8.0)


def block(kind: str, labels: bool = True, steps: int = STEPS) -> SceneBlock:
    """Vehicle 1 brakes when vehicle 0 begins to come into its lane; the labels say that it yields, then follows."""
    rng = np.random.default_rng(3)
    v = 10 + rng.random((SCENES, 3, 1)) + np.zeros(steps)
    v[:, 1, steps // 2 :] -= 0.3 * np.arange(steps - steps // 2)
    x = np.array([0.0, -15.0, 20.0])[:, None] + 300 + np.cumsum(v, -1) * DT
    u = np.clip((np.arange(steps) - steps // 2) / 8, 0, 1)
    y = np.full((SCENES, 3, steps), 5.0)
    y[:, 0] += WIDTH * (u**3 * (10 - 15 * u + 6 * u**2) - 1)
    edges = np.full((SCENES, 6, steps), "none", object)
    edges[:, 0, : steps // 2], edges[:, 0, steps // 2 :] = "yield", "follow"
    return SceneBlock(
        kind=kind,
        source=np.full(SCENES, "us101_merge", object),
        recording=np.full(SCENES, "seed 1", object),
        split=np.array(["train"] + ["test"] * (SCENES - 1), object),
        start=np.zeros(SCENES),
        vehicle=np.arange(3 * SCENES).reshape(SCENES, 3),
        features={"x": x, "y": y, "v": v, "heading": 0 * x, "a": 0 * x, "yaw_rate": 0 * x},
        edges=edges[..., -1],
        size={"length": np.tile(LENGTH, (SCENES, 1))},
        step_edges=edges if labels else None,
    )


def file_of(path: Path, *blocks: SceneBlock) -> Path:
    with writing(path, Header(dt=DT)) as write_block:
        for each in blocks:
            write_block(each)
    return path


@pytest.fixture(scope="module")
def merges(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return file_of(tmp_path_factory.mktemp("scenes") / "merges.parquet", block("merge"))


@pytest.fixture(scope="module")
def whole(merges: Path) -> StepRelations:
    return by_merge_posterior(merges, CONSTANTS)[0]


def states() -> torch.Tensor:
    features = block("merge").features
    return torch.from_numpy(np.stack([features[name] for name in ("x", "y", "v")], -1).astype(np.float32)).double()


def test_the_posterior_of_a_file_is_that_of_its_states(whole: StepRelations):
    wanted = relations_per_step(states(), WIDTH, DT, torch.tensor(LENGTH).repeat(SCENES, 1))
    np.testing.assert_allclose(whole.probs, wanted.numpy(), atol=1e-4)  # the lane width is measured to float32
    assert whole.step.tolist() == list(range(STEPS))
    assert whole.probs.std(1).max() > 0.1  # it is not the same in all steps


def test_online_nothing_later_is_seen(merges: Path, tmp_path: Path):
    """Another ending of the scenes changes no answer before it; with hindsight it does."""
    seen = STEPS - 8
    other = block("merge")
    changed = {name: values.copy() for name, values in other.features.items()}
    changed["v"][:, 1, seen:] += 2.0
    changed["x"][:, 1, seen:] += 3.0
    path = file_of(tmp_path / "other.parquet", SceneBlock(**{**vars(other), "features": changed}))
    kept = [by_merge_posterior(file, CONSTANTS, 0.4, online=True)[0] for file in (merges, path)]
    before = kept[0].step < seen
    assert before.sum() > 5
    np.testing.assert_array_equal(kept[0].probs[:, before], kept[1].probs[:, before])
    with_hindsight = [by_merge_posterior(file, CONSTANTS, 0.4)[0] for file in (merges, path)]
    assert np.abs(with_hindsight[0].probs[:, :8] - with_hindsight[1].probs[:, :8]).max() > 1e-6


def test_a_model_answers_as_it_does_by_itself(tmp_path: Path):
    path = file_of(tmp_path / "a.parquet", block("car_following"))
    model = checkpoint.load("us101_car_following")
    found = by_model(model, SUMO_CAR_FOLLOWING, path, every_s=0.4)[0]
    first = model.history_steps - 1
    assert found.step.tolist() == list(range(first, STEPS, 2))
    until = int(found.step[-1]) + 1
    window = torch.zeros(SCENES, 3, model.history_steps, 3)
    window[..., :2] = states()[:, :, until - model.history_steps : until, ::2]
    window[:, [0, 2], :, 0] += 5.0 - LENGTH[0]  # every vehicle counts as 5 m long, and gaps stay the same
    window[:, 2, :, 0] += 5.0 - LENGTH[2]
    window[..., 0] -= window[:, -1:, -1:, 0]
    np.testing.assert_allclose(found.probs[:, -1], model.infer(window).probs.numpy(), atol=1e-5)
    assert found.unknown is not None
    assert found.unknown.shape == (SCENES, len(found.step))


def test_the_file_has_a_row_per_scene_step_and_pair(whole: StepRelations, tmp_path: Path):
    write(tmp_path / "a.parquet", [whole])
    write(tmp_path / "b.parquet", [whole])
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    frame = pd.read_parquet(tmp_path / "a.parquet")
    assert len(frame) == SCENES * STEPS * 6
    row = frame[(frame["scene"] == 2) & (frame["step"] == 7) & (frame["sender"] == 2) & (frame["receiver"] == 0)]
    p = whole.probs[2, 7, pairs(3).index((2, 0))]
    np.testing.assert_allclose(row[[f"p_{kind}" for kind in LANE_CHANGING]].to_numpy()[0], p, atol=1e-6)
    assert row["relation"].item() == str(LANE_CHANGING[p.argmax()])


def answers(types: np.ndarray, step: np.ndarray) -> StepRelations:
    return StepRelations("merge", np.arange(len(types)), step, DT, np.eye(4)[types], LANE_CHANGING)


def test_scores_are_those_counted_by_hand(merges: Path):
    """Truth: pair 0 → 1 yields in half of the steps, then follows; five pairs have nothing."""
    right = np.zeros((SCENES, STEPS, 6), int)
    right[:, : STEPS // 2, 0], right[:, STEPS // 2 :, 0] = 2, 1
    found = scores(merges, answers(right, np.arange(STEPS)))
    assert found is not None
    assert [r["step_macro_f1"] for r in found.records] == pytest.approx([1, (1 + 2 / 3) / 3, 1])
    assert [r["step_accuracy"] for r in found.records] == pytest.approx([1, 11 / 12, 1])
    wrong = scores(merges, answers(np.zeros_like(right), np.arange(STEPS)))
    assert wrong is not None
    assert wrong.records[0]["step_accuracy"] == pytest.approx(5 / 6)
    some = scores(merges, answers(right[:, ::5], np.arange(0, STEPS, 5)))  # only the inferred steps count
    assert some is not None
    assert some.records[0]["step_accuracy"] == 1
    assert shares(answers(right, np.arange(STEPS))).records[0] == {
        "pair": "0→1",
        "none": 0.0,
        "follow": 0.5,
        "yield": 0.5,
        "cut_in": 0.0,
    }


def test_without_relations_in_the_file_nothing_is_scored(tmp_path: Path, whole: StepRelations):
    assert scores(file_of(tmp_path / "a.parquet", block("merge", labels=False)), whole) is None


def test_a_split_is_read_alone(merges: Path):
    found = by_merge_posterior(merges, CONSTANTS, split="test")[0]
    assert found.scene.tolist() == [1, 2, 3]
    assert len(frame_of(found)) == 3 * STEPS * 6
    assert scores(merges, found, "test") is not None


def test_what_does_not_fit_is_refused(tmp_path: Path):
    model = checkpoint.load("us101_car_following")
    short = file_of(tmp_path / "short.parquet", block("car_following", steps=20))
    with pytest.raises(InputError, match=r"got 20 steps of 0\.2 s for kind car_following, wanted at least 25"):
        by_model(model, SUMO_CAR_FOLLOWING, short)
    with pytest.raises(InputError, match="has no scenes of kind merge"):
        by_merge_posterior(short, CONSTANTS)
    straight = block("merge")
    straight.features["y"][:] = 5.0
    with pytest.raises(InputError, match="no scene in which vehicle 0 moves more than 1 m sideways"):
        by_merge_posterior(file_of(tmp_path / "straight.parquet", straight), CONSTANTS)


def test_the_command_writes_the_file_and_says_how_good_constants_are(merges: Path, tmp_path: Path):
    out = tmp_path / "relations.parquet"
    result = CliRunner().invoke(app, ["infer", "merge_posterior", str(merges), "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "constant per pair" in result.output
    assert len(pd.read_parquet(out)) == SCENES * STEPS * 6
    with pytest.raises(InputError, match="--online with us101_merge"):
        CliRunner().invoke(app, ["infer", "us101_merge", str(merges), "--online"], catch_exceptions=False)
    with pytest.raises(InputError, match="infers no graph"):
        CliRunner().invoke(app, ["infer", "us101_merge_supervised", str(merges)], catch_exceptions=False)
