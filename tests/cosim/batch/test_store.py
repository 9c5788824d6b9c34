"""The folder of a batch: damaged runs are set aside, damaged tables are never read."""

import os
from pathlib import Path

import pytest

from cosim.batch.store import BatchStore
from gri.errors import InputError
from tests.cosim.runs.finished import finished_run, flip

RUNS = {"ra", "rb"}


@pytest.fixture
def store(tmp_path: Path) -> BatchStore:
    store = BatchStore(tmp_path / "batch")
    with store.opened(RUNS, pytest.fail):
        for k, run in enumerate(sorted(RUNS)):
            store.finish(run, finished_run(store.attempt_folder(run, 0), speed=20.0 + k))
    return store


def opened(store: BatchStore) -> list[str]:
    """What is said when the batch goes on."""
    said: list[str] = []
    with store.opened(RUNS, said.append):
        pass
    return said


def test_the_tables_hold_all_finished_runs_in_order(store):
    assert store.table("groups", ["rb", "ra", "rc"])["run"].astype(str).tolist() == ["rb", "ra"]
    assert store.table("steps", ["ra", "rb"])["v"].tolist() == [20.0, 20.0, 21.0, 21.0]
    assert opened(store) == []


@pytest.mark.parametrize("name", ["groups.parquet", "manifest.json", "scenario.json", "surroundings.parquet"])
def test_a_damaged_run_is_set_aside_and_done_again(store, name):
    flip(store.run_folder("ra") / name, 999)
    (said,) = opened(store)
    assert name in said
    assert said.endswith(f"this run is done again, its files are in {store.folder / 'damaged/ra'}")
    assert store.finished() == {"rb"}
    assert not (store.folder / "groups/run=ra").exists()
    assert store.table("groups", ["ra", "rb"])["run"].astype(str).tolist() == ["rb"]
    assert opened(store) == []


def test_a_run_that_is_damaged_twice_keeps_both(store):
    for _ in range(2):
        flip(store.run_folder("ra") / "steps.parquet", 999)
        assert len(opened(store)) == 1
        with store.opened(RUNS, pytest.fail):
            store.finish("ra", finished_run(store.attempt_folder("ra", 0)))
    assert sorted(os.listdir(store.folder / "damaged")) == ["ra", "ra.damaged"]


@pytest.mark.parametrize("table", ["groups", "counterparts"])
def test_a_damaged_table_is_refused_in_one_line(store, table):
    flip(store.folder / table / "run=ra/part.parquet", 999)
    with pytest.raises(
        InputError, match=rf"{table}/run=ra/part.parquet: is damaged .*; run `cosim batch` again"
    ) as said:
        store.table(table, ["ra", "rb"])
    assert "\n" not in str(said.value)


@pytest.mark.parametrize("damage", ["flipped", "missing"])
def test_a_damaged_copy_of_a_table_is_copied_again(store, damage):
    """Where the file system has no hard links, the run itself is as it was."""
    part = store.folder / "groups/run=ra/part.parquet"
    content = part.read_bytes()
    part.unlink()
    if damage == "flipped":
        part.write_bytes(content)
        flip(part, 999)
    with pytest.raises(InputError, match=r"part.parquet"):
        store.table("groups", ["ra"])
    assert opened(store) == []
    assert part.read_bytes() == content


def test_a_damaged_record_of_a_failure_counts_as_none(store):
    with store.opened(RUNS, pytest.fail):
        store.fail("rc", {"run": "rc", "labels": {}, "attempts": []})
    assert set(store.failures()) == {"rc"}
    flip(store.folder / "failures/rc.json", 85)
    assert store.failures() == {}


def test_a_run_that_is_finished_after_all_has_failed_no_more(store):
    with store.opened(RUNS | {"rc"}, pytest.fail):
        store.fail("rc", {"run": "rc", "labels": {}, "attempts": []})
        store.finish("rc", finished_run(store.attempt_folder("rc", 1)))
    assert store.failures() == {}
    assert store.finished() == RUNS | {"rc"}


def test_a_damaged_manifest_is_refused(store):
    store.write_manifest({"runs": [], "batch": {}, "file": "a.yaml"})
    assert store.manifest()["file"] == "a.yaml"
    path = store.folder / "manifest.json"
    path.write_text(path.read_text().replace("a.yaml", "b.yaml"))
    with pytest.raises(InputError, match=r"manifest.json: is damaged .*; run `cosim batch` again"):
        store.manifest()


def test_a_second_command_is_refused_and_changes_nothing(store):
    with store.opened(RUNS, pytest.fail):
        (store.attempt_folder("rc", 0)).mkdir()
        with pytest.raises(InputError, match="writes there"), store.opened(RUNS, pytest.fail):
            pass
        assert store.attempt_folder("rc", 0).is_dir()
    assert opened(store) == []
    assert not store.attempt_folder("rc", 0).exists()
