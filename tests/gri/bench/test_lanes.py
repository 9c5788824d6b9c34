"""The lane benchmark's work: resumable, the same bytes twice, and trivial rows that get what they must."""

import json

import pandas as pd
import pytest
import torch

from gri import checkpoint
from gri.bench import lane_families, lanes
from gri.bench.driver_models import IDM, KRAUSS
from gri.bench.lane_classifier import Size, StepClassifier, first_frame, pair_series
from gri.bench.lane_families import FIRST
from gri.bench.lane_rows import LANE_ROWS
from gri.bench.lanes import LanePlan, _tests, _training, run_lanes, score_set
from gri.errors import InputError

ROWS = ("nobody reacts", "textbook merge", "prior: lanes and order", "most frequent per pair and kind")
SCENES, TRAINING = 12, 6


def plan(folder, **changes) -> LanePlan:
    return LanePlan(folder, seeds=1, scenes=SCENES, rows=ROWS, training=TRAINING, **changes)


@pytest.fixture(scope="module", autouse=True)
def two_driver_models():
    """Scenes of two driver models are enough to test the work, and are drawn in a third of the time."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (lanes, lane_families):
            patch.setattr(module, "DRIVER_MODELS", (IDM, KRAUSS))
        yield
    _tests.cache_clear()
    _training.cache_clear()


@pytest.fixture(scope="module")
def results(two_driver_models, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lanes")
    return folder, run_lanes(plan(folder))


def test_trivial_rows_get_what_they_must(results):
    value = results[1].set_index(["row", "set", "score"])["value"]
    for name in ("lane keeper beside a gap", "change without relation"):
        assert value["nobody reacts", name, "false_relation"] == 0
        assert value["textbook merge", name, "false_relation"] == 1
    assert value["nobody reacts", "idm", "recall_none"] == 1
    assert value["textbook merge", "idm", "recall_cut_in"] == 1
    nobody = value["nobody reacts"].xs("accuracy", level="score")
    assert (nobody < 0.6).all()
    told = value["most frequent per pair and kind"]
    assert told["change without relation", "false_relation"] == 0


def test_a_second_run_writes_the_same_bytes_and_a_finished_job_is_not_done_again(results, tmp_path, monkeypatch):
    folder, table = results
    run_lanes(plan(tmp_path))
    for name in ("lanes.csv", "lanes.md", "lanes.json"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()
    assert not list(folder.rglob("*.part"))

    def never(*_):
        raise AssertionError("was done again")

    monkeypatch.setattr(lanes, "_result", never)
    pd.testing.assert_frame_equal(run_lanes(plan(folder)), table)


def test_the_truth_gets_full_marks(results):
    for tested in _tests(SCENES):
        truth = torch.nn.functional.one_hot(tested.scenes.relations, 4).double().numpy()
        scores = score_set(tested, truth)
        if tested.kind == "control":
            assert scores["false_relation"].value == 0 or len(tested.scenes) == 0
        else:
            assert scores["accuracy"].value == scores["macro_f1"].value == scores["scene_accuracy"].value == 1


def test_the_card_tells_shares_and_kept_scenes(results):
    sets = json.loads((results[0] / "lanes.json").read_text())["sets"]
    assert [part["kind"] for part in sets] == ["drivers"] * 2 + ["variant"] * 2 + ["control"] * 3
    for part in sets:
        assert all(0.1 < share <= 1 for share in part["drawn_scenes_kept"].values())
        for pair in part["pairs"].values():
            assert max(pair["types_of_scored_steps"].values()) < 0.6


def test_tables_have_as_many_columns_in_every_line(results):
    blocks = (results[0] / "lanes.md").read_text().split("\n\n")
    tables = [block for block in blocks if block.startswith("| ")]
    assert len(tables) == 4
    for table in tables:
        assert len({line.count("|") for line in table.strip().splitlines()}) == 1


def test_an_unknown_row_says_what_there_is(tmp_path):
    with pytest.raises(InputError, match="got 'magic', wanted one of: nobody reacts; "):
        run_lanes(LanePlan(tmp_path, rows=("magic",)))


def test_released_models_see_only_the_past(results):
    """What comes after a step changes no answer of it; what was before does."""
    scenes = _training(TRAINING)[0]
    row = next(row for row in LANE_ROWS if row.name == "released: us101_merge")
    infer = row.prepare((), (), 0)
    later = scenes.state.clone()
    later[:, :, FIRST + 5 :] += 1.0
    p, changed = infer(scenes), infer(lanes.LaneScenes(**{**vars(scenes), "state": later}))
    assert torch.equal(p[:, : FIRST + 5], changed[:, : FIRST + 5])
    assert not torch.equal(p[:, FIRST + 5 :], changed[:, FIRST + 5 :])
    assert torch.allclose(p.sum(-1), torch.ones_like(p[..., 0]))
    direct = checkpoint.load("us101_merge").infer(scenes.state[:, :, : FIRST + 1].float()).probs
    assert torch.allclose(p[:, FIRST], direct.double(), atol=1e-3)


def test_a_frame_is_read_alone_and_the_first_frame_for_all_steps(results):
    scenes = _training(TRAINING)[0]
    torch.manual_seed(0)
    model = StepClassifier(Size(1, over_time=False))
    whole, frame = pair_series(scenes), pair_series(scenes)[..., 30:31]
    assert torch.allclose(model(whole, 3)[:, 30:31], model(frame, 3), atol=1e-5)
    still = pair_series(first_frame(scenes))
    assert torch.equal(still[..., 2:], still[..., 1:2].expand_as(still[..., 2:]))


def test_renumbered_vehicles_get_the_same_answers(results):
    scenes = _training(TRAINING)[0]
    torch.manual_seed(0)
    model = StepClassifier(Size(1))
    order = [2, 0, 1]
    turned = lanes.LaneScenes(**{**vars(scenes), "state": scenes.state[:, order]})
    here, there = model(pair_series(scenes), 3), model(pair_series(turned), 3)
    named = lanes.role_pairs(scenes.roles)
    named_there = lanes.role_pairs([scenes.roles[vehicle] for vehicle in order])
    assert torch.allclose(here, there[:, :, [named_there.index(pair) for pair in named]], atol=1e-4)
