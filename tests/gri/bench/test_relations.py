"""The command's work: resumable, the same bytes twice, and controls that break what they say."""

import pandas as pd
import pytest
import torch

from gri.bench import relations
from gri.bench.answers import Answer, ask
from gri.bench.driver_models import IDM
from gri.bench.families import NEAR, controls, split, unknown_worlds
from gri.bench.relations import Plan, run
from gri.errors import InputError

ROWS = ("nobody follows", "everybody follows the next", "lagged correlation")


def plan(folder, **changes) -> Plan:
    return Plan(folder, seeds=2, scenes=24, rows=ROWS, training=8, validation=12, **changes)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    return folder, run(plan(folder))


def test_trivial_rows_get_what_they_must(results):
    _, table = results
    value = table.set_index(["row", "set", "score"])["value"]
    assert (value["nobody follows"].xs("balanced_accuracy", level="score").dropna() == 0.5).all()
    assert value["nobody follows", "own speeds", "false_follow"] == 0
    assert value["everybody follows the next", "headway x 15", "false_follow"] == pytest.approx(2 / 3)
    assert value["everybody follows the next", "own speeds", "false_follow_from_behind"] == 0


def test_a_second_run_writes_the_same_bytes(results, tmp_path):
    folder, _ = results
    run(plan(tmp_path))
    for name in (
        "relations.csv",
        "relations.md",
        "relations.json",
        "relations_reliability.svg",
        "relations_abstention.svg",
    ):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_finished_jobs_are_not_done_again(results, monkeypatch):
    folder, table = results

    def never(*_):
        raise AssertionError("was done again")

    monkeypatch.setattr(relations, "_result", never)
    pd.testing.assert_frame_equal(run(plan(folder)), table)


def test_nothing_is_left_half_written(results):
    folder, _ = results
    assert not list(folder.rglob("*.part"))


def test_an_unknown_row_says_what_there_is(tmp_path):
    with pytest.raises(InputError, match="got 'magic', wanted one of: nobody follows; "):
        run(Plan(tmp_path, rows=("magic",)))


def test_markdown_tables_have_as_many_columns_in_every_line(results):
    folder, _ = results
    blocks = (folder / "relations.md").read_text().split("\n\n")
    tables = [block for block in blocks if block.startswith("| ")]
    assert len(tables) == 5
    for table in tables:
        assert len({line.count("|") for line in table.strip().splitlines()}) == 1


def test_controls_keep_the_motion_and_break_the_relation():
    made = controls(20)
    for name, scenes in made.items():
        assert len(scenes) == 20, name
        assert scenes.graph().sum() == 0, name
        x, v = scenes.state[..., 0], scenes.state[..., 1]
        assert (x[:, 1:] > x[:, :-1]).all(), name
        moved = (x[..., 1:] - x[..., :-1]) / 0.2
        assert (moved - (v[..., 1:] + v[..., :-1]) / 2).abs().max() < 0.5, name
    four, fifteen = made["headway x 4"].state, made["headway x 15"].state
    assert torch.equal(four[..., 1], fifteen[..., 1])
    ratio = (fifteen[:, 1, 0, 0] - fifteen[:, 0, 0, 0]) / (four[:, 1, 0, 0] - four[:, 0, 0, 0])
    assert torch.allclose(ratio, torch.full_like(ratio, 15 / 4))


def test_unknown_worlds_are_what_they_say():
    made, dt = unknown_worlds(20), 0.2
    for name, scenes in made.items():
        assert scenes.state.shape == (20, 3, NEAR.steps, 3), name
    known = split("test", IDM, NEAR, 20)
    assert made["fast"].state[:, :, 0, 1].min() > known.state[:, :, 0, 1].max()
    headway = made["far apart"].state[:, 1:, 0, 0] - made["far apart"].state[:, :-1, 0, 0]
    assert headway.min() > 245
    assert headway.max() < 505

    def slip(scenes) -> float:
        """Mean distance between the step in position and the one that the speeds imply [m]."""
        x, v = scenes.state[..., 0], scenes.state[..., 1]
        return float(((x[..., 1:] - x[..., :-1]) - dt * (v[..., 1:] + v[..., :-1]) / 2).abs().mean())

    assert slip(known) < 0.01
    for name, scenes in made.items():
        assert (slip(scenes) > 0.3) == (name in ("slow motion", "position noise")), name
    trucks = made["trucks"].state[..., 0]
    assert (trucks[:, 1:] - trucks[:, :-1]).min() > 20
    for name in ("oscillating", "random walk"):
        assert made[name].state[..., 2].std() > 3 * known.state[..., 2].std(), name
        assert made[name].graph().sum() == 0


def test_a_row_may_say_how_little_it_trusts_itself():
    known = split("test", IDM, NEAR, 4)
    half = torch.full((4, 6), 0.25, dtype=torch.float64)
    assert ask(lambda _: half, known).uncertainty.unique().tolist() == [0.25]
    own = torch.rand(4, 6, dtype=torch.float64)
    assert torch.equal(ask(lambda _: Answer(half, own), known).uncertainty, own)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        (torch.full((4, 6), float("nan")), "wanted .4, 6. finite numbers"),
        (torch.zeros(4, 3), "wanted .4, 6. finite numbers"),
        (torch.full((4, 6), 1.5), "wanted 0 to 1"),
    ],
)
def test_an_answer_that_is_none_is_refused(given, match):
    with pytest.raises(ValueError, match=match):
        ask(lambda _: given, split("test", IDM, NEAR, 4))
