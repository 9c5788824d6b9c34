"""The recorded part of the benchmark: generated traffic with and without reactions, resumable, the same bytes twice."""

import numpy as np
import pandas as pd
import pytest

from gri.bench import recorded_relations
from gri.bench.recorded_relations import RecordedPlan, run_recorded
from gri.bench.recorded_rows import RECORDED_ROWS
from gri.errors import InputError
from tests.gri.bench.recorded_traffic import waves_file

ROWS = ("nobody follows", "everybody follows the next", "lagged correlation of speeds", "joint Gaussian of speeds")


def plan(folder, path, rows=ROWS) -> RecordedPlan:
    return RecordedPlan(folder, (path,), 1, rows, ("6 s",), lanes=False)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return waves_file(tmp_path_factory.mktemp("recording"))


@pytest.fixture(scope="module")
def results(tmp_path_factory, path):
    folder = tmp_path_factory.mktemp("bench")
    return folder, run_recorded(plan(folder, path))


def value(table, row, kind, score, part="test", vehicles="pairs") -> float:
    keys = {"row": row, "kind": kind, "score": score, "part": part, "vehicles": vehicles}
    chosen = table[np.logical_and.reduce([table[name] == wanted for name, wanted in keys.items()])]
    assert len(chosen) == 1
    return float(chosen["value"].iloc[0])


def test_constants_get_what_they_must(results):
    _, table = results
    assert value(table, "everybody follows the next", "recorded", "agreement", vehicles="triples") == 1
    assert value(table, "everybody follows the next", "headway x 4", "false_follow") == 1
    assert value(table, "everybody follows the next", "strangers", "auc", part="all") == 0.5
    assert value(table, "nobody follows", "recorded", "agreement", vehicles="triples") == pytest.approx(4 / 6)
    assert value(table, "nobody follows", "recorded", "found") == 0


def test_a_reaction_is_told_from_strangers(results):
    _, table = results
    for row in ROWS[2:]:
        assert value(table, row, "strangers", "auc", part="all") > 0.8, row


def test_where_nobody_reacts_nothing_is_told_from_strangers(tmp_path):
    table = run_recorded(plan(tmp_path, waves_file(tmp_path, reacts=False), ROWS[2:3]))
    assert value(table, ROWS[2], "strangers", "auc", part="all") < 0.7


def test_a_second_run_writes_the_same_bytes(results, path, tmp_path):
    folder, _ = results
    run_recorded(plan(tmp_path, path))
    for name in ("recorded.csv", "recorded.md"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_finished_jobs_are_not_done_again(results, path, monkeypatch):
    folder, table = results

    def never(*_):
        raise AssertionError("was done again")

    monkeypatch.setattr(recorded_relations, "_result", never)
    pd.testing.assert_frame_equal(run_recorded(plan(folder, path)), table)


def test_an_unknown_row_says_what_there_is(tmp_path, path):
    with pytest.raises(InputError, match="got 'magic', wanted one of: nobody follows; "):
        run_recorded(plan(tmp_path, path, ("magic",)))


def test_tables_have_as_many_columns_in_every_line(results):
    folder, _ = results
    tables = [block for block in (folder / "recorded.md").read_text().split("\n\n") if block.startswith("| ")]
    assert len(tables) >= 5
    for table in tables:
        assert len({line.count("|") for line in table.strip().splitlines()}) == 1


def test_names_of_rows_are_unique():
    names = [row.name for row in RECORDED_ROWS]
    assert len(names) == len(set(names))
