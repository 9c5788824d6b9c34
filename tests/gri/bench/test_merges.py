"""The benchmark of merges: scores against hand counts, controls that break what they say, resumable and repeatable."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gri import checkpoint
from gri.bench import merges
from gri.bench.merge_rows import POSTERIOR, Training, as_the_models_see, starts
from gri.bench.merge_scenes import controls, read_merges
from gri.bench.merge_scores import balanced_accuracy, claimed, f1_by_type, macro_f1
from gri.bench.merges import Plan, run
from gri.core.dynamics import DUBINS
from gri.core.edges import LANE_CHANGING, pairs
from gri.data.scene_file.schema import Header, SceneBlock, writing
from gri.errors import InputError
from gri.relations.broken_merges import LAG, MERGER, V, X, Y
from gri.relations.merge_explanations import CONSTANTS

WIDTH, DT, STEPS = 3.5, 0.2, 20
ROWS = ("constant per pair", "constant per pair and step", "prior alone (geometry, no motion)", "released: us101_merge")


def write_file(path: Path, first_seed: int, count: int = 6, labels: bool = True) -> Path:
    """Merges at constant speeds, with labels of no meaning: 0 → 1 yields and then follows."""
    rng = np.random.default_rng(first_seed)
    time = np.arange(STEPS) * DT
    speed = 8 + rng.random((count, 3, 1)) + 0 * time
    x = np.array([0.0, -20.0, 20.0])[:, None] + 300 + speed * time
    u = np.clip((np.arange(STEPS) - 9) / 8, 0, 1)
    y = np.zeros((count, 3, STEPS)) + 5.0
    y[:, 0] += WIDTH * (u**3 * (10 - 15 * u + 6 * u**2) - 1)
    motion = {"x": x, "y": y, "v": speed, "heading": 0 * x, "a": 0 * x, "yaw_rate": 0 * x}
    edges = np.full((count, 6, STEPS), "none", object)
    edges[:, 0, :10], edges[:, 0, 10:] = "yield", "follow"
    block = SceneBlock(
        kind="merge",
        source=np.full(count, "us101_merge", object),
        recording=np.array([f"seed {first_seed + k % 2}" for k in range(count)], object),
        split=np.full(count, "test", object),
        start=np.zeros(count),
        vehicle=np.arange(3 * count).reshape(count, 3),
        features=motion,
        edges=edges[..., -1],
        size={"length": np.full((count, 3), 4.5), "width": np.full((count, 3), 1.8)},
        step_edges=edges if labels else None,
        unambiguous=np.arange(count) < 3,
    )
    with writing(path, Header(dt=DT)) as write:
        write(block)
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("merges")
    return write_file(folder / "test.parquet", 50), write_file(folder / "train.parquet", 1)


def plan(out: Path, files) -> Plan:
    return Plan(out, (files[0],), (files[1],), seeds=2, rows=ROWS)


@pytest.fixture(scope="module")
def results(files, tmp_path_factory):
    folder = tmp_path_factory.mktemp("out")
    return folder, run(plan(folder, files))


def test_states_and_relations_are_read_as_written(files):
    scenes = read_merges(files[0])
    assert scenes.state.shape == (6, 3, STEPS, len(DUBINS.state))
    assert scenes.lane_width == pytest.approx(WIDTH, abs=1e-5)
    names = [[str(LANE_CHANGING[k]) for k in scenes.steps[0, t]] for t in (0, 15)]
    assert names == [["yield"] + ["none"] * 5, ["follow"] + ["none"] * 5]
    assert (scenes.graph[:, 1:] == 0).all()


def test_trivial_rows_get_what_they_must(results):
    _, table = results
    value = table.set_index(["row", "score"])["value"]
    assert value["constant per pair and step", "step_accuracy"] == 1
    assert value["constant per pair", "step_accuracy"] == pytest.approx(11 / 12)
    assert value["constant per pair and step", "scene_accuracy"] == 1


def test_a_second_run_writes_the_same_bytes(results, files, tmp_path):
    folder, _ = results
    run(plan(tmp_path, files))
    for name in ("merges.csv", "merges.md", "merges.json"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_finished_jobs_are_not_done_again_and_nothing_is_half_written(results, files, monkeypatch):
    folder, table = results

    def never(*_):
        raise AssertionError("was done again")

    monkeypatch.setattr(merges, "_result", never)
    assert run(plan(folder, files)).equals(table)
    assert not list(folder.rglob("*.part"))


def test_macro_f1_by_hand():
    truth = np.array([[[0], [1], [1], [2]]])
    answer = np.array([[[0], [1], [0], [2]]])
    assert f1_by_type(answer, truth)[:3] == pytest.approx([2 / 3, 2 / 3, 1])
    assert np.isnan(f1_by_type(answer, truth)[3])
    assert macro_f1(answer, truth) == pytest.approx(7 / 9)


def test_no_constant_gets_more_than_one_half_of_the_balanced_accuracy():
    rng = np.random.default_rng(0)
    truth = (rng.random((30, 10, 6)) < 0.1).astype(int)
    for constant in range(4):
        assert balanced_accuracy(np.full_like(truth, constant), truth) <= 0.5
    assert balanced_accuracy(truth, truth) == 1


def test_claims_are_counted_per_step():
    answer = np.zeros((1, 4, 6), int)
    answer[0, 1, 0], answer[0, 2, 2] = 1, 3
    counts = np.array([True, True, True, False])
    assert claimed(answer, ((0, (1, 2)), (2, (3,))), counts) == pytest.approx([2 / 3])
    assert claimed(answer, ((2, (2,)),), counts) == 0


def test_controls_change_the_lag_vehicle_or_the_lane_and_nothing_else(files):
    scenes = read_merges(files[0])
    stranger, steady, kept = (control.scenes for control in controls(scenes))
    others = [MERGER, 2]
    for made in (stranger, steady):
        assert torch.equal(made.state[:, others], scenes.state[: len(made), others])
        assert torch.allclose(made.state[:, LAG, 0, X], scenes.state[: len(made), LAG, 0, X])
    for k in range(len(stranger)):  # of another recording
        own = scenes.recording == scenes.recording[k]
        speeds = scenes.state[:, LAG, :, V]
        assert any(torch.equal(stranger.state[k, LAG, :, V], v) for v in speeds[torch.from_numpy(~own)])
    assert (steady.state[:, LAG, :, V].diff(dim=-1) == 0).all()
    assert (kept.motion().lane[:, MERGER] == -1).all()
    assert torch.equal(kept.state[..., X], scenes.state[..., X])


def test_released_models_see_the_target_lane_at_zero_and_net_gaps(files):
    scenes = read_merges(files[0])
    seen = as_the_models_see(scenes)
    assert seen[:, 2, :, Y].abs().max() < 1e-5
    gap = seen[:, 2, :, X] - seen[:, 0, :, X] - 5.0
    true = scenes.state[:, 2, :, X] - scenes.state[:, 0, :, X] - scenes.length[:, 2, None]
    assert torch.allclose(gap, true)


@pytest.mark.parametrize("name", ["released: merge_relations", f"{POSTERIOR}, online"])
def test_rows_that_are_online_see_nothing_later(name: str, files):
    scenes = read_merges(files[0])
    row = next(row for row in merges.ROWS if row.name == name)
    infer = row.prepare(Training((scenes,), lambda _: dict(CONSTANTS)), 0)
    state = scenes.state.clone()
    state[:, MERGER, 15:, V] *= 0.5  # it brakes late
    before, after = infer(scenes).steps, infer(replace(scenes, state=state)).steps
    assert torch.allclose(before.sum(-1), torch.ones(before.shape[:-1]).double())
    assert torch.allclose(before[:, :15], after[:, :15])
    assert not torch.allclose(before[:, 15:], after[:, 15:])


def test_a_released_encoder_says_in_each_step_what_the_model_infers_from_the_window_before(files):
    scenes = read_merges(files[0])
    row = next(row for row in merges.ROWS if row.name == "released: merge_relations")
    said = row.prepare(Training((scenes,), lambda _: dict(CONSTANTS)), 0)(scenes).steps
    window = as_the_models_see(scenes)[:, :, :16]
    window[..., X] -= window[:, -1:, -1:, X].clone()
    inferred = checkpoint.load("merge_relations").infer(window.float()).probs.double()
    torch.testing.assert_close(said[:, 15], inferred, atol=1e-4, rtol=0)
    assert torch.equal(said[:, 0], said[:, 9])  # the first ten states are seen together


def test_other_seeds_begin_learning_from_constants_that_are_wrong_by_two():
    for seed in (1, 2):
        wrong = starts(seed)
        factors = {round(wrong[name] / CONSTANTS[name], 6) for name in CONSTANTS if name != "persistence"}
        assert factors == {0.5, 2.0}
    assert starts(0) == CONSTANTS


def test_errors_say_what_is_wrong(files, tmp_path):
    with pytest.raises(InputError, match="got 'magic', wanted one of: constant per pair; "):
        run(Plan(tmp_path, (files[0],), (files[1],), rows=("magic",)))
    with pytest.raises(InputError, match=r"has seed 50 of .* too, wanted other seeds"):
        run(Plan(tmp_path, (files[0],), (files[0],), rows=ROWS))
    bare = write_file(tmp_path / "bare.parquet", 7, labels=False)
    with pytest.raises(InputError, match="no relations per step"):
        read_merges(bare)
    assert POSTERIOR in {row.name for row in merges.ROWS}


def test_every_row_of_the_benchmark_has_a_name_of_its_own():
    names = [row.name for row in merges.ROWS]
    assert len(set(names)) == len(names)
    assert len(pairs(3)) == 6
